"""Two effects at once on a small cart: both named, also where none of them is anything by itself;
one planted is one named, and none none."""

from pathlib import Path

import pytest
from small_cart import FEW, cart_evidence, record_cart

from pamid.base.parallel.jobs import WorkerPool
from pamid.base.parallel.result_store import Store
from pamid.diagnosis import selection
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.registry import effects

LATE_AND_RUBBING = ("coulomb-friction", "dead-time")


def found_with(folder: Path, *planted: str) -> Diagnosis:
    catalogue = {k: v for k, v in effects().items() if k in FEW}
    return diagnose(cart_evidence(record_cart(folder, planted)), catalogue)


def steps_of(d: Diagnosis) -> tuple[selection.SelectionStep, ...]:
    assert d.selection is not None
    return d.selection.steps


def named(d: Diagnosis) -> set[str]:
    return {c.effect for c in diagnosis_file(d).causes}


def test_a_pair_without_a_first_effect_to_build_on(tmp_path):
    """Alone neither removes anything, so that the first step has an empty set. The linear solve
    proposes the pair, which removes nearly all."""
    d = found_with(tmp_path, *LATE_AND_RUBBING)
    assert d.verdict == "explained" and named(d) == set(LATE_AND_RUBBING)
    assert all(d.comparison.removed(c).share < DEFAULT.material_share for c in d.ranking)
    alone, pairs = steps_of(d)
    assert not alone.tied and pairs.reference is d.budget.baseline
    assert {a.label for a in pairs.tied[0].attached} == set(LATE_AND_RUBBING)
    assert d.removed is not None and d.removed.share > 0.95


def test_a_slight_one_beside_a_plain_one(tmp_path):
    """Friction of a hundredth of the push, a tenth of the gap, at a port where little seems to be
    missing beside the delay."""
    d = found_with(tmp_path, "coulomb-friction:force_n=0.05", "dead-time")
    assert named(d) == set(LATE_AND_RUBBING)


@pytest.mark.parametrize("planted", ["dead-time", "quadratic-drag"])
def test_one_planted_is_one_named(planted, tmp_path):
    d = found_with(tmp_path, planted)
    assert d.verdict == "explained" and named(d) == {planted}


def test_none_planted_is_none_named(tmp_path):
    d = found_with(tmp_path)
    assert d.verdict == "no-structural-gap" and named(d) == set()


def test_the_same_pair_from_two_processes_and_read_back(tmp_path):
    catalogue = {k: v for k, v in effects().items() if k in FEW}
    evidence = cart_evidence(record_cart(tmp_path, LATE_AND_RUBBING))
    alone = diagnosis_file(diagnose(evidence, catalogue)).as_json()
    for _ in range(2):
        pool = WorkerPool(2, Store(tmp_path / "store"))
        assert diagnosis_file(diagnose(evidence, catalogue, pool=pool)).as_json() == alone
    assert pool.worked == 0 < pool.from_store
