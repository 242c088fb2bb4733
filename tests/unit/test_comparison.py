"""Paired comparison of models on the same held-out windows, with made-up losses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_models import comparison, effect, model

from pamid.base.arrays import Array
from pamid.diagnosis.comparison import (
    ALIKE_NOISE,
    LEAST_ERROR,
    NOTHING,
    Comparison,
    paired_ratio,
)
from pamid.diagnosis.settings import Settings

WINDOWS = 24
FRICTION = effect("coulomb-friction", "friction")
LUGRE = effect("lugre-friction", "friction")
LEAK = effect("leak", port="chamber")
DELAY = effect("dead-time", port="command")


def uneven(windows: int = WINDOWS, seed: int = 0) -> Array:
    """Losses of a baseline, from 3 to 30 noise floors."""
    return np.random.default_rng(seed).uniform(3.0, 30.0, windows)


def noisy(losses: Array, spread: float, seed: int = 1) -> Array:
    """The losses, each changed by some share at random; the sum is the same."""
    changed = losses * (1.0 + spread * np.random.default_rng(seed).standard_normal(len(losses)))
    return changed * losses.sum() / changed.sum()


# ---- share removed ------------------------------------------------------------------------------


def test_the_same_share_of_every_window_is_certain_however_windows_differ():
    before = uneven()
    assert paired_ratio(before - 0.4 * before, before, 0) == pytest.approx((0.6, LEAST_ERROR))
    after = 1.0 + 0.4 * (before - 1.0)  # noise floors: 60 % of the gap
    evenly = comparison(before).removed(model(after, FRICTION))
    unevenly = comparison(before).removed(model(noisy(after, 0.5), FRICTION))
    assert evenly.z > 100.0 * unevenly.z
    assert evenly.high - evenly.low < 0.01 * (unevenly.high - unevenly.low)
    assert evenly.share == pytest.approx(0.6)
    assert unevenly.low < evenly.low < evenly.high < unevenly.high


@pytest.mark.parametrize(
    ("left", "share"),
    [(3.0, 0.5), (0.9, 1.0), (7.0, -0.5)],
    ids=["half", "no more than the gap", "worse"],
)
def test_share_is_one_of_the_gap_above_the_noise_floor(left, share):
    found = comparison(np.full(WINDOWS, 5.0))
    assert found.gap.sum() == pytest.approx(4.0 * WINDOWS)
    removed = found.removed(model(np.full(WINDOWS, left), FRICTION))
    assert removed.share == pytest.approx(share) and removed.rest.share == pytest.approx(
        1.0 - share
    )
    assert share < 1.0 or removed.high == 1.0
    stated = found.removed(model(np.full(WINDOWS, 2.0), FRICTION), losses=np.full(WINDOWS, left))
    assert stated.share == pytest.approx(share), "losses in place of the model's"


def test_the_standard_error_is_that_of_repeated_recordings():
    """The bootstrap error of independent windows is the spread of the share over fresh ones."""
    shares, errors = [], []
    for seed in range(200):
        random = np.random.default_rng(seed)
        before = random.uniform(3.0, 30.0, WINDOWS)
        after = 0.4 * before * random.lognormal(0.0, 0.4, WINDOWS)
        share, error = paired_ratio(before - after, before, seed)
        shares.append(share)
        errors.append(error)
    assert np.median(errors) == pytest.approx(np.std(shares), rel=0.25)


def test_an_interval_holds_the_share_and_its_rest_mirrors_it():
    before = uneven()
    removed = comparison(before).removed(model(noisy(0.4 * before, 0.5), FRICTION))
    assert removed.low < removed.share < removed.high
    rest = removed.rest
    assert (rest.share, rest.low, rest.high) == pytest.approx(
        (1.0 - removed.share, 1.0 - removed.high, 1.0 - removed.low)
    )


def test_a_single_window_and_no_gap_compare_nothing():
    c, found = model([1.0], FRICTION), comparison([9.0])
    assert found.removed(c) == NOTHING
    assert found.shrinkage(c) == (0.0, 0.0, 0.0)
    assert not found.is_material(c, found.budget.baseline)
    closed = comparison(np.full(WINDOWS, 0.99))
    assert closed.removed(model(np.full(WINDOWS, 0.5), FRICTION)) == NOTHING


def test_two_windows_are_compared_with_a_wide_interval():
    few, many = np.array([9.0, 11.0]), np.tile([9.0, 11.0], 12)
    after_few, after_many = np.array([4.0, 7.0]), np.tile([4.0, 7.0], 12)
    wide = comparison(few).removed(model(after_few, FRICTION))
    narrow = comparison(many).removed(model(after_many, FRICTION))
    assert wide.share == pytest.approx(narrow.share)
    assert 0.0 < wide.z < 0.2 * narrow.z


# ---- invariance ---------------------------------------------------------------------------------


def test_order_of_windows_changes_no_share_and_hardly_its_certainty():
    before = uneven()
    after = noisy(0.4 * before, 0.5)
    rows = np.random.default_rng(7).permutation(WINDOWS)
    one = comparison(before).removed(model(after, FRICTION))
    other = comparison(before[rows]).removed(model(after[rows], FRICTION))
    assert other.share == pytest.approx(one.share)
    assert other.z == pytest.approx(one.z, rel=0.5)


def test_a_recording_that_lacks_a_channel_counts_with_the_others():
    before = np.full((WINDOWS, 2), 5.0)
    before[:6, 1] = np.nan
    after = np.where(np.isnan(before), np.nan, 3.0)
    floor = np.where(np.isnan(before), np.nan, 1.0)
    found = comparison(before, floor=floor)
    assert found.removed(model(after, FRICTION)).share == pytest.approx(0.5)


# ---- material, tied, at the floor ---------------------------------------------------------------


def test_material_needs_size_and_certainty():
    before = uneven()
    found = comparison(before)
    base = found.budget.baseline
    assert found.is_material(model(0.6 * before, FRICTION), base)
    assert not found.is_material(model(0.99 * before, FRICTION), base), "certain, but small"
    assert not found.is_material(model(noisy(0.6 * before, 3.0), FRICTION), base), "large by luck"


def test_material_is_a_share_of_the_whole_gap_next_to_any_other_effect():
    before = np.full(WINDOWS, 101.0)
    found = comparison(before)
    first = model(np.full(WINDOWS, 41.0), FRICTION)  # 40 % of the gap remains
    for left, material in ((24.0, True), (30.0, False)):
        both = model(np.full(WINDOWS, left), FRICTION, LEAK)
        assert found.is_material(both, first) == material
        assert found.removed(both, first).share == pytest.approx((41.0 - left) / 100.0)


def test_ties_by_standard_errors_and_by_margin():
    before = uneven()
    settings = Settings(tie_errors=2.0, tie_margin=0.03)
    found = comparison(before, settings=settings)
    best = model(0.40 * before, FRICTION)
    assert found.is_tied(model(0.41 * before, LEAK), best), "certain, but less than the margin"
    assert found.is_tied(model(noisy(0.45 * before, 0.5), LEAK), best), "more, but by luck"
    assert not found.is_tied(model(0.50 * before, LEAK), best)
    assert not found.is_tied(model(noisy(0.60 * before, 0.1), LEAK), best)


@pytest.mark.parametrize(
    ("after", "floors", "at_floor"),
    # the last: channels below their floors leave no gap to take shares of
    [([1.05, 2.1], 1.05, True), ([1.05, 2.4], 1.2, False), ([0.85, 2.4], 1.2, True)],
)
def test_at_the_floor_means_every_channel(after, floors, at_floor):
    found = comparison(np.full((WINDOWS, 2), 8.0), floor=[1.0, 2.0])
    c = model(np.tile(after, (WINDOWS, 1)), FRICTION)
    assert found.floors(c) == pytest.approx(floors) and found.at_floor(c) == at_floor


# ---- confidence set -----------------------------------------------------------------------------


def test_confidence_set_holds_one_model_per_family_best_first():
    before = uneven()
    found = comparison(before)
    best = model(0.400 * before, LUGRE, parameters=7)
    models = [
        model(0.405 * before, LEAK),
        model(0.402 * before, FRICTION, parameters=4),
        best,
        model(0.700 * before, DELAY),
    ]
    chosen = found.confidence_set(models, found.budget.baseline)
    assert [c.label for c in chosen] == ["coulomb-friction@joint", "leak@chamber"]
    assert found.confidence_set(models[::-1], found.budget.baseline) == chosen


def test_only_what_is_material_is_a_member():
    before = uneven()
    found = comparison(before)
    certain, small = model(0.8 * before, FRICTION), model(0.97 * before, LEAK)
    by_luck = model(noisy(0.8 * before, 2.0), LEAK)
    assert found.is_tied(by_luck, certain)
    assert found.confidence_set([certain, by_luck], found.budget.baseline) == [certain]
    assert found.confidence_set([small], found.budget.baseline) == []


def test_the_simplest_member_of_a_family_stands_for_it_unless_it_is_worse():
    before = uneven()
    found = comparison(before)
    fuller = model(0.400 * before, LUGRE, parameters=7)
    equal = model(0.405 * before, FRICTION, parameters=4)
    worse = model(0.500 * before, FRICTION, parameters=4)
    other = model(0.400 * before, LEAK, parameters=1)
    assert found.simplest(fuller, [fuller, equal, other]) is equal
    assert found.simplest(fuller, [fuller, worse, other]) is fuller
    assert found.simplest(equal, [fuller, equal]) is equal


def test_pairs_of_the_same_families_are_one_entry_whatever_their_order():
    before = uneven()
    found = comparison(before)
    one = model(0.30 * before, FRICTION, LEAK)
    turned = model(0.31 * before, LEAK, LUGRE, parameters=9)
    assert found.confidence_set([one, turned], found.budget.baseline) == [one]


# ---- models that predict the same ---------------------------------------------------------------


def predicting(offset: float) -> Any:
    """A model whose prediction is off by as many standard deviations of the noise."""
    samples = np.arange(50.0)[:, None]
    return SimpleNamespace(
        runs=(SimpleNamespace(model=samples + offset, scored=np.ones(50, bool)),)
    )


@pytest.mark.parametrize(
    ("apart", "same"), [(0.9 * ALIKE_NOISE, True), (2.4, True), (2.6, False), (-20.0, False)]
)
def test_models_predict_the_same_within_a_share_of_what_they_change(apart, same):
    evidence = SimpleNamespace(noise=np.array([1.0]))
    budget: Any = SimpleNamespace(
        model=SimpleNamespace(evidence=evidence),
        baseline=predicting(0.0),
        settings=Settings(alike_share=0.25),
    )
    found = Comparison(budget, 0).predict_the_same([predicting(10.0), predicting(10.0 + apart)])
    assert found is same


def test_error_removed_has_the_interval_of_the_windows():
    before = uneven()
    found = comparison(before)
    share, low, high = found.shrinkage(model(noisy(0.4 * before, 0.5), FRICTION))
    assert share == pytest.approx(0.6) and low < 0.6 < high < 1.0
