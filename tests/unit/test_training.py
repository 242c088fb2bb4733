"""Levenberg-Marquardt with Bayesian regularisation: its mathematics and its endings."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq
from threadpoolctl import threadpool_limits

from pamid.base.errors import DataError
from pamid.networks.elman import Elman
from pamid.networks.network import Network
from pamid.networks.network_training import GATES, train
from pamid.networks.training_problem import Goals, TrainingOptions


@dataclass(frozen=True)
class Linear(Network):
    """y = U w: the network whose evidence has a closed form."""

    size: int

    @property
    def n_weights(self):
        return self.size

    def initial(self, seed):
        return np.random.default_rng(seed).normal(size=self.n_weights)

    def simulate(self, weights, inputs):
        return inputs @ weights

    def sweep(self, weights, inputs):
        yield 0, inputs @ weights, inputs


def linear_data(n=120, p=8, noise=0.3, seed=0):
    draw = np.random.default_rng(seed)
    u = draw.normal(size=(n, p)) * np.logspace(0, -2.5, p)
    return u, u @ draw.normal(size=p) + noise * draw.normal(size=n)


def teacher_data(n=1500, noise=0.0, seed=5, hidden=3):
    """Held random levels into a random Elman network; target scaled into [-1, 1]."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-1.0, 1.0, (n // 20, 2)), 20, axis=0)
    teacher = Elman(2, hidden)
    y = teacher.simulate(0.6 * np.random.default_rng(7).normal(size=teacher.n_weights), u)
    return u, y / np.abs(y).max() + noise * draw.normal(size=len(u))


def trained_on(network, inputs, target, **options):
    return train(network, inputs, target, options=TrainingOptions(**options))


# --- evidence --------------------


def evidence_fixed_point(u, target):
    """(gamma, alpha, beta, weights) from eigenvalues and a root in alpha / beta, with no iteration
    in common."""
    values, vectors = np.linalg.eigh(u.T @ u)
    projected = vectors.T @ (u.T @ target)
    n = len(target)

    def at(log_ratio):
        ratio = np.exp(log_ratio)
        coordinates = projected / (values + ratio)
        gamma = np.sum(values / (values + ratio))
        sse = np.sum((target - u @ (vectors @ coordinates)) ** 2)
        return (
            gamma,
            gamma / (2.0 * np.sum(coordinates**2)),
            (n - gamma) / (2.0 * sse),
            vectors @ coordinates,
        )

    root = brentq(lambda x: np.log(at(x)[1] / at(x)[2]) - x, -15.0, 10.0, xtol=1e-13)
    return at(root)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gamma_alpha_beta_reach_foresee_hagans_fixed_point(seed):
    u, target = linear_data(seed=seed)
    gamma, alpha, beta, weights = evidence_fixed_point(u, target)
    assert 3.0 < gamma < 7.9  # the case is one where regularisation does something
    trained = trained_on(Linear(8), u, target, iterations=500, seed=seed, goals=Goals(promise=0.0))
    assert trained.converged, trained.why
    assert trained.trace["gamma"][-1] == pytest.approx(gamma, rel=1e-6)
    assert trained.trace["alpha"][-1] == pytest.approx(alpha, rel=1e-6)
    assert trained.trace["beta"][-1] == pytest.approx(beta, rel=1e-6)
    np.testing.assert_allclose(trained.weights, weights, atol=1e-7)


def test_without_regularisation_it_is_least_squares():
    u, target = linear_data(seed=6)
    trained = trained_on(
        Linear(8), u, target, iterations=200, regularise=False, goals=Goals(promise=0.0)
    )
    np.testing.assert_allclose(
        trained.weights, np.linalg.lstsq(u, target, rcond=None)[0], atol=1e-8
    )
    assert np.all(trained.trace["alpha"] == 0.0) and np.all(trained.trace["beta"] == 1.0)


# --- Levenberg-Marquardt --------------------


@pytest.mark.parametrize("regularise", [False, True])
def test_learns_a_teacher(regularise):
    u, target = teacher_data()
    roomy = [
        trained_on(Elman(2, 6), u, target, iterations=150, seed=seed, regularise=regularise)
        for seed in range(3)
    ]
    assert all(t.trace["mse"][0] > 1e-4 for t in roomy)
    assert all(t.trace["mse"][-1] < 1e-12 for t in roomy), [t.trace["mse"][-1] for t in roomy]
    # of the teacher's own size a start may end in a minimum of its own: that is what several starts
    # are for
    tight = [
        trained_on(Elman(2, 3), u, target, iterations=150, seed=seed, regularise=regularise)
        for seed in range(6)
    ]
    arrived = [t for t in tight if t.trace["mse"][-1] < 1e-15]
    assert len(arrived) >= 2 and all(t.converged for t in arrived), [
        (t.trace["mse"][-1], t.why) for t in tight
    ]


def test_noise_is_not_learnt():
    u, target = teacher_data(noise=0.05)
    trained = trained_on(Elman(2, 6), u, target, iterations=80)
    assert trained.trace["mse"][-1] == pytest.approx(0.05**2, rel=0.15)
    assert trained.trace["beta"][-1] == pytest.approx(1.0 / (2.0 * 0.05**2), rel=0.15)
    assert 10.0 < trained.trace["gamma"][-1] < Elman(2, 6).n_weights
    clean_u, clean = teacher_data(seed=6)
    assert np.mean((Elman(2, 6).simulate(trained.weights, clean_u) - clean) ** 2) < 0.05**2


