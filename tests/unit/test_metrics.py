"""Errors, shrinkage and their interval."""

import numpy as np
import pytest

from pamid.base.errors import DataError
from pamid.base.metrics import (
    adjusted_share,
    independent_samples,
    mae,
    moving_block_interval,
    rms,
)


def test_mae_and_rms_by_hand():
    assert mae([1.0, 2.0, 3.0], [1.0, 0.0, 4.0]) == 1.0
    assert rms([3.0, 0.0, 0.0], [0.0, 0.0, 0.0]) == pytest.approx(3**0.5)
    assert rms([3.0, 4.0]) == pytest.approx(12.5**0.5)


def test_interval_is_seeded_and_holds_the_ratio():
    random = np.random.default_rng(3)
    before = random.uniform(0.5, 1.5, 60)
    after = 0.3 * before + 0.1 * random.random(60)
    interval = moving_block_interval(after, before, seed=5)
    assert interval == moving_block_interval(after, before, seed=5)
    assert interval != moving_block_interval(after, before, seed=6)
    assert interval[0] < after.sum() / before.sum() < interval[1]


def test_interval_covers_the_truth_when_errors_are_alike_in_time():
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


def test_shapes_must_agree():
    with pytest.raises(DataError, match="equal shape"):
        mae([1.0, 2.0], [1.0])
    with pytest.raises(DataError, match="equal shape"):
        mae([], [])


def test_longer_blocks_do_not_widen_the_interval_of_independent_errors():
    """Entries of one block are successive, not copies of each other."""
    after = np.random.default_rng(2).exponential(size=600)
    expected = 2 * 1.96 * after.std() / 600**0.5
    for length in (1, 8):
        low, high = moving_block_interval(after, np.ones(600), block_length=length)
        assert high - low == pytest.approx(expected, rel=0.2)


def test_interval_refuses_what_has_no_ratio():
    for above, below in (
        ([1.0], [1.0]),
        ([1.0, 2.0], [1.0]),
        ([1.0, 1.0], [0.0, 0.0]),
        ([np.nan, 1.0], [1.0, 1.0]),
    ):
        with pytest.raises(DataError):
            moving_block_interval(above, below)


def test_a_cycle_of_a_sine_holds_four_independent_samples():
    """However finely it is sampled; noise holds as many as there are samples."""
    random = np.random.default_rng(4)
    for count in (500, 5000):
        t = np.arange(count) / count
        for cycles in (2, 10):
            wave = np.sin(2.0 * np.pi * cycles * t + 0.3)
            assert independent_samples(wave, wave) == pytest.approx(4.0 * cycles, rel=0.1)
        noise = random.normal(size=count)
        assert independent_samples(noise, noise) == pytest.approx(count, rel=0.4)
        assert independent_samples(noise, wave) > 0.3 * count
    assert independent_samples(np.ones(50), noise[:50]) == 0.0


def test_a_share_that_chance_makes_is_none():
    """The mean of the adjusted share over independent noise is zero, whatever the parts."""
    random, parts, n = np.random.default_rng(7), 8, 40
    raw = []
    for _ in range(400):
        y = random.normal(size=(parts, n // parts))
        raw.append(float(y.mean(axis=1).var() / y.var()))
    mean = float(np.mean(raw))
    assert mean == pytest.approx((parts - 1.0) / (n - 1.0), rel=0.05)
    assert adjusted_share(mean, parts, n) == pytest.approx(0.0, abs=0.02)
    assert adjusted_share(0.9, parts, 1e6) == pytest.approx(0.9, abs=1e-4)
    assert adjusted_share(0.9, parts, 8.0) == adjusted_share(0.05, parts, n) == 0.0
