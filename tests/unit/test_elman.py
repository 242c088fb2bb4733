"""The Elman network against plain loops, finite differences and automatic differentiation."""

import math

import numpy as np
import pytest

from pamid.networks.elman import Elman


def record(inputs: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    return draw.uniform(-1.0, 1.0, (samples, inputs)), draw.uniform(-1.0, 1.0, samples)


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


@pytest.mark.parametrize(("inputs", "hidden"), [(5, 10), (1, 1), (3, 7), (2, 2)])
def test_simulation_follows_equations_9_and_10(inputs, hidden):
    network = Elman(inputs, hidden)
    u, _ = record(inputs, 60, seed=1)
    weights = np.random.default_rng(2).normal(size=network.n_weights)
    np.testing.assert_allclose(
        network.simulate(weights, u), by_hand(network, weights, u), rtol=0, atol=1e-12
    )


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
