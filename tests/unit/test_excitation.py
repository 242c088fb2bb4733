"""Excitation signals and what they cover."""

import numpy as np
import pytest

from pamid.simulation.excitation.aprbs import aprbs, coverage

PERIOD = 0.003


def test_the_default_covers_the_range_evenly_from_rest():
    signal = aprbs(200, PERIOD, 40.0, seed=1)
    assert signal.shape == (66667,)
    assert not signal[: round(0.4 / PERIOD)].any()
    assert np.abs(signal).max() <= 40.0
    covers = coverage(signal, PERIOD, span=(-40, 40))
    assert covers.visited == 1.0 and covers.evenness > 0.98
    assert 0.4 - PERIOD <= covers.shortest_hold_s < covers.longest_hold_s <= 1.6 + PERIOD
    assert covers.steps == pytest.approx(200, abs=15)
    assert sum(covers.histogram) == pytest.approx(1.0)


def test_latin_levels_spread_better_than_chance():
    """Largest gap between neighbouring levels: a hypercube leaves at most two strata open."""

    def gap(levels):
        return float(np.diff(np.sort(levels)).max()) * levels.size / 2

    levels = np.unique(aprbs(100, PERIOD, 1.0, seed=2))
    by_chance = np.random.default_rng(2).uniform(-1.0, 1.0, levels.size)
    assert gap(levels) <= 2.1 < gap(by_chance)


def test_discrete_levels_are_each_used_equally_and_never_twice_running():
    signal = aprbs(200, PERIOD, 10.0, levels=5, seed=3)
    covers = coverage(signal, PERIOD)
    assert covers.levels == 5
    assert covers.longest_hold_s <= 1.6 + PERIOD
    held = signal[np.flatnonzero(np.diff(signal)) + 1]
    _, counts = np.unique(held, return_counts=True)
    assert counts.max() - counts.min() <= 1 + 1  # whole decks, and the one cut by the end


def test_rate_limit_holds():
    signal = aprbs(60, PERIOD, 40.0, rate_limit=100.0, seed=1)
    assert np.abs(np.diff(signal)).max() <= 100.0 * PERIOD * (1 + 1e-9)
    jumps = coverage(aprbs(60, PERIOD, 40.0, seed=1), PERIOD)
    assert coverage(signal, PERIOD).power_95_hz < jumps.power_95_hz


def test_it_says_what_it_cannot_excite():
    two = " ".join(coverage(aprbs(60, PERIOD, 1.0, levels=2), PERIOD).sentences())
    assert "even nonlinearities" in two and "does not visit" in two
    slow = " ".join(coverage(aprbs(60, PERIOD, 1.0), PERIOD).sentences())
    assert "even nonlinearities" not in slow and "does not visit" not in slow
    half = " ".join(coverage(aprbs(60, PERIOD, 1.0), PERIOD, span=(-2.0, 2.0)).sentences())
    assert "does not visit" in half
