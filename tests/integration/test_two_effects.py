"""Two effects at once on a small cart: both named, also where none of them is anything by itself;
one planted is one named, and none none."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from small_cart import FEW, cart_evidence, record_cart

from pamid.diagnosis import selection
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.tournament import Diagnosis, diagnose
from pamid.model.attachment import Addition
from pamid.model.registry import effects
from pamid.parallel.jobs import WorkerPool
from pamid.parallel.result_store import Store
from pamid.verdict.verdict_figures import diagnosis_file

LATE_AND_RUBBING = ("coulomb-friction", "dead-time")


def found_with(folder: Path, *planted: str) -> Diagnosis:
    catalogue = {k: v for k, v in effects().items() if k in FEW}
    return diagnose(cart_evidence(record_cart(folder, planted)), catalogue)


def steps_of(d: Diagnosis) -> tuple[selection.SelectionStep, ...]:
    assert d.selection is not None
    return d.selection.steps


def named(d: Diagnosis) -> set[str]:
    return {c.effect for c in diagnosis_file(d).causes}


def test_a_pair_without_a_first_effect_to_build_on(tmp_path: Path) -> None:
    """Alone neither removes anything, so that the first step has an empty set. The linear solve
    proposes the pair, which removes nearly all."""
    d = found_with(tmp_path, *LATE_AND_RUBBING)
    assert d.verdict == "explained" and named(d) == set(LATE_AND_RUBBING)
    assert all(d.comparison.removed(c).share < DEFAULT.material_share for c in d.ranking)
    alone, pairs = steps_of(d)
    assert not alone.tied and pairs.reference is d.budget.baseline
    assert {a.label for a in pairs.tied[0].attached} == set(LATE_AND_RUBBING)
    assert d.removed is not None and d.removed.share > 0.95


def test_a_slight_one_beside_a_plain_one(tmp_path: Path) -> None:
    """Friction of a hundredth of the push, a tenth of the gap, at a port where little seems to be
    missing beside the delay."""
    d = found_with(tmp_path, "coulomb-friction:force_n=0.05", "dead-time")
    assert named(d) == set(LATE_AND_RUBBING)


@pytest.mark.parametrize("planted", ["dead-time", "quadratic-drag"])
def test_one_planted_is_one_named(planted: str, tmp_path: Path) -> None:
    d = found_with(tmp_path, planted)
    assert d.verdict == "explained" and named(d) == {planted}


def test_none_planted_is_none_named(tmp_path: Path) -> None:
    d = found_with(tmp_path)
    assert d.verdict == "no-structural-gap" and named(d) == set()


def test_the_same_pair_from_two_processes_and_read_back(tmp_path: Path) -> None:
    catalogue = {k: v for k, v in effects().items() if k in FEW}
    evidence = cart_evidence(record_cart(tmp_path, LATE_AND_RUBBING))
    alone = diagnosis_file(diagnose(evidence, catalogue)).as_json()
    for _ in range(2):
        pool = WorkerPool(2, Store(tmp_path / "store"))
        assert diagnosis_file(diagnose(evidence, catalogue, pool=pool)).as_json() == alone
    assert pool.worked == 0 < pool.from_store


# ---- the steps by themselves -----------------------------------------------------------------


def acting(label: str, family: str = "friction", *ports: str) -> Any:
    return SimpleNamespace(label=label, family=family, ports=ports)


def model(*attached: Any, left: float = 0.0) -> Any:
    """A model with these effects that leaves so much of the gap."""
    label = " + ".join(a.label for a in attached)
    additions = tuple(Addition((a,)) for a in attached)
    return SimpleNamespace(
        attached=attached, additions=additions, label=label, left=left, finite=True
    )


#: material is a tenth of the gap, as in `model`
COMPARED: Any = SimpleNamespace(
    is_material=lambda model, reference: reference.left - model.left > 0.1,
    removed=lambda model: SimpleNamespace(share=1.0 - model.left),
    at_floor=lambda model: False,
)


def test_a_family_is_tried_again_where_its_place_can_be_told() -> None:
    """Dry friction in two joints are two causes; two laws of it at one joint are one."""
    search: Any = SimpleNamespace(family=lambda a: a.family)
    best = model(acting("one", "friction", "elbow"))
    located: Any = SimpleNamespace(classes=(("elbow", "elbow_encoder"), ("shoulder",)))
    for port, taken in (("elbow", True), ("elbow_encoder", True), ("shoulder", False)):
        other = acting("other", "friction", port)
        assert selection._is_taken(search, other, best, located) == taken


def test_the_newest_is_dropped_where_it_only_led_out_of_a_minimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first alone had ended in a local minimum, the second brought it out of it and came to
    nothing."""
    both = model(acting("first"), acting("second"), left=0.1)
    left = {"first": 0.1, "second": 0.8}

    def refitted(search: Any, attached: tuple[Any, ...], *sources: Any) -> Any:
        return model(*attached, left=left[attached[0].label])

    monkeypatch.setattr(selection, "refitted_with", refitted)
    search: Any = None
    assert selection._needed_effects(search, COMPARED, both).label == "first"
    left["first"] = 0.9
    assert selection._needed_effects(search, COMPARED, both) is both


def test_an_exchange_of_effects_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where any second effect will do, and the first is dropped for it again and again, the search
    would never end."""
    names = iter(range(100))
    evidence: Any = SimpleNamespace(most=1e9, classes=(("guide",),))

    def one_step(comparison: Any, guards: Any, reference: Any, models: Any, reduce: Any) -> Any:
        return selection.SelectionStep(reference, (), tuple(models))

    for name, stand_in in {
        "compared": one_step,
        "with_finer_steps": lambda search, c: c,
        "_located_after": lambda *given: evidence,
        "responses_of": lambda *given: None,
        "_larger": lambda *given: [model(acting("first"), acting("second"), left=0.3)],
        "_needed_effects": lambda *given: model(acting(f"other {next(names)}"), left=0.3),
        "_with_rivals": lambda search, comparison, guards, located, found: found,
    }.items():
        monkeypatch.setattr(selection, name, stand_in)
    search: Any = SimpleNamespace(
        settings=DEFAULT,
        evidence=None,
        pool=None,
        progress=lambda text: None,
        budget=SimpleNamespace(baseline=model(left=1.0)),
    )
    first: Any = SimpleNamespace(
        reference=None, screened=[], models=[model(acting("first"), left=0.4)]
    )
    found = selection.select_effects(search, COMPARED, None, evidence, first)  # type: ignore[arg-type]
    assert len(found.steps) == 2 and found.best.label == "other 0"
