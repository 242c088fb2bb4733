"""Starts that run side by side and share one engine for their passes."""

import numpy as np
import pytest

from pamid.networks.batch import BatchedElman
from pamid.networks.elman import Elman
from pamid.networks.network_training import train


def records():
    draw = np.random.default_rng(2)
    us = [np.repeat(draw.uniform(-1.0, 1.0, (40, 2)), 20, axis=0)[:n] for n in (800, 500)]
    teacher = Elman(2, 3)
    return us, [
        teacher.simulate(0.5 * np.random.default_rng(7).normal(size=teacher.n_weights), u)
        for u in us
    ]


class Counting:
    """An engine that notes how many starts share each of its batches."""

    def __init__(self, network):
        self.inner, self.sizes = BatchedElman(network, device="cpu", block=64), []

    def normal_equations(self, weights, *rest):
        self.sizes.append(len(weights))
        return self.inner.normal_equations(weights, *rest)


def test_a_batch_serves_all_starts_and_changes_nothing():
    network = Elman(2, 3)
    us, ts = records()
    alone = train(network, us, ts, iterations=6, starts=3, washout=30)
    engine = Counting(network)
    together = train(network, us, ts, iterations=6, starts=3, washout=30, engine=engine)
    np.testing.assert_allclose(together.starts_mse, alone.starts_mse, rtol=1e-6)
    np.testing.assert_allclose(together.weights, alone.weights, rtol=1e-5, atol=1e-7)
    assert set(engine.sizes) == {3} and len(engine.sizes) == 2 * 7


def test_starts_that_end_early_leave_the_others_alone():
    network = Elman(2, 3)
    us, ts = records()
    engine = Counting(network)
    trained = train(network, us, ts, iterations=45, starts=4, engine=engine)
    assert engine.sizes[0] == 4 and engine.sizes[-1] == 1
    assert trained.trace["iteration"][-1] <= 45


def test_an_error_of_the_engine_reaches_the_caller():
    class Broken:
        def normal_equations(self, *arguments):
            raise MemoryError("the device is full")

    us, ts = records()
    with pytest.raises(MemoryError, match="device is full"):
        train(Elman(2, 3), us, ts, iterations=3, starts=2, engine=Broken())
