"""The batched pass against Elman's own, start by start, on the processor and where present on a
CUDA device."""

import numpy as np
import pytest
import torch

from pamid.base.errors import UsageError
from pamid.networks.batch import BatchedElman, require_device
from pamid.networks.elman import Elman

NO_CUDA = "torch sees no CUDA device here"
DEVICES = [
    "cpu",
    pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason=NO_CUDA)),
]
SIZES = [(5, 10), (1, 1), (2, 7)]


def record(inputs: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(1)
    return draw.uniform(-1.0, 1.0, (samples, inputs)), draw.uniform(-1.0, 1.0, samples)


def lively(network: Elman, starts: int = 3) -> np.ndarray:
    """Weights (starts, n) that remember across several blocks: the contexts of random starts,
    outputs of order one."""
    weights = np.stack([network.initial(seed) for seed in range(starts)])
    weights[:, -network.hidden - 1 :] = np.random.default_rng(2).uniform(
        -1.0, 1.0, (starts, network.hidden + 1)
    )
    return weights


def assert_alike(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal to 1e-10 of the largest entry of each start."""
    assert found.shape == expected.shape and found.dtype == np.float64
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10 * np.abs(other).max())


def one_by_one(network: Elman, weights: np.ndarray, *record: object) -> list[np.ndarray]:
    passes = [network.normal_equations(w, *record) for w in weights]  # type: ignore[arg-type]
    return [np.array(column) for column in zip(*passes, strict=True)]


def states(network: Elman, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    """x(k+1) (N, h), from the equation."""
    layers, x, found = network.layers(weights), np.zeros(network.hidden), []
    for row in u:
        x = np.tanh(layers.context @ x + layers.input @ row + layers.bias)
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("inputs", "hidden"), SIZES)
@pytest.mark.parametrize("washout", [0, 10, 150])  # none, within the first block, beyond it
def test_normal_equations_equal_elmans(device, inputs, hidden, washout):
    network = Elman(inputs, hidden)
    u, target = record(inputs, 467)  # a prime: no block length divides it
    weights = lively(network)
    found = BatchedElman(network, device, block=64).normal_equations(weights, u, target, washout)
    for one, other in zip(found, one_by_one(network, weights, u, target, washout), strict=True):
        assert_alike(one, other)
    np.testing.assert_array_equal(found[1], found[1].transpose(0, 2, 1))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("washout", [0, 130, 467, 600])
def test_little_memory_leaves_no_seam(device, washout):
    network = Elman(2, 5)
    u, target = record(2, 467)
    weights = lively(network)
    block_bytes = 8 * len(weights) * network.n_weights * 32
    expected = one_by_one(network, weights, u, target, washout)
    for memory in (1, 2 * block_bytes + 1, 5 * block_bytes):
        found = BatchedElman(network, device, 32, memory).normal_equations(
            weights, u, target, washout
        )
        for one, other in zip(found, expected, strict=True):
            assert_alike(one, other)


@pytest.mark.parametrize(("inputs", "hidden"), SIZES)
def test_simulation_and_features_equal_elmans(inputs, hidden):
    network = Elman(inputs, hidden)
    u, _ = record(inputs, 300)
    weights = lively(network)
    batch = BatchedElman(network, "cpu")
    assert_alike(batch.simulate(weights, u), np.stack([network.simulate(w, u) for w in weights]))
    features = batch.features(weights, u)
    assert_alike(features[:, :, :-1], np.stack([states(network, w, u) for w in weights]))
    assert features.shape == (3, 300, hidden + 1) and (features[:, :, -1] == 1.0).all()


@pytest.mark.parametrize("device", DEVICES)
def test_a_wild_start_leaves_the_others_alone(device):
    network = Elman(2, 4)
    u, target = record(2, 500)
    weights = lively(network)
    tame = BatchedElman(network, device, block=50).normal_equations(weights[[0, 2]], u, target)
    weights[1] = 1e200
    found = BatchedElman(network, device, block=50).normal_equations(weights, u, target)
    assert found[0][1] > 1e300 or not np.isfinite(found[0][1])
    for one, other in zip(found, tame, strict=True):
        assert_alike(one[[0, 2]], other)
    weights[1] = np.nan
    sse, jtj, jte = BatchedElman(network, device, block=50).normal_equations(weights, u, target)
    assert np.isnan([sse[1], jtj[1, 0, 0], jte[1, 0]]).all() and np.isfinite([sse[0], sse[2]]).all()


def test_absent_cuda_is_told(monkeypatch):
    assert require_device("cpu") == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for name in ("cuda", "cuda:1"):
        with pytest.raises(UsageError, match="sees no CUDA device here.* use --device cpu"):
            require_device(name)
    with pytest.raises(UsageError, match=NO_CUDA):
        BatchedElman(Elman())
