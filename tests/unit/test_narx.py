"""The NARX network against a plain loop and finite differences; its starts, its training, its
files."""

import math

import numpy as np
import pytest

from pamid.networks.narx import Narx
from pamid.networks.network_training import train
from pamid.networks.training_problem import TrainingOptions

SIZES = [  # inputs, hidden, input_lags, output_lags, stride
    Narx(),
    Narx(1, 1, 0, 1, 1),
    Narx(2, 3, 2, 2, 1),
    Narx(3, 4, 0, 3, 4),
    Narx(2, 5, 3, 1, 7),
]


def record(inputs: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    return draw.uniform(-1.0, 1.0, (samples, inputs)), draw.uniform(-1.0, 1.0, samples)


def lively(network: Narx, seed: int) -> np.ndarray:
    """Weights whose every unit matters: outputs of order one, feedback whose gains add up to at
    most 0.9."""
    draw = np.random.default_rng(seed)
    layers = network.layers(draw.uniform(-1.0, 1.0, network.n_weights))
    gain = np.abs(layers.output) @ np.abs(layers.feedback).sum(axis=1)
    return network.flatten(layers._replace(feedback=0.9 / gain * layers.feedback))


def by_hand(network: Narx, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The documented equations, straight from the documented layout of the weight vector."""
    h, s = network.hidden, network.stride
    per_unit = network.inputs * (network.input_lags + 1) + network.output_lags + 1
    y: list[float] = []
    for k in range(len(u)):
        z = [float(v) for lag in range(network.input_lags + 1) for v in u[max(k - lag * s, 0)]]
        z += [y[k - lag * s] if k >= lag * s else 0.0 for lag in range(1, network.output_lags + 1)]
        z += [1.0]
        total = weights[-1]
        for i in range(h):
            own = weights[i * per_unit : (i + 1) * per_unit]
            total += weights[h * per_unit + i] * math.tanh(
                sum(a * b for a, b in zip(own, z, strict=True))
            )
        y.append(float(total))
    return np.array(y)


@pytest.mark.parametrize("network", SIZES, ids=repr)
def test_simulation_follows_the_equations(network):
    u, _ = record(network.inputs, 80, seed=1)
    weights = lively(network, 2)
    np.testing.assert_allclose(
        network.simulate(weights, u), by_hand(network, weights, u), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    "network", [Narx(), Narx(2, 7, 1, 3, 5), Narx(1, 1, 0, 1, 1), Narx(5, 10, 2, 2, 1)], ids=repr
)
def test_starts_are_seeded_stable_and_forget(network):
    np.testing.assert_array_equal(network.initial(3), network.initial(3))
    assert not np.array_equal(network.initial(3), network.initial(4))
    for seed in range(8):
        weights = network.initial(seed)
        layers = network.layers(weights)
        # with tanh's slope 1
        poles = np.roots(np.concatenate([[1.0], -(layers.output @ layers.feedback)]))
        assert np.abs(poles).max() ** (1.0 / network.stride) < math.exp(-1.0 / 100.0) + 1e-9
        u, target = record(network.inputs, 20, seed)
        held = np.repeat(u, 100, axis=0)
        otherwise = np.concatenate([-held[:100], held[100:]])
        change = np.abs(network.simulate(weights, otherwise) - network.simulate(weights, held))
        assert change[:100].max() > 0.0 and change[-100:].max() < 1e-5 * change[:100].max()
        _, jtj, _ = network.normal_equations(weights, held, np.repeat(target, 100))
        assert np.isfinite(jtj).all() and np.sqrt(jtj.diagonal().max() / len(held)) < 100.0


def known_narx(samples: int = 1500) -> tuple[Narx, np.ndarray, np.ndarray]:
    """Held random levels into y(k) = 1.2 tanh(0.5 u(k) + 1.1 y(k-3) - 0.6 y(k-6)) + 0.3 tanh(2 u(k)
    + 0.5)."""
    network = Narx(1, 2, 0, 2, 3)
    weights = np.array([0.5, 1.1, -0.6, 0.0, 2.0, 0.0, 0.0, 0.5, 1.2, 0.3, 0.0])
    u = np.repeat(np.random.default_rng(15).uniform(-1.0, 1.0, (samples // 20, 1)), 20, axis=0)
    y = network.simulate(weights, u)
    return network, u, y / np.abs(y).max()


def test_learns_a_known_narx():
    network, u, target = known_narx()
    trained = train(network, u, target, options=TrainingOptions(iterations=150, starts=3))
    assert trained.trace["mse"][0] > 1e-2
    assert trained.trace["mse"][-1] < 1e-15, trained.starts_mse
    assert trained.summary["converged"]