def test_mu_rises_on_rejected_and_falls_on_accepted_steps():
    u, target = teacher_data(noise=0.02)
    trace = trained_on(Elman(2, 5), u, target, iterations=60, regularise=False).trace
    assert trace["trials"][1:].max() > 1 and trace["trials"][1:].min() == 1  # both kinds occurred
    assert trace["mu"][0] == 0.005
    raised = trace["mu"][:-1] * 3.0 ** (trace["trials"][1:] - 1)
    factors = trace["mu"][1:] / raised
    assert all(
        np.isclose(f, [0.1, 1.0 / 3.0, 2.0 / 3.0, 1.0, 2.0], rtol=1e-9).any() for f in factors
    )
    assert factors.min() < 0.5 and factors.max() > 0.5
    assert np.all(np.diff(trace["mse"]) < 0.0)


def test_linear_weights_are_at_their_best():
    """After a step no other output weights give a lower objective: variable projection."""
    u, target = teacher_data(noise=0.02)
    network = Elman(2, 3)
    trained = trained_on(network, u, target, iterations=4)
    alpha, beta = trained.trace["alpha"][-2], trained.trace["beta"][-2]
    features = network.features(trained.weights, u)
    best = np.linalg.solve(
        beta * features.T @ features + alpha * np.eye(4), beta * features.T @ target
    )
    np.testing.assert_allclose(trained.weights[network.linear], best, rtol=1e-6)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_worse_half_is_left_behind_at_every_gate(threads):
    u, target = teacher_data(noise=0.01)
    goals = Goals(gradient=0.0, promise=0.0, mse=0.0)
    with threadpool_limits(1, "blas"):
        several = trained_on(
            Elman(2, 3), u, target, iterations=50, starts=4, seed=10, goals=goals, threads=threads
        )
        single = [
            trained_on(Elman(2, 3), u, target, iterations=50, seed=10 + s, goals=goals)
            for s in range(4)
        ]
    at = [[s.trace["mse"][min(k, len(s.trace["mse"]) - 1)] for k in range(51)] for s in single]
    second = sorted(sorted(range(4), key=lambda s: at[s][GATES[0]])[:2])
    winner = min(second, key=lambda s: at[s][GATES[1]])
    assert several.best == winner
    np.testing.assert_array_equal(several.weights, single[winner].weights)
    stopped = [GATES[1] if s in second else GATES[0] for s in range(4)]
    stopped[winner] = 50
    assert several.starts_mse == tuple(at[s][k] for s, k in enumerate(stopped))


def test_several_recordings_are_one_objective():
    u, target = teacher_data()
    halves = trained_on(Linear(2), [u[:700], u[700:]], [target[:700], target[700:]], iterations=50)
    whole = trained_on(Linear(2), u, target, iterations=50)
    np.testing.assert_allclose(halves.weights, whole.weights, rtol=1e-9)
    # each from a zero state
    apart = trained_on(Elman(2, 3), [u, u], [target, target], iterations=10)
    network = Elman(2, 3)
    assert apart.samples == 3000
    own = np.mean((target - network.simulate(apart.weights, u)) ** 2)
    assert apart.trace["mse"][-1] == pytest.approx(own, rel=1e-9)


# --- why it ended --------------------


@dataclass(frozen=True)
class Cliff(Linear):
    """A network that overflows as soon as a weight passes `edge`."""

    edge: float = 0.0
    wrong_way: bool = False

    def simulate(self, weights, inputs):
        return (
            np.full(len(inputs), np.inf)
            if np.abs(weights).max() > self.edge
            else super().simulate(weights, inputs)
        )

    def normal_equations(self, weights, inputs, target, washout=0, threads=1):
        if np.abs(weights).max() > self.edge:
            return np.inf, np.full((self.n_weights,) * 2, np.nan), np.full(self.n_weights, np.nan)
        sse, jtj, jte = super().normal_equations(weights, inputs, target, washout)
        return sse, jtj, -jte if self.wrong_way else jte


def test_overflow_on_the_way_is_a_rejected_step():
    u, target = linear_data()
    best = np.linalg.lstsq(u, target, rcond=None)[0]
    edge = 0.9 * np.abs(best).max()
    seed = next(s for s in range(100) if np.abs(Linear(8).initial(s)).max() < edge)
    trained = trained_on(Cliff(8, edge), u, target, iterations=30, seed=seed, regularise=False)
    assert np.abs(trained.weights).max() <= edge
    assert trained.trace["mse"][-1] < trained.trace["mse"][0]


def test_a_wrong_derivative_is_not_called_converged():
    lost = trained_on(Cliff(8, 1e9, True), *linear_data(), iterations=50, regularise=False)
    assert lost.why.startswith(
        "mu reached 1e+10: no step lowers the objective, though a full step promises"
    )
    assert not lost.converged


# --- bad data --------------------


def test_options_that_cannot_be_met():
    u, target = teacher_data()
    with pytest.raises(DataError, match="washout of 1500"):
        trained_on(Elman(2, 3), u, target, washout=1500)
    with pytest.raises(DataError, match="5 samples cannot decide"):
        trained_on(Elman(2, 3), u, target, washout=1495)
    for wrong in (
        {"starts": 0},
        {"iterations": -1},
        {"washout": -1},
        {"seed": -1},
        {"iterations": 2.5},
    ):
        (name,) = wrong
        with pytest.raises(DataError, match=f"{name} to be a whole number"):
            trained_on(Elman(2, 3), u, target, **wrong)
