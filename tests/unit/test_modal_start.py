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
    assert found.error < 0.05 * target.var()
    turn = np.angle(found.poles[0])
    assert 0.04 < turn < 0.0625 and np.all(np.abs(found.poles) < 1.0)
    model = found.bias + found.states(u).real.sum(axis=1)
    assert np.mean((target - model) ** 2) == pytest.approx(found.error, rel=1e-6)


def test_recordings_begin_at_rest_and_washout_is_left_out():
    u, target = ringing()
    spoilt = target.copy()
    spoilt[:200] += 3.0
    whole = find_modes([(u, spoilt), (u, target)], 200, 2, seed=1)
    clean = find_modes([(u, target), (u, target)], 200, 2, seed=1)
    np.testing.assert_array_equal(whole.poles, clean.poles)
    np.testing.assert_allclose(whole.residues, clean.residues)


def test_another_seed_draws_other_poles():
    records = [ringing()]
    one, again, other = (find_modes(records, 0, 3, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.poles, again.poles)
    assert not np.intersect1d(one.poles, other.poles).size


def test_a_single_unit_is_a_start_too():
    u, target = ringing()
    assert np.isfinite(Elman(2, 1).start([(u, target)], 0, 0)).all()


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


def test_every_fourth_seed_begins_at_random():
    records = [ringing()]
    network = Elman(2, 4)
    np.testing.assert_array_equal(network.start(records, 0, 3), network.initial(3))
    assert not np.array_equal(network.start(records, 0, 2), network.initial(2))
