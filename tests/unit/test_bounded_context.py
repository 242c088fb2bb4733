"""A training keeps contexts in which a small disturbance hardly grows along its recordings."""

import numpy as np
import pytest

import pamid.networks.levenberg_marquardt as steps
from pamid.networks.elman import Elman, ElmanLayers
from pamid.networks.network_training import train
from pamid.networks.training_problem import TrainingOptions


def latch(seed):
    """Held random levels (600, 1), and what holds the sign of the last large one: a memory without
    an end, which a context can only have by keeping what disturbs it, too."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-1.0, 1.0, (30, 1)), 20, axis=0)
    held, y = -1.0, np.empty(len(u))
    for k, (level,) in enumerate(u):
        held = np.sign(level) if abs(level) > 0.6 else held
        y[k] = 0.8 * held
    return u, y


def grown(network, weights, u):
    return network.growth(weights, network.features(weights, u))


def oscillator(decay, turn):
    """Two units that turn and decay, without a bias."""
    context = decay * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    units = np.column_stack([context, np.ones(2), np.zeros(2)])
    return Elman(1, 2).flatten(ElmanLayers(units, np.ones(2), 0.0))


@pytest.mark.parametrize("decay", [0.9, 1.02])
def test_a_context_at_rest_grows_by_the_size_of_its_pole(decay):
    found = grown(Elman(1, 2), oscillator(decay, 0.3), np.zeros((50, 1)))
    assert found == pytest.approx(50 * np.log(decay))


def test_growth_is_what_becomes_of_a_neighbour():
    network = Elman(2, 4)
    draw = np.random.default_rng(3)
    weights, u = 0.5 * draw.normal(size=network.n_weights), draw.uniform(-1.0, 1.0, (40, 2))
    layers, apart, total, x = network.layers(weights), 1e-6, 0.0, np.zeros(4)
    near = x + apart * np.full(4, 0.5)
    for row in u:
        x, near = (
            np.tanh(layers.context @ s + layers.input @ row + layers.bias) for s in (x, near)
        )
        distance = np.linalg.norm(near - x)
        total += np.log(distance / apart)
        near = x + apart / distance * (near - x)
    assert grown(network, weights, u) == pytest.approx(total, rel=1e-4)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_training_keeps_the_context_bounded(seed, monkeypatch):
    (u, y), network = latch(seed), Elman(1, 3)
    kept = train(network, u, y, options=TrainingOptions(iterations=40, seed=seed))
    assert grown(network, kept.weights, u) <= steps.GROWTH + 1e-9
    assert kept.trace["mse"][-1] < kept.trace["mse"][0]
    monkeypatch.setattr(steps, "_bounded", lambda *_: True)
    free = train(network, u, y, options=TrainingOptions(iterations=40, seed=seed))
    assert grown(network, free.weights, u) > 2.0 * steps.GROWTH


def test_as_in_the_paper_nothing_is_bounded(monkeypatch):
    u, y = latch(0)
    monkeypatch.setattr(Elman, "growth", lambda *_: pytest.fail("the paper does not ask"))
    assert (
        train(Elman(1, 3), u, y, options=TrainingOptions(iterations=3, plain=True)).trace[
            "iteration"
        ][-1]
        == 3
    )
