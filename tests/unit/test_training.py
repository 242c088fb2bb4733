"""Levenberg-Marquardt with Bayesian regularisation: its mathematics and its endings."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq
from threadpoolctl import threadpool_limits

from pamid.base.errors import DataError
from pamid.networks.bayes import (
    Evidence,
    effective_samples,
    effective_weights,
    promised_decrease,
    solve_damped,
)
from pamid.networks.elman import Elman
from pamid.networks.network import Network
from pamid.networks.network_training import GATES, train
from pamid.networks.trained_network import trace_csv
from pamid.networks.training_problem import Damping, Goals, TrainingProblem, recordings


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
    trained = train(Linear(8), u, target, iterations=500, seed=seed, goals=Goals(promise=0.0))
    assert trained.converged, trained.why
    assert trained.trace["gamma"][-1] == pytest.approx(gamma, rel=1e-6)
    assert trained.trace["alpha"][-1] == pytest.approx(alpha, rel=1e-6)
    assert trained.trace["beta"][-1] == pytest.approx(beta, rel=1e-6)
    np.testing.assert_allclose(trained.weights, weights, atol=1e-7)


def test_every_row_of_the_trace_follows_the_update_rules():
    """gamma from the old alpha and beta and the Hessian at the new weights; alpha and beta from the
    new gamma."""
    u, target = linear_data(seed=4)
    trace = train(Linear(8), u, target, iterations=6).trace
    values = np.linalg.eigvalsh(u.T @ u)
    first = trace["gamma"][0], trace["beta"][0] * 2.0 * trace["mse"][0] * len(target)
    assert first == pytest.approx((8.0, len(target) - 8.0))
    for k in range(1, len(trace["gamma"])):
        alpha, beta = trace["alpha"][k - 1], trace["beta"][k - 1]
        hessian = 2.0 * beta * (u.T @ u) + 2.0 * alpha * np.eye(8)
        gamma = 8.0 - 2.0 * alpha * np.trace(np.linalg.inv(hessian))
        assert trace["gamma"][k] == pytest.approx(gamma, rel=1e-9)
        assert gamma == pytest.approx(np.sum(beta * values / (beta * values + alpha)), rel=1e-9)
        sse = trace["mse"][k] * len(target)
        assert trace["beta"][k] == pytest.approx((len(target) - gamma) / (2.0 * sse), rel=1e-9)


def test_without_regularisation_it_is_least_squares():
    u, target = linear_data(seed=6)
    trained = train(
        Linear(8), u, target, iterations=200, regularise=False, goals=Goals(promise=0.0)
    )
    np.testing.assert_allclose(
        trained.weights, np.linalg.lstsq(u, target, rcond=None)[0], atol=1e-8
    )
    assert np.all(trained.trace["alpha"] == 0.0) and np.all(trained.trace["beta"] == 1.0)


def test_singular_hessians_are_solved_and_counted():
    draw = np.random.default_rng(0)
    half = draw.normal(size=(5, 3))
    matrix, right = half @ half.T, half @ draw.normal(size=3)
    np.testing.assert_allclose(matrix @ solve_damped(matrix, 0.0, right), right, atol=1e-10)
    expected = right @ np.linalg.pinv(matrix) @ right
    assert promised_decrease(matrix, right) == pytest.approx(expected, rel=1e-9)
    for alpha in (1e-25, 1e-17, 1e-9):  # below, at and above the rounding error of J'J
        assert effective_weights(Evidence(0.0, alpha, 1.0), matrix) == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_effective_samples_of_an_autoregression(memory):
    draw, n = np.random.default_rng(1), 200_000
    noise, e = draw.normal(size=n), np.zeros(n)
    for k in range(1, n):
        e[k] = memory * e[k - 1] + noise[k]
    assert effective_samples(e) == pytest.approx(n * (1.0 - memory) / (1.0 + memory), rel=0.1)


def test_correlated_residuals_are_remarked():
    u, y = teacher_data(n=1500)
    slow = np.sin(np.arange(1500) / 60.0)
    loud = train(Elman(2, 2), u, 0.2 * y + 0.8 * slow, iterations=5)
    assert loud.samples == 1500 and loud.effective_samples < 150
    assert f"{loud.effective_samples:.0f} independent" in loud.remark
    assert 0.0 < loud.supported_weights < loud.trace["gamma"][-1]
    assert f"{loud.supported_weights:.1f} of 13 weights" in loud.remark
    white = train(Linear(8), *linear_data(n=400), iterations=20)
    assert white.effective_samples > 200 and white.remark == ""
    assert white.supported_weights == pytest.approx(white.trace["gamma"][-1], abs=0.5)


# --- Levenberg-Marquardt --------------------


@pytest.mark.parametrize("regularise", [False, True])
def test_learns_a_teacher(regularise):
    u, target = teacher_data()
    roomy = [
        train(Elman(2, 6), u, target, iterations=150, seed=seed, regularise=regularise)
        for seed in range(3)
    ]
    assert all(t.trace["mse"][0] > 1e-4 for t in roomy)
    assert all(t.trace["mse"][-1] < 1e-12 for t in roomy), [t.trace["mse"][-1] for t in roomy]
    # of the teacher's own size a start may end in a minimum of its own: that is what several starts
    # are for
    tight = [
        train(Elman(2, 3), u, target, iterations=150, seed=seed, regularise=regularise)
        for seed in range(6)
    ]
    arrived = [t for t in tight if t.trace["mse"][-1] < 1e-15]
    assert len(arrived) >= 2 and all(t.converged for t in arrived), [
        (t.trace["mse"][-1], t.why) for t in tight
    ]


def test_noise_is_not_learnt():
    u, target = teacher_data(noise=0.05)
    trained = train(Elman(2, 6), u, target, iterations=80)
    assert trained.trace["mse"][-1] == pytest.approx(0.05**2, rel=0.15)
    assert trained.trace["beta"][-1] == pytest.approx(1.0 / (2.0 * 0.05**2), rel=0.15)
    assert 10.0 < trained.trace["gamma"][-1] < Elman(2, 6).n_weights
    clean_u, clean = teacher_data(seed=6)
    assert np.mean((Elman(2, 6).simulate(trained.weights, clean_u) - clean) ** 2) < 0.05**2


def test_mu_rises_on_rejected_and_falls_on_accepted_steps():
    u, target = teacher_data(noise=0.02)
    trace = train(Elman(2, 5), u, target, iterations=60, regularise=False).trace
    assert trace["trials"][1:].max() > 1 and trace["trials"][1:].min() == 1  # both kinds occurred
    assert trace["mu"][0] == 0.005
    raised = trace["mu"][:-1] * 3.0 ** (trace["trials"][1:] - 1)
    factors = trace["mu"][1:] / raised
    assert all(
        np.isclose(f, [0.1, 1.0 / 3.0, 2.0 / 3.0, 1.0, 2.0], rtol=1e-9).any() for f in factors
    )
    assert factors.min() < 0.5 and factors.max() > 0.5
    assert np.all(np.diff(trace["mse"]) < 0.0)


def test_the_damping_follows_the_gain():
    assert [Damping().factor(g) for g in (1.0, 0.8, 0.6, 0.3, 0.1, 1e-9)] == [
        0.1,
        1 / 3,
        2 / 3,
        1.0,
        2.0,
        2.0,
    ]


def test_a_rejected_step_costs_simulations_only():
    passes = []

    @dataclass(frozen=True)
    class Counting(Elman):
        def normal_equations(self, *arguments):
            passes.append(1)
            return super().normal_equations(*arguments)

    trace = train(Counting(2, 5), *teacher_data(noise=0.02), iterations=40, regularise=False).trace
    assert trace["trials"].sum() > len(trace["mse"])
    # again beyond gates, and at the end
    assert len(passes) == len(trace["mse"]) + 1 + sum(g < 40 for g in GATES)


def test_linear_weights_are_at_their_best():
    """After a step no other output weights give a lower objective: variable projection."""
    u, target = teacher_data(noise=0.02)
    network = Elman(2, 3)
    trained = train(network, u, target, iterations=4)
    alpha, beta = trained.trace["alpha"][-2], trained.trace["beta"][-2]
    features = network.features(trained.weights, u)
    best = np.linalg.solve(
        beta * features.T @ features + alpha * np.eye(4), beta * features.T @ target
    )
    np.testing.assert_allclose(trained.weights[network.linear], best, rtol=1e-6)


def test_acceleration_is_half_the_second_derivative_along_the_step():
    u, target = teacher_data()
    network = Elman(2, 3)
    problem = TrainingProblem(network, recordings(u, target), 100, True, Damping(), Goals())
    weights, step = (
        network.initial(3),
        1e-3 * np.random.default_rng(0).normal(size=network.n_weights),
    )
    second = (
        (network.jacobian(weights + 1e-2 * step, u) - network.jacobian(weights - 1e-2 * step, u))
        @ step
        / 2e-2
    )
    expected = network.jacobian(weights, u)[100:].T @ second[100:]
    np.testing.assert_allclose(
        problem.curvature(weights, step), expected, atol=1e-3 * np.abs(expected).max()
    )


def test_evidence_of_independent_samples():
    """The fixed point of Foresee and Hagan with the number of samples that the errors are worth."""
    u, y = teacher_data(n=1500)
    target = 0.3 * y + 0.7 * np.sin(np.arange(1500) / 60.0)
    every, fewer = (
        train(Elman(2, 2), u, target, iterations=12, independent=k) for k in (False, True)
    )
    assert fewer.trace["gamma"][-1] < every.trace["gamma"][-1]
    worth = effective_samples(target - Elman(2, 2).simulate(fewer.weights, u))
    assert worth < 300.0 and fewer.effective_samples == pytest.approx(worth, rel=1e-9)
    gamma, beta, sse = (
        fewer.trace["gamma"][-1],
        fewer.trace["beta"][-1],
        fewer.trace["mse"][-1] * 1500,
    )
    assert beta == pytest.approx((worth - gamma) / (2.0 * sse), rel=1e-6)
    white = linear_data(n=400)
    once, again = (train(Linear(8), *white, iterations=20, independent=k) for k in (False, True))
    assert again.trace["gamma"][-1] == pytest.approx(once.trace["gamma"][-1], abs=0.5)


def test_gradient_in_the_trace_is_the_objectives():
    u, target = teacher_data(noise=0.02)
    network = Elman(2, 3)
    trained = train(network, u, target, iterations=4)
    alpha, beta = trained.trace["alpha"][-1], trained.trace["beta"][-1]

    def objective(weights):
        return (
            beta * np.sum((target - network.simulate(weights, u)) ** 2) + alpha * weights @ weights
        )

    steps = 1e-6 * np.eye(network.n_weights)
    slopes = [
        (objective(trained.weights + s) - objective(trained.weights - s)) / 2e-6 for s in steps
    ]
    assert trained.trace["gradient"][-1] == pytest.approx(np.linalg.norm(slopes), rel=1e-4)


def test_best_of_several_starts_is_kept():
    u, target = teacher_data(noise=0.01)
    several = train(Elman(2, 3), u, target, iterations=8, starts=4, seed=10)
    single = [train(Elman(2, 3), u, target, iterations=8, seed=10 + s) for s in range(4)]
    assert several.starts_mse == tuple(s.trace["mse"][-1] for s in single)
    assert several.best == int(np.argmin(several.starts_mse))
    np.testing.assert_array_equal(several.weights, single[several.best].weights)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_worse_half_is_left_behind_at_every_gate(threads):
    u, target = teacher_data(noise=0.01)
    goals = Goals(gradient=0.0, promise=0.0, mse=0.0)
    with threadpool_limits(1, "blas"):
        several = train(
            Elman(2, 3), u, target, iterations=50, starts=4, seed=10, goals=goals, threads=threads
        )
        single = [
            train(Elman(2, 3), u, target, iterations=50, seed=10 + s, goals=goals) for s in range(4)
        ]
    at = [[s.trace["mse"][min(k, len(s.trace["mse"]) - 1)] for k in range(51)] for s in single]
    second = sorted(sorted(range(4), key=lambda s: at[s][GATES[0]])[:2])
    winner = min(second, key=lambda s: at[s][GATES[1]])
    assert several.best == winner
    np.testing.assert_array_equal(several.weights, single[winner].weights)
    stopped = [GATES[1] if s in second else GATES[0] for s in range(4)]
    stopped[winner] = 50
    assert several.starts_mse == tuple(at[s][k] for s, k in enumerate(stopped))


def test_washout_leaves_a_wrong_beginning_out():
    u, target = teacher_data()
    spoilt = target.copy()
    spoilt[:100] += 5.0
    trained = train(Elman(2, 6), u, spoilt, iterations=150, washout=100)
    assert trained.samples == 1400 and trained.trace["mse"][-1] < 1e-10


def test_several_recordings_are_one_objective():
    u, target = teacher_data()
    halves = train(Linear(2), [u[:700], u[700:]], [target[:700], target[700:]], iterations=50)
    whole = train(Linear(2), u, target, iterations=50)
    np.testing.assert_allclose(halves.weights, whole.weights, rtol=1e-9)
    apart = train(Elman(2, 3), [u, u], [target, target], iterations=10)  # each from a zero state
    network = Elman(2, 3)
    assert apart.samples == 3000
    own = np.mean((target - network.simulate(apart.weights, u)) ** 2)
    assert apart.trace["mse"][-1] == pytest.approx(own, rel=1e-9)


# --- why it ended --------------------


def test_each_reason_is_said_in_words():
    u, target = teacher_data(noise=0.02)
    used_up = train(Elman(2, 5), u, target, iterations=3)
    assert used_up.why == "iterations used up" and not used_up.converged
    assert list(used_up.trace["iteration"]) == [0, 1, 2, 3]
    flat = train(
        Elman(2, 3), u, target, iterations=300, regularise=False, goals=Goals(gradient=1e-3)
    )
    assert (
        flat.why == "gradient below 0.001" and flat.converged and flat.trace["gradient"][-1] <= 1e-3
    )
    close = train(Elman(2, 3), u, target, iterations=300, goals=Goals(mse=1e-3))
    assert close.why == "mean squared error below 0.001" and close.converged
    settled = train(Elman(2, 3), u, target, iterations=300)
    assert (
        settled.why.startswith("settled")
        and settled.converged
        and settled.trace["iteration"][-1] < 300
    )
    to_the_end = train(
        Elman(2, 3), u, target, iterations=500, goals=Goals(gradient=0.0, promise=0.0)
    )
    assert (
        to_the_end.why == "mu reached 1e+10: no step lowers the objective" and to_the_end.converged
    )
    assert settled.trace["mse"][-1] == pytest.approx(to_the_end.trace["mse"][-1], rel=1e-6)
    assert settled.trace["gamma"][-1] == pytest.approx(to_the_end.trace["gamma"][-1], abs=1e-3)


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


def test_overflow_at_the_start_is_called_divergence():
    diverged = train(Cliff(8), *linear_data(), iterations=10)
    assert diverged.why.startswith("diverged") and not diverged.converged
    assert np.isfinite(diverged.weights).all() and len(diverged.trace["mse"]) == 0


def test_overflow_on_the_way_is_a_rejected_step():
    u, target = linear_data()
    best = np.linalg.lstsq(u, target, rcond=None)[0]
    edge = 0.9 * np.abs(best).max()
    seed = next(s for s in range(100) if np.abs(Linear(8).initial(s)).max() < edge)
    trained = train(Cliff(8, edge), u, target, iterations=30, seed=seed, regularise=False)
    assert np.abs(trained.weights).max() <= edge
    assert trained.trace["mse"][-1] < trained.trace["mse"][0]


def test_a_wrong_derivative_is_not_called_converged():
    lost = train(Cliff(8, 1e9, True), *linear_data(), iterations=50, regularise=False)
    assert lost.why.startswith(
        "mu reached 1e+10: no step lowers the objective, though a full step promises"
    )
    assert not lost.converged


def test_trace_as_csv():
    trained = train(Linear(8), *linear_data(), iterations=3)
    header, *rows = [line.split(",") for line in trace_csv(trained).decode().splitlines()]
    assert header == ["iteration", "mse", "gradient", "mu", "gamma", "alpha", "beta", "trials"]
    assert [row[0] for row in rows] == ["0", "1", "2", "3"]
    assert float(rows[-1][1]) == trained.trace["mse"][-1]
    # no clock in it
    assert trace_csv(train(Linear(8), *linear_data(), iterations=3)) == trace_csv(trained)


# --- bad data --------------------


def spoil(table, row, column, value):
    table = table.copy()
    table[row, column] = value
    return table


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda u, t: (u[:10], t[:10]), "10 samples cannot decide 22 weights"),
        (lambda u, t: (spoil(u, 17, 1, np.nan), t), "Row 17, column 'input 1' is nan"),
        (
            lambda u, t: (u, spoil(t[:, None], 23, 0, np.inf)[:, 0]),
            "Row 23, column 'target' is inf",
        ),
        (lambda u, t: (u, t[:-1]), r"inputs \(N, m\) and target \(N,\) expected"),
        (lambda u, t: ([u, u], [t]), "2 recordings of inputs but 1"),
    ],
)
def test_data_that_cannot_be_fitted(change, words):
    with pytest.raises(DataError, match=words):
        train(Elman(2, 3), *change(*teacher_data()), iterations=1)


def test_options_that_cannot_be_met():
    u, target = teacher_data()
    with pytest.raises(DataError, match="washout of 1500"):
        train(Elman(2, 3), u, target, washout=1500)
    with pytest.raises(DataError, match="5 samples cannot decide"):
        train(Elman(2, 3), u, target, washout=1495)
    for wrong in (
        {"starts": 0},
        {"iterations": -1},
        {"washout": -1},
        {"seed": -1},
        {"iterations": 2.5},
    ):
        (name,) = wrong
        with pytest.raises(DataError, match=f"{name} to be a whole number"):
            train(Elman(2, 3), u, target, **wrong)
