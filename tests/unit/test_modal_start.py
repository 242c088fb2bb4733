"""A linear model by modes, and the start of an Elman network that is made of it."""

import numpy as np
import pytest

from pamid.networks.elman import Elman
from pamid.networks.modal_start import find_modes

POLE = 0.995 * np.exp(0.05j)


def ringing(n=6000, seed=0):
    """Held random levels into one lightly damped mode; target within [-1, 1]."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-1.0, 1.0, (n // 300, 2)), 300, axis=0)
    z, out = 0j, np.empty(len(u))
    for k, row in enumerate(u):
        z = POLE * z + (0.02 - 0.01j) * row[0] + 0.01j * row[1]
        out[k] = 0.1 + z.real
    return u, out / 2.0


def test_a_ringing_mode_is_found():
    u, target = ringing()
    found = find_modes([(u, target)], 0, 2, seed=0)
    turn = np.angle(found.poles[0])
    assert 0.04 < turn < 0.0625 and np.all(np.abs(found.poles) < 1.0)
    model = found.bias + found.states(u).real.sum(axis=1)
    assert np.mean((target - model) ** 2) < 0.05 * target.var()


@pytest.mark.parametrize("hidden", [4, 5])
def test_the_network_begins_as_that_model(hidden):
    u, target = ringing()
    network = Elman(2, hidden)
    found = find_modes([(u, target)], 0, hidden // 2, seed=2)
    weights = network.start([(u, target)], 0, 2)
    layers = network.layers(weights)
    if hidden % 2 == 0:
        eigenvalues = np.sort_complex(np.linalg.eigvals(layers.context))
        np.testing.assert_allclose(
            eigenvalues, np.sort_complex(np.concatenate([found.poles, found.poles.conj()]))
        )
    states = network.features(weights, u)[:, : hidden // 2 * 2]
    assert np.abs(states).max() < 0.4  # tanh bends it little
    assert np.mean((target - network.simulate(weights, u)) ** 2) < 0.3 * target.var()
