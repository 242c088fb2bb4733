"""Two effects at once on a small cart: both named, also where none of them is anything by itself;
one planted is one named, and none none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_cart import FEW, cart_evidence, record_cart

from pamid.diagnosis import forward_selection
from pamid.diagnosis.forward_selection import ForwardStep, _is_taken
from pamid.diagnosis.judging import _InItsPlace
from pamid.diagnosis.notes import _company, _dropped
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.tournament import Diagnosis, diagnose
from pamid.diagnosis.verdict import diagnosis_file, diagnosis_json
from pamid.model.registry import effects
from pamid.parallel.jobs import WorkerPool
from pamid.parallel.result_store import Store

LATE_AND_RUBBING = ("coulomb-friction", "dead-time")


def found_with(folder: Path, *planted: str, settings: Settings = DEFAULT) -> Diagnosis:
    catalogue = {k: v for k, v in effects().items() if k in FEW}
    return diagnose(cart_evidence(record_cart(folder, planted)), catalogue, settings=settings)


def steps_of(d: Diagnosis) -> tuple[ForwardStep, ...]:
    assert d.judged is not None
    return d.judged.forward_steps


def named(d: Diagnosis) -> set[str]:
    return {c.effect for c in diagnosis_file(d, None, 0).causes}


@pytest.mark.parametrize("subsets", [DEFAULT.subsets, 1])
def test_a_pair_without_a_first_effect_to_build_on(subsets: int, tmp_path: Path) -> None:
    """Friction alone takes nothing away. The linear solve puts the pair first of all, and it
    removes all that the delay's model leaves."""
    d = found_with(tmp_path, *LATE_AND_RUBBING, settings=Settings(subsets=subsets))
    assert d.verdict == "explained" and named(d) == set(LATE_AND_RUBBING)
    friction = d.singles["coulomb-friction"]
    assert d.budget.shrinkage(friction.absolutes, np.ones_like(d.half)) < d.settings.worth
    step = steps_of(d)[0]
    assert {"sensor-dynamics", "friction"} == set(step.tried[0])
    assert step.of_left > 0.95 and step.taken


def test_a_slight_one_beside_a_plain_one(tmp_path: Path) -> None:
    """Friction of a hundredth of the push, a tenth of the gap, at a port where little seems to be
    missing beside the delay."""
    d = found_with(tmp_path, "coulomb-friction:force_n=0.05", "dead-time")
    assert named(d) == set(LATE_AND_RUBBING)
    assert "friction" in steps_of(d)[0].closed


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
    alone = diagnosis_json(diagnose(evidence, catalogue), None, 0)
    for _ in range(2):
        pool = WorkerPool(2, Store(tmp_path / "store"))
        assert diagnosis_json(diagnose(evidence, catalogue, pool=pool), None, 0) == alone
    assert pool.worked == 0 < pool.from_store


# ---- the rule by itself ----------------------------------------------------------------------


def model(label: str, family: str, error: float) -> Any:
    effect = SimpleNamespace(
        label=label, family=lambda rig: family, ports=("guide",), group=lambda rig: "guide"
    )
    return SimpleNamespace(
        attached=(effect,),
        family=family,
        label=label,
        squares=np.ones((4, 1)),
        absolutes=error,
        samples=100,
    )


def weighed(
    monkeypatch: pytest.MonkeyPatch,
    *,
    gain: float,
    other: float = 0.0,
    spread: float = 0.1,
    left: float = 0.4,
    settings: Settings = DEFAULT,
) -> ForwardStep:
    """A second effect weighed that gains so much in log loss, beside one of another family that
    gains `other`, each with this standard error; the logistic line says no."""
    draws = spread * np.where(np.arange(1000) % 2, 1.0, -1.0)
    of = {"first": 0.0 * draws, "second": -gain + draws, "third": -other + 0.0 * draws}
    search: Any = SimpleNamespace(
        settings=settings,
        family=lambda a: a.family(None),
        losses=lambda models: np.array([of[m.label] for m in models]),
        excess=lambda m: m.absolutes,
        nats=lambda m: -100.0 * m.absolutes,
        budget=SimpleNamespace(baseline=SimpleNamespace(absolutes=1.0)),
        evidence=SimpleNamespace(rig=None),
    )
    line = SimpleNamespace(probability=lambda x: 0.2, yes=0.31)
    monkeypatch.setattr(
        forward_selection, "calibration", lambda: SimpleNamespace(lines={"further": line})
    )
    evidence: Any = SimpleNamespace(gains={"guide": 50.0}, most=50.0, classes=(("guide",),))
    first, second = model("first", "friction", left), model("second", "play", 0.6 * left)
    third = model("third", "lag", 0.8 * left)
    return forward_selection._weighed(search, first, [second, third], evidence, evidence, ())


