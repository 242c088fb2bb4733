"""Errors, shrinkage and their interval."""

from __future__ import annotations

import numpy as np
import pytest

from pamid.base.errors import DataError
from pamid.base.metrics import (
    block_sums,
    mae,
    moving_block_interval,
    rms,
    shrinkage,
    shrinkage_interval,
)


def test_mae_and_rms_by_hand() -> None:
    assert mae([1.0, 2.0, 3.0], [1.0, 0.0, 4.0]) == 1.0
    assert rms([3.0, 0.0, 0.0], [0.0, 0.0, 0.0]) == pytest.approx(3**0.5)
    assert rms([3.0, 4.0]) == pytest.approx(12.5**0.5)


def test_shrinkage() -> None:
    assert shrinkage(1.2887, 0.9793) == pytest.approx(0.24, abs=5e-4)  # the first paper's table
    assert shrinkage(1.0, 1.5) == -0.5
    assert shrinkage(0.0, 0.0) == 0.0
    for before, after in ((0.0, 1.0), (-1.0, 0.5), (1.0, float("nan")), (float("inf"), 1.0)):
        with pytest.raises(DataError):
            shrinkage(before, after)


def test_block_sums_keep_the_whole_loss() -> None:
    sums = block_sums(np.arange(10.0), 3)
    np.testing.assert_array_equal(sums, [3.0, 12.0, 30.0])
    assert block_sums([1.0, 2.0], 5).tolist() == [3.0]
    with pytest.raises(DataError):
        block_sums([], 3)


def test_interval_is_seeded_and_holds_the_ratio() -> None:
    random = np.random.default_rng(3)
    before = random.uniform(0.5, 1.5, 60)
    after = 0.3 * before + 0.1 * random.random(60)
    interval = shrinkage_interval(before, after, seed=5)
    assert interval == shrinkage_interval(before, after, seed=5)
    assert interval != shrinkage_interval(before, after, seed=6)
    assert interval[0] < 1 - after.sum() / before.sum() < interval[1]
    low, high = moving_block_interval(after, before, seed=5)
    assert (1 - high, 1 - low) == interval


def test_interval_covers_the_truth_when_errors_are_alike_in_time() -> None:
    """95 % intervals over 150 worlds with autocorrelated losses; independent draws would cover far
    fewer."""
    random = np.random.default_rng(11)
    hits = {1: 0, 12: 0}
    for _ in range(150):
        noise = np.zeros(200)
        for k in range(1, 200):
            noise[k] = 0.8 * noise[k - 1] + 0.1 * random.standard_normal()
        after = np.exp(noise)
        truth = np.exp(0.5 * 0.01 / (1 - 0.64))
        for length in hits:
            low, high = moving_block_interval(
                after, np.ones(200), block_length=length, resamples=300
            )
            hits[length] += low < truth < high
    assert hits[12] >= 120
    assert hits[1] < 0.75 * hits[12]
