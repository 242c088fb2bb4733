"""What every kind of network has to keep: one suite for all of them."""

import pkgutil
from dataclasses import replace

import numpy as np
import pytest

import pamid.networks
from pamid.base.errors import DataError
from pamid.networks.anfis import Anfis
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network import Network
from pamid.networks.network_training import train
from pamid.networks.trained_network import load_network, save_network, train_on_signals
from pamid.networks.training_problem import (
    TrainingOptions,
    TrainingProblem,
    recordings,
)

KINDS = [
    Elman(2, 3),
    Elman(1, 4),
    Anfis(2, 3),
    Narx(2, 3, stride=1),
    Narx(1, 2, 1, 3, stride=4),
]
#: sizes that only the derivative is tried with: one of a kind, more than one vector of units
SIZES = [Elman(5, 10), Elman(1, 1), Elman(1, 11), Narx(), Narx(1, 1, 0, 1, 1), Narx(2, 5, 3, 1, 7)]


@pytest.fixture(params=KINDS, ids=repr)
def network(request):
    return request.param


def record(network, n=900, seed=0):
    """Random levels, held and smoothed, within [-1, 1]; a target that bends and remembers."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-0.9, 0.9, (n // 15 + 1, network.inputs)), 15, axis=0)[:n]
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.9 * y[k - 1] + 0.1 * np.tanh(2.0 * u[k].sum())
    return u, 0.8 * y + 0.02 * draw.normal(size=n)


def weights_of(network, seed=1):
    return network.initial(seed) + 0.05 * np.random.default_rng(seed).normal(size=network.n_weights)


def test_every_kind_is_in_the_suite():
    modules = {m.name for m in pkgutil.iter_modules(pamid.networks.__path__)}
    kinds = {k.kind for k in Network.__subclasses__() if k.__module__.startswith("pamid.")}
    assert kinds == {k.kind for k in KINDS} and kinds <= modules


@pytest.mark.parametrize("network", [*KINDS, *SIZES], ids=repr)
def test_the_derivative_is_exact(network):
    u, _ = record(network, 120)
    w = weights_of(network)
    exact = network.jacobian(w, u)
    for j in range(network.n_weights):
        step = np.zeros(network.n_weights)
        step[j] = 1e-6
        slope = (network.simulate(w + step, u) - network.simulate(w - step, u)) / 2e-6
        np.testing.assert_allclose(exact[:, j], slope, atol=2e-8 * max(1.0, np.abs(exact).max()))


def test_sums_are_those_of_the_jacobian(network):
    u, t = record(network, 2500)  # several chunks
    w = weights_of(network)
    whole, errors = network.jacobian(w, u), t - network.simulate(w, u)
    for threads, washout in ((1, 70), (2, 70), (1, 0), (1, 1500)):
        jacobian, error = whole[washout:], errors[washout:]
        sse, jtj, jte = network.normal_equations(w, u, t, washout, threads)
        assert sse == pytest.approx(error @ error, rel=1e-10)
        np.testing.assert_allclose(
            jtj, jacobian.T @ jacobian, rtol=1e-9, atol=1e-9 * np.abs(jtj).max()
        )
        np.testing.assert_allclose(
            jte, jacobian.T @ error, rtol=1e-8, atol=1e-9 * np.abs(jtj).max()
        )
    one, two = (network.normal_equations(w, u, t, 70, threads) for threads in (1, 2))
    assert one[0] == two[0] and (one[1] == two[1]).all() and (one[2] == two[2]).all()


def test_curvature_is_that_of_the_jacobian(network):
    u, _ = record(network, 2500)
    w, step = weights_of(network), 1e-2 * np.random.default_rng(3).normal(size=network.n_weights)
    second = (
        (network.jacobian(w + 1e-2 * step, u) - network.jacobian(w - 1e-2 * step, u)) @ step / 2e-2
    )
    expected = network.jacobian(w, u)[70:].T @ second[70:]
    np.testing.assert_allclose(
        network.curvature(w, step, u, 70), expected, atol=1e-3 * np.abs(expected).max()
    )


def test_linear_weights_are_linear(network):
    u, _ = record(network)
    w = weights_of(network)
    features = network.features(w, u)
    assert features.shape == (len(u), network.linear.stop - network.linear.start)
    if features.shape[1]:
        np.testing.assert_allclose(features @ w[network.linear], network.simulate(w, u), atol=1e-12)
        other = w.copy()
        other[network.linear] = 0.0
        np.testing.assert_array_equal(network.features(other, u), features)


def test_starts_are_finite_differ_by_seed_and_repeat(network):
    records = [record(network), record(network, seed=5)]
    one, again, other = (network.start(records, 20, seed) for seed in (0, 0, 1))
    assert one.shape == (network.n_weights,) and np.isfinite(one).all()
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    assert np.isfinite(network.simulate(one, records[0][0])).all()


def test_wild_weights_overflow_quietly(network):
    u, t = record(network)
    for w in (np.full(network.n_weights, 1e300), np.full(network.n_weights, np.nan)):
        assert network.simulate(w, u).shape == (len(u),)
        network.normal_equations(w, u, t)
        problem = TrainingProblem(network, recordings(u, t))
        assert (
            not np.isfinite(problem.errors(w).sse)
            or problem.evaluate(np.full_like(w, np.nan)) is None
        )


def test_wrong_shapes_are_refused(network):
    u, t = record(network)
    w = weights_of(network)
    for call in (
        lambda: network.simulate(w[:-1], u),
        lambda: network.simulate(w, u[:, :0]),
        lambda: network.normal_equations(w, u, t[:-1]),
    ):
        with pytest.raises(DataError):
            call()


def test_learns_and_comes_back_from_disk(network, tmp_path):
    u, t = record(network)
    constant = np.mean((t - t.mean()) ** 2)
    signals = {f"u{j}_deg": u[:, j] for j in range(network.inputs)}
    trained, training = train_on_signals(
        network,
        signals,
        t,
        output_name="y_deg",
        period_s=0.003,
        options=TrainingOptions(iterations=25, starts=2),
    )
    assert np.all(np.diff(training.trace["mse"]) <= 0.0) or training.trace["alpha"].any()
    assert np.mean((t - trained.predict(signals)) ** 2) < 0.7 * constant
    save_network(tmp_path, trained)
    loaded = load_network(tmp_path)
    np.testing.assert_array_equal(loaded.predict(signals), trained.predict(signals))
    assert replace(loaded, weights=trained.weights) == trained


@pytest.mark.parametrize("stop", [1, 12])
def test_resuming_shows_in_no_bit(network, tmp_path, stop):
    def interrupt(step, start):
        if step.iteration == stop:
            raise KeyboardInterrupt

    u, t = record(network)
    whole = train(network, u, t, options=TrainingOptions(iterations=14))
    train(
        network,
        u,
        t,
        options=TrainingOptions(iterations=14, checkpoint=tmp_path / "c.npz", progress=interrupt),
    )
    again = train(
        network,
        u,
        t,
        options=TrainingOptions(iterations=14, checkpoint=tmp_path / "c.npz", resume=True),
    )
    np.testing.assert_array_equal(again.weights, whole.weights)
    np.testing.assert_array_equal(again.trace["mse"], whole.trace["mse"])


def test_the_number_of_threads_does_not_show(network):
    u, t = record(network)
    runs = [
        train(network, u, t, options=TrainingOptions(iterations=22, starts=3, threads=k)).weights
        for k in (1, 2, 4)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])


@pytest.mark.parametrize(
    "change, words",
    [
        (
            lambda u, t: (u, np.where(np.arange(len(t)) == 30, np.nan, t)),
            "Row 30, column 'y_deg' is nan",
        ),
        (lambda u, t: (np.full_like(u, 0.3), t), "constant"),
        (lambda u, t: (u[12:18], t[12:18]), "6 samples cannot decide"),
    ],
)
def test_data_that_cannot_be_fitted(network, change, words):
    u, t = change(*record(network))
    signals = {f"u{j}_deg": u[:, j] for j in range(network.inputs)}
    with pytest.raises(DataError, match=words):
        train_on_signals(
            network,
            signals,
            t,
            output_name="y_deg",
            period_s=0.003,
            options=TrainingOptions(iterations=2),
        )