def test_five_standard_errors_overrule_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    sure = weighed(monkeypatch, gain=1.19)
    assert sure.probability == 0.2 and sure.taken
    assert sure.sure == pytest.approx(11.9) and sure.of_left == pytest.approx(0.4)
    assert sure.evidence == pytest.approx(16.0)
    assert not weighed(monkeypatch, gain=0.4).taken, "four are left to the line"
    assert weighed(monkeypatch, gain=0.4, settings=Settings(further_sure=3.0)).taken


def test_what_removes_next_to_nothing_is_not_taken_however_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the gap, and of what the first leaves: either is enough."""
    assert not weighed(
        monkeypatch, gain=1.19, left=0.04, settings=Settings(further_of_left=0.5)
    ).taken
    assert weighed(monkeypatch, gain=1.19, left=0.04).taken


def test_one_of_two_that_do_as_well_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which family it is stays open; that something is there does not."""
    step = weighed(monkeypatch, gain=1.19, other=1.1)
    assert step.taken and step.margin < DEFAULT.simpler_errors


def test_what_does_as_well_in_its_place_takes_the_lead_from_an_effect() -> None:
    """Of two, the first is in every combination that fits, the second one of two families."""
    attached = {
        name: SimpleNamespace(label=name, family=family)
        for name, family in [("rub", "friction"), ("gap", "play"), ("late", "lag")]
    }
    level = {"rub + gap": 0.0, "rub + late": 0.02, "gap + late": 0.9, "rub": 0.5, "gap": 0.6}
    noise = 0.1 * np.where(np.arange(1000) % 2, 1.0, -1.0)

    def of(label: str) -> Any:
        effects_of = tuple(attached[name] for name in label.split(" + "))
        return SimpleNamespace(label=label, attached=effects_of)

    def losses(models: list[Any]) -> Any:
        return np.array([level[m.label] + noise * (m.label == "rub + late") for m in models])

    def nats(m: Any) -> float:
        return -10.0 * level[m.label]

    search: Any = SimpleNamespace(
        settings=DEFAULT, family=lambda a: a.family, losses=losses, nats=nats
    )
    tried = [of("rub + gap"), of("rub + late"), of("gap + late")]
    second = _InItsPlace.of(search, attached["gap"], tried[0], of("rub"), tried)  # type: ignore[arg-type]
    assert second.rival is tried[1] and second.as_good == ("lag",)
    assert second.wins == 0.5 and second.opposed == pytest.approx(-0.2)
    first = _InItsPlace.of(search, attached["rub"], tried[0], of("gap"), tried)  # type: ignore[arg-type]
    assert first.rival.label == "gap" and first.as_good == () and first.wins == 1.0


def test_a_family_is_tried_again_where_its_place_can_be_told() -> None:
    """Dry friction in two joints are two causes; two laws of it at one joint are one."""

    def acting(*ports: str) -> Any:
        return SimpleNamespace(family="friction", ports=ports)

    search: Any = SimpleNamespace(family=lambda a: a.family)
    best: Any = SimpleNamespace(attached=(acting("elbow"),))
    located: Any = SimpleNamespace(classes=(("elbow", "elbow_encoder"), ("shoulder",)))
    assert _is_taken(search, acting("elbow"), best, located)
    assert _is_taken(search, acting("elbow_encoder"), best, located)
    assert not _is_taken(search, acting("shoulder"), best, located)


def test_an_effect_that_needs_a_nameless_one_beside_it_is_told_with_it(tmp_path: Path) -> None:
    """What stands in the model without a name is said, and how far both go together."""
    d = found_with(tmp_path, *LATE_AND_RUBBING)
    assert d.judged is not None and _company(d) == []
    rubbing, late = d.judged.members
    open_one = replace(late, probability=0.3, instead=("sensor-timing",))
    for kept in ((rubbing.effect.label,), ()):
        decision = replace(d.judged.decision, named=kept)
        judged = replace(d.judged, decision=decision, members=(rubbing, open_one))
        (said,) = _company(replace(d, judged=judged))
        assert late.effect.label in said and "sensor-timing would do as well" in said
        assert ("The nearest is" in said) == (not kept)
    # one that is not in the model, since it is less probable than not
    left = replace(d.judged, members=(rubbing,), dropped=(replace(late, probability=0.3),))
    (said,) = _dropped(replace(d, judged=left))
    assert f"Beside {rubbing.effect.label} there may be {late.effect.label} (P 0.30)" in said
    assert _dropped(d) == []
    # one that stands alone, too, and is not probable enough to be named
    nobody = replace(d.judged.decision, named=())
    (said,) = _company(replace(d, judged=replace(d.judged, decision=nobody, members=(rubbing,))))
    assert said.startswith(f"The nearest is {rubbing.effect.label} (P ") and ": it removes" in said


