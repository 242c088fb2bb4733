"""The static derivative that the exact one is compared with."""

import numpy as np
import pytest
from scripts import load_script

import pamid.networks.elman as elman_module
from pamid.networks.elman import Elman


@pytest.fixture(scope="module")
def static() -> Elman:
    """A small network with the static derivative."""
    network: Elman = load_script("peers/static_derivative.py").StaticElman(3, 4)
    return network


def drawn(samples: int, memory: float) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and weights, the context matrix of a norm of `memory`."""
    network, draw = Elman(3, 4), np.random.default_rng(1)
    layers = network.layers(draw.uniform(-1.0, 1.0, network.n_weights))
    context = memory / np.linalg.norm(layers.context, 2) * layers.context
    layers.context[:] = context
    return draw.uniform(-1.0, 1.0, (samples, 3)), network.flatten(layers)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_static_derivative_is_that_of_the_layer_with_its_state_given(static, monkeypatch, memory):
    monkeypatch.setattr(elman_module, "CHUNK", 16)  # the state must pass from chunk to chunk
    u, weights = drawn(70, memory)
    layers, found, x = static.layers(weights), static.jacobian(weights, u), np.zeros(4)
    for row, derivative in zip(u, found, strict=True):
        seen = np.concatenate([x, row, [1.0]])
        x = np.tanh(layers.context @ x + layers.input @ row + layers.bias)
        wanted = np.concatenate([np.outer(layers.output * (1.0 - x**2), seen).ravel(), x, [1.0]])
        np.testing.assert_allclose(derivative, wanted, rtol=0, atol=1e-13)
    exact = Elman(3, 4).jacobian(weights, u)
    assert np.allclose(found, exact, rtol=0, atol=1e-13) == (memory == 0.0)


def test_training_uses_the_static_derivative(static):
    u, weights = drawn(2_500, 0.8)
    target = np.random.default_rng(2).uniform(-1.0, 1.0, len(u))
    _, jtj, jte = static.normal_equations(weights, u, target)
    jacobian = static.jacobian(weights, u)
    np.testing.assert_allclose(jtj, jacobian.T @ jacobian, rtol=1e-10, atol=1e-8)
    np.testing.assert_allclose(
        jte, jacobian.T @ (target - static.simulate(weights, u)), rtol=1e-10, atol=1e-8
    )
    assert np.linalg.norm(
        jte - Elman(3, 4).normal_equations(weights, u, target)[2]
    ) > 0.01 * np.linalg.norm(jte)
    np.testing.assert_array_equal(static.simulate(weights, u), Elman(3, 4).simulate(weights, u))
