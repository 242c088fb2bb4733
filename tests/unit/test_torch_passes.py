"""Passes by torch against the compiled kernels, start by start, on the processor and where present
on a CUDA device; starts that run side by side and share one engine for them."""

import numpy as np
import pytest
import torch

from pamid.base.errors import DataError, UsageError
from pamid.networks.anfis import Anfis
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network_training import train
from pamid.networks.torch_passes import engine_on
from pamid.networks.training_problem import TrainingOptions

DEVICES = [
    "cpu",
    pytest.param(
        "cuda",
        marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device"),
    ),
]
NETWORKS = [Elman(5, 10), Elman(1, 1), Narx(5, 10), Narx(1, 1, 0, 1, 1), Narx(2, 4, 1, 3, 4)]
SMALL = [Elman(2, 3), Narx(2, 3, stride=2)]


def record(inputs, samples):
    draw = np.random.default_rng(1)
    return draw.uniform(-1.0, 1.0, (samples, inputs)), draw.uniform(-1.0, 1.0, samples)


def lively(network, starts=3):
    """Weights (starts, n) that remember across several blocks: those of random starts, with outputs
    of order one."""
    weights = np.stack([network.initial(seed) for seed in range(starts)])
    output = slice(-network.hidden - 1, None)
    draw = np.random.default_rng(2).uniform(-1.0, 1.0, (starts, network.hidden + 1))
    weights[:, output] = draw / np.sqrt(network.hidden)
    return weights


def assert_equal_to_ten_digits(values, expected):
    """Equal to 1e-10 of the largest entry of each start."""
    assert values.shape == expected.shape and values.dtype == np.float64
    for start, compiled in zip(values, expected, strict=True):
        np.testing.assert_allclose(start, compiled, rtol=0, atol=1e-10 * np.abs(compiled).max())


def compiled_sums(network, weights, *record):
    passes = [network.normal_equations(w, *record) for w in weights]
    return [np.array(column) for column in zip(*passes, strict=True)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("network", NETWORKS, ids=repr)
@pytest.mark.parametrize("washout", [0, 150, 600])  # none, beyond several blocks, everything
def test_loss_and_gradient_equal_the_compiled_kernels(device, network, washout):
    u, target = record(network.inputs, 467)  # a prime: no block length divides it
    weights = lively(network)
    expected = compiled_sums(network, weights, u, target, washout)
    block_bytes = 8 * len(weights) * network.n_weights * 32
    for block, memory in ((64, 2**30), (7, 1), (32, 2 * block_bytes + 1)):
        sums = engine_on(device, network, block, memory).normal_equations(
            weights, u, target, washout
        )
        for value, compiled in zip(sums, expected, strict=True):
            assert_equal_to_ten_digits(value, compiled)
        np.testing.assert_array_equal(sums[1], sums[1].transpose(0, 2, 1))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("network", NETWORKS, ids=repr)
@pytest.mark.parametrize("samples", [1, 300])
def test_batched_simulation_equals_the_compiled_kernels(device, network, samples):
    u, _ = record(network.inputs, samples)
    weights = lively(network)
    assert_equal_to_ten_digits(
        engine_on(device, network).simulate(weights, u),
        np.stack([network.simulate(w, u) for w in weights]),
    )


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("network", SMALL, ids=repr)
def test_a_wild_start_leaves_the_others_alone(device, network):
    u, target = record(2, 500)
    weights, engine = lively(network), engine_on(device, network, block=50)
    tame = engine.normal_equations(weights[[0, 2]], u, target)
    weights[1] = 1e200
    sums = engine.normal_equations(weights, u, target)
    assert sums[0][1] > 1e300 or not np.isfinite(sums[0][1])
    for value, alone in zip(sums, tame, strict=True):
        assert_equal_to_ten_digits(value[[0, 2]], alone)
    weights[1] = np.nan
    sse, jtj, jte = engine.normal_equations(weights, u, target)
    assert np.isnan([sse[1], jtj[1, 0, 0], jte[1, 0]]).all() and np.isfinite([sse[0], sse[2]]).all()


def test_passes_run_on_one_thread_and_leave_torch_as_it_was(monkeypatch):
    before, seen = torch.get_num_threads(), []
    bmm = torch.bmm
    monkeypatch.setattr(
        torch, "bmm", lambda *a, **k: (seen.append(torch.get_num_threads()), bmm(*a, **k))[1]
    )
    engine = engine_on("cpu", Elman(2, 3))
    engine.normal_equations(lively(Elman(2, 3)), *record(2, 50))
    assert set(seen) == {1} and torch.get_num_threads() == before
    with pytest.raises(DataError, match="weights .starts, 22."):
        engine.normal_equations(np.zeros(3), *record(2, 50))


def test_absent_devices_are_refused_with_a_cure(monkeypatch):
    assert engine_on(None, Elman()) is None and engine_on("cpu", Elman()) is not None
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(UsageError, match="built without CUDA.*Install torch from PyPI") as error:
        engine_on("cuda", Narx())
    assert "leave out --device" in error.value.hint
    monkeypatch.setattr(torch.version, "cuda", "12.8")
    with pytest.raises(UsageError, match="sees no CUDA device here.*nvidia-smi"):
        engine_on("cuda:1", Elman())
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(UsageError, match="cuda:0 only"):
        engine_on("cuda:1", Elman())
    with pytest.raises(UsageError, match="elman and narx networks, not anfis"):
        engine_on("cpu", Anfis(1))


# ---- training ----------------------------------------------------------------------------------


def held_records():
    draw = np.random.default_rng(2)
    us = [np.repeat(draw.uniform(-1.0, 1.0, (40, 2)), 20, axis=0)[:n] for n in (800, 500)]
    teacher = Elman(2, 3)
    weights = 0.5 * np.random.default_rng(7).normal(size=teacher.n_weights)
    return us, [teacher.simulate(weights, u) for u in us]


class Counting:
    """An engine that notes how many starts share each of its batches."""

    def __init__(self, network):
        self.inner, self.sizes = engine_on("cpu", network, block=64), []

    def normal_equations(self, weights, *rest):
        self.sizes.append(len(weights))
        return self.inner.normal_equations(weights, *rest)


@pytest.mark.parametrize("network", SMALL, ids=repr)
def test_training_takes_the_same_steps_and_one_batch_serves_all_starts(network):
    us, ts = held_records()
    options = {"iterations": 6, "starts": 3, "washout": 30}
    alone = train(network, us, ts, options=TrainingOptions(**options))
    engine = Counting(network)
    together = train(network, us, ts, engine=engine, options=TrainingOptions(**options))
    np.testing.assert_allclose(together.starts_mse, alone.starts_mse, rtol=1e-6)
    np.testing.assert_allclose(together.weights, alone.weights, rtol=1e-5, atol=1e-7)
    assert set(engine.sizes) == {3} and len(engine.sizes) == 2 * 7


def test_starts_that_end_early_leave_the_others_alone():
    us, ts = held_records()
    engine = Counting(Elman(2, 3))
    trained = train(
        Elman(2, 3), us, ts, engine=engine, options=TrainingOptions(iterations=45, starts=4)
    )
    assert engine.sizes[0] == 4 and engine.sizes[-1] == 1
    assert trained.trace["iteration"][-1] <= 45


def test_an_error_of_the_engine_reaches_the_caller():
    class Broken:
        def normal_equations(self, *arguments):
            raise MemoryError("the device is full")

    us, ts = held_records()
    with pytest.raises(MemoryError, match="device is full"):
        train(Elman(2, 3), us, ts, engine=Broken(), options=TrainingOptions(iterations=3, starts=2))