def test_the_newest_is_dropped_where_it_only_led_out_of_a_minimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first alone had ended in a local minimum, the second brought it out of it and came to
    nothing."""
    first, second = model("first", "friction", 0.9), model("second", "hysteresis", 0.1)
    both = SimpleNamespace(attached=(*first.attached, *second.attached), absolutes=0.1, finite=True)
    left = {"first": 0.1, "second": 0.8}

    def refitted(search: Any, attached: tuple[Any, ...], *found: Any) -> Any:
        alone = attached[0].label
        return SimpleNamespace(attached=attached, label=alone, absolutes=left[alone], finite=True)

    monkeypatch.setattr(forward_selection, "refitted_with", refitted)
    search: Any = SimpleNamespace(
        settings=DEFAULT,
        excess=lambda m: m.absolutes,
        nats=lambda m: -100.0 * m.absolutes,
        budget=SimpleNamespace(baseline=SimpleNamespace(absolutes=1.0)),
    )
    assert forward_selection._backward_check(search, both).label == "first"  # type: ignore[arg-type]
    left["first"] = 0.9
    assert forward_selection._backward_check(search, both) is both  # type: ignore[arg-type]


@pytest.mark.parametrize(("spring_leaves", "kept"), [(0.101, "spring"), (0.3, "gap")])
def test_a_gap_of_no_width_gives_way_to_a_spring(
    spring_leaves: float, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside friction a gap fits best, with the least width that it can have: where a plain spring
    leaves as little, it is the spring."""
    rub, gap = model("rub", "friction", 0.4), model("gap", "transmission", 0.3)
    spring = model("spring", "transmission", 0.35)
    both = SimpleNamespace(attached=(*rub.attached, *gap.attached), absolutes=0.1, finite=True)

    def refitted(search: Any, attached: tuple[Any, ...], *found: Any) -> Any:
        assert [a.label for a in attached] == ["rub", "spring"]
        return SimpleNamespace(attached=attached, absolutes=spring_leaves, finite=True)

    monkeypatch.setattr(forward_selection, "refitted_with", refitted)
    monkeypatch.setattr(
        forward_selection,
        "is_plain_inside",
        lambda c, settings, label="": (label or c.attached[-1].label) != "gap",
    )
    search: Any = SimpleNamespace(
        settings=DEFAULT,
        family=lambda a: a.family(None),
        excess=lambda m: m.absolutes,
        nats=lambda m: -100.0 * m.absolutes,
        budget=SimpleNamespace(baseline=SimpleNamespace(absolutes=1.0)),
    )
    best: Any = both
    found = forward_selection._plainer_members(search, (gap, rub, spring), best)
    assert [a.label for a in found.attached] == ["rub", kept]


def test_an_exchange_of_effects_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where any second effect will do, and the first is dropped for it again and again, the search
    would never end."""
    names = iter(range(100))

    def dropped(*given: Any) -> Any:
        return model(f"other {next(names)}", "play", 0.3)

    step = SimpleNamespace(taken=True)
    evidence: Any = SimpleNamespace(most=1e9, classes=(("guide",),))
    for name, stand_in in {
        "with_finer_steps": lambda search, c: c,
        "locate": lambda *given, **how: evidence,
        "responses_of": lambda *given: None,
        "_larger": lambda *given: ([dropped()], ()),
        "_weighed": lambda *given: step,
        "_backward_check": dropped,
        "_best_first": lambda search, ranking, best, known: best,
        "_plainer_members": lambda search, ranking, best: best,
    }.items():
        monkeypatch.setattr(forward_selection, name, stand_in)
    search: Any = SimpleNamespace(
        settings=DEFAULT, evidence=None, pool=None, progress=lambda text: None
    )
    first: Any = SimpleNamespace(reference=None, screened=[])
    found = forward_selection.select_forward(
        search, (model("first", "friction", 0.4),), evidence, first
    )
    assert found.forward_steps == (step,) and found.best.label.startswith("other")
