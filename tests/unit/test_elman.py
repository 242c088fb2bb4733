"""The Elman network against plain loops, finite differences and automatic differentiation."""

import math

import numpy as np
import pytest

import pamid.networks.elman as elman_module
from pamid.base.errors import DataError
from pamid.networks.elman import Elman


def record(inputs: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    return draw.uniform(-1.0, 1.0, (samples, inputs)), draw.uniform(-1.0, 1.0, samples)


def lively(network: Elman, seed: int) -> np.ndarray:
    """Weights whose every unit matters: dense context of spectral radius 0.9, outputs of order
    one."""
    draw = np.random.default_rng(seed)
    layers = network.layers(draw.uniform(-1.0, 1.0, network.n_weights))
    radius = np.abs(np.linalg.eigvals(layers.context)).max()
    layers.context[:] = 0.9 / radius * layers.context
    return network.flatten(layers)


def by_hand(network: Elman, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Eq. 9-10, straight from the documented layout of the weight vector."""
    h, m = network.hidden, network.inputs
    w = [float(v) for v in weights]
    unit = [w[i * (h + m + 1) : (i + 1) * (h + m + 1)] for i in range(h)]
    output, output_bias = w[-h - 1 : -1], w[-1]
    x, y = [0.0] * h, []
    for row in u:
        x = [
            math.tanh(
                sum(unit[i][j] * x[j] for j in range(h))
                + sum(unit[i][h + j] * row[j] for j in range(m))
                + unit[i][h + m]
            )
            for i in range(h)
        ]
        y.append(sum(output[i] * x[i] for i in range(h)) + output_bias)
    return np.array(y)


def central_differences(
    network: Elman, weights: np.ndarray, u: np.ndarray, step: float = 1e-5
) -> np.ndarray:
    columns = []
    for k in range(len(weights)):
        nudge = np.zeros_like(weights)
        nudge[k] = step
        columns.append(
            (network.simulate(weights + nudge, u) - network.simulate(weights - nudge, u))
            / (2.0 * step)
        )
    return np.column_stack(columns)


def static_jacobian(network: Elman, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The derivative that takes the fed-back state for an input that does not depend on the
    weights."""
    layers = network.layers(weights)
    rows, x = [], np.zeros(network.hidden)
    for row in u:
        seen = np.concatenate([x, row, [1.0]])
        x = np.tanh(layers.context @ x + layers.input @ row + layers.bias)
        rows.append(
            np.concatenate([np.outer(layers.output * (1.0 - x**2), seen).ravel(), x, [1.0]])
        )
    return np.array(rows)


def test_papers_network_has_171_weights():
    assert Elman().n_weights == 171
    assert Elman(5, 10).initial(0).shape == (171,)


@pytest.mark.parametrize(("inputs", "hidden"), [(5, 10), (1, 1), (3, 7), (2, 2)])
def test_simulation_follows_equations_9_and_10(inputs, hidden):
    network = Elman(inputs, hidden)
    u, _ = record(inputs, 60, seed=1)
    weights = np.random.default_rng(2).normal(size=network.n_weights)
    np.testing.assert_allclose(
        network.simulate(weights, u), by_hand(network, weights, u), rtol=0, atol=1e-12
    )


def test_output_sees_the_present_input():
    network, u = Elman(1, 2), np.zeros((4, 1))
    u[2] = 1.0
    weights = lively(network, 0)
    quiet = network.simulate(weights, np.zeros((4, 1)))
    change = np.abs(network.simulate(weights, u) - quiet)
    assert change[:2].max() == 0.0 and change[2] > 1e-3


@pytest.mark.parametrize(("inputs", "hidden"), [(5, 10), (1, 1), (2, 3), (3, 7), (1, 11)])
def test_jacobian_equals_central_differences(inputs, hidden):
    network = Elman(inputs, hidden)
    u, _ = record(inputs, 150, seed=3)
    weights = lively(network, 4)
    exact = network.jacobian(weights, u)
    assert exact.shape == (150, network.n_weights)
    np.testing.assert_allclose(exact, central_differences(network, weights, u), rtol=0, atol=1e-6)


def test_jacobian_equals_automatic_differentiation():
    torch = pytest.importorskip("torch")
    network = Elman(5, 10)
    u, _ = record(5, 60, seed=5)
    weights = lively(network, 6)

    def output(flat):
        units = flat[:-11].reshape(10, 16)
        context, entering, bias, out = units[:, :10], units[:, 10:15], units[:, 15], flat[-11:-1]
        x, y = torch.zeros(10, dtype=torch.float64), []
        for row in torch.from_numpy(u):
            x = torch.tanh(context @ x + entering @ row + bias)
            y.append(out @ x + flat[-1])
        return torch.stack(y)

    expected = torch.autograd.functional.jacobian(output, torch.from_numpy(weights)).numpy()
    np.testing.assert_allclose(network.jacobian(weights, u), expected, rtol=0, atol=1e-9)


def test_static_derivative_is_another_one():
    network = Elman(5, 10)
    u, target = record(5, 400, seed=7)
    weights = lively(network, 8)
    exact, static = network.jacobian(weights, u), static_jacobian(network, weights, u)
    # before anything was fed back they agree
    np.testing.assert_allclose(exact[0], static[0], atol=1e-12)
    assert np.linalg.norm(exact - static) > 0.2 * np.linalg.norm(exact)
    error = target - network.simulate(weights, u)
    towards, statically = exact.T @ error, static.T @ error
    assert towards @ statically < 0.99 * np.linalg.norm(towards) * np.linalg.norm(statically)


@pytest.mark.parametrize("washout", [0, 5, 64, 100, 199])
def test_pass_equals_stored_jacobian(monkeypatch, washout):
    monkeypatch.setattr(elman_module, "CHUNK", 64)  # several chunks, the last one short
    network = Elman(3, 5)
    u, target = record(3, 200, seed=9)
    weights = lively(network, 10)
    sse, jtj, jte = network.normal_equations(weights, u, target, washout)
    jacobian = network.jacobian(weights, u)[washout:]
    error = (target - network.simulate(weights, u))[washout:]
    assert sse == pytest.approx(error @ error, rel=1e-12)
    np.testing.assert_allclose(jtj, jacobian.T @ jacobian, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(jte, jacobian.T @ error, rtol=1e-11, atol=1e-11)


def test_chunks_leave_no_seam(monkeypatch):
    network = Elman(2, 4)
    u, _ = record(2, 300, seed=11)
    weights = lively(network, 12)
    whole = network.jacobian(weights, u)
    monkeypatch.setattr(elman_module, "CHUNK", 7)
    np.testing.assert_array_equal(network.jacobian(weights, u), whole)


def test_layers_and_flatten_are_inverse():
    network = Elman(4, 3)
    weights = np.arange(float(network.n_weights))
    layers = network.layers(weights)
    np.testing.assert_array_equal(network.flatten(layers), weights)
    np.testing.assert_array_equal(layers.context[1], [8.0, 9.0, 10.0])
    np.testing.assert_array_equal(layers.input[1], [11.0, 12.0, 13.0, 14.0])
    assert layers.bias[1] == 15.0 and layers.output_bias == network.n_weights - 1


def test_initial_weights_are_seeded_stable_and_remember():
    network = Elman(5, 10)
    np.testing.assert_array_equal(network.initial(3), network.initial(3))
    assert not np.array_equal(network.initial(3), network.initial(4))
    for sizes in ((5, 10), (1, 1), (2, 3)):
        for seed in range(5):
            layers = Elman(*sizes).layers(Elman(*sizes).initial(seed))
            decay = np.abs(np.linalg.eigvals(layers.context))
            assert np.all((np.exp(-1.0 / 2.0) < decay) & (decay < np.exp(-1.0 / 100.0)))
            # no transient growth either: sensitivities stay bounded
            assert np.linalg.norm(layers.context, 2) < 1.0
    assert np.linalg.norm(layers.output) < 0.02


def test_wild_weights_overflow_silently():
    network = Elman(2, 3)
    u, target = record(2, 2000, seed=13)
    sse, jtj, _ = network.normal_equations(np.full(network.n_weights, 1e200), u, target)
    assert sse > 1e300 or not np.isfinite(sse)
    assert jtj.shape == (network.n_weights, network.n_weights)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Elman(0, 10), "inputs must be a whole number"),
        (lambda: Elman(5, 2.5), "hidden must be a whole number"),  # type: ignore[arg-type]
        (lambda: Elman(2, 2).simulate(np.zeros(3), np.zeros((5, 2))), "has 13 weights"),
        (lambda: Elman(2, 2).simulate(np.zeros(13), np.zeros((5, 3))), r"takes inputs \(N, 2\)"),
        (
            lambda: Elman(2, 2).normal_equations(np.zeros(13), np.zeros((5, 2)), np.zeros(4)),
            "Target has shape",
        ),
    ],
)
def test_wrong_shapes_are_named(call, words):
    with pytest.raises(DataError, match=words):
        call()
