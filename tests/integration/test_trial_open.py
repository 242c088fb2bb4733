"""Open cases of the trial: effects that act, recordings, and which answers are right."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.api import trial_cases
from pamid.api.trial_cases import CaseWork
from pamid.base.errors import DataError, UsageError
from pamid.base.json_file import read_json
from pamid.model.rig import Rig
from pamid.recording.recording import Recording
from pamid.trial.case_machine import FITTED, HELD_OUT, CaseMachine, RecordedCase, study_case
from pamid.trial.cases import (
    BEYOND_TOLERANCE,
    FURTHER_SHARES,
    MAP_TOLERANCE,
    NAMELESS,
    OPEN,
    STRATA,
    cases_sha256,
    draw_case,
    draw_cases,
)
from pamid.trial.figure_table import trial_text
from pamid.trial.logger import Logger
from pamid.trial.machine import machine_names
from pamid.trial.marking import OPEN_ANSWERS, Marked
from pamid.trial.own_machine import machine_of
from pamid.trial.scoring import score_cases

SEED = 5
QUICK = ("cascaded-tanks", "damper-bench", "servo-pendulum")


@cache
def machine(rig: str, number: int) -> CaseMachine:
    return CaseMachine.of(draw_case("calibration", number, SEED, rig, world=OPEN))


# ---- what is drawn ---------------------------------------------------------------------------


@pytest.mark.parametrize("rig", machine_names())
def test_strata_and_conditions(rig: str) -> None:
    cases = draw_cases("test", 50, SEED, rig, world=OPEN)
    for stratum, share in STRATA[OPEN].items():
        assert sum(c.stratum == stratum for c in cases) == pytest.approx(50 * share, abs=2)
    low, high = (MAP_TOLERANCE * times for times in BEYOND_TOLERANCE)
    assert all(low <= c.conditions.background <= high for c in cases)
    assert all(c.conditions.logger != Logger() for c in cases)
    for c in cases:
        known = [site for site in c.planted if not site.startswith(NAMELESS)]
        expected = {"single": (1, 1), "no-gap": (0, 0), "nameless": (1, 0)}[c.stratum]
        assert (len(c.planted), len(known)) == expected
        assert bool(c.shares) == bool(c.further) == bool(c.planted)
        families = {c.machine.truth(site)["family"] for site in c.planted}
        assert not families & {c.machine.truth(site)["family"] for site in c.further}
        assert not any(site.startswith(NAMELESS) for site in c.further)


def test_open_cases_are_none_of_the_closed_ones() -> None:
    drawn = [
        draw_cases(part, 40, SEED, QUICK[0], world=world)
        for part in ("test", "calibration")
        for world in STRATA
    ]
    assert len({c.seed for cases in drawn for c in cases}) == 4 * 40
    assert len({cases_sha256(cases) for cases in drawn}) == 4
    assert drawn[1] == draw_cases("test", 60, SEED, QUICK[0], world=OPEN)[:40]
    assert "logger" not in drawn[0][0].label()["conditions"], "closed labels stay as they were"


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(UsageError, match="closed, open"):
        draw_cases("test", 1, 0, world="opne")
    with pytest.raises(UsageError, match="no open cases"):
        draw_cases("test", 1, 0, machine_of("servo-pendulum"), world=OPEN)


# ---- what acts -------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(8))
@pytest.mark.parametrize("rig", QUICK)
def test_further_effects_change_10_to_60_percent_as_much(rig: str, number: int) -> None:
    """Measured again, with the sizes that act."""
    m = machine(rig, number)
    planted = list(m.case.planted)
    assert list(m.faults)[: len(planted)] == planted
    further = {k: v for k, v in m.faults.items() if k not in planted}
    assert len(further) == len(m.case.shares)
    low, high = FURTHER_SHARES
    for site, sizes in further.items():
        ratio = m.change({site: sizes}) / m.change(m.case.planted)
        assert low <= ratio <= high, (site, ratio)
    families = [m.machine.truth(site)["family"] for site in m.faults]
    assert len(set(families)) == len(families)
    changes = [a.change for a in m.acting]
    assert changes == sorted(changes, reverse=True) and {a.fault for a in m.acting} == set(m.faults)


def test_what_removes_most_leads_even_where_it_was_not_planted() -> None:
    m = machine("damper-bench", 0)
    site = next(k for k in m.faults if k not in m.case.planted)
    larger = {
        k: 6.0 * v if k in m.machine.faults[site].amounts else v for k, v in m.faults[site].items()
    }
    swapped = replace(m)
    swapped.__dict__["faults"] = {**m.faults, site: larger}
    assert swapped.acting[0].fault == site and not swapped.acting[0].planted


def test_the_joint_and_the_arm_have_further_effects_too() -> None:
    for rig, number in (("one-dof", 0), ("two-link", 0)):
        case = next(c for c in draw_cases("calibration", 20, SEED, rig, world=OPEN) if c.shares[:1])
        shorter: dict[str, Any] = {"seconds": 6.0, "hold_s": (0.4, 1.6)}
        short = replace(case.conditions, **shorter)
        m = CaseMachine.of(replace(case, conditions=short, shares=case.shares[:1]))
        assert len(m.faults) == 2, (rig, number)
        site = list(m.faults)[1]
        ratio = m.change({site: m.faults[site]}) / m.change(m.case.planted)
        assert FURTHER_SHARES[0] <= ratio <= FURTHER_SHARES[1]


# ---- how it is recorded ----------------------------------------------------------------------


def test_a_study_case_is_the_same_again_and_has_what_a_replay_needs(tmp_path: Path) -> None:
    number = next(
        c.number
        for c in draw_cases("calibration", 20, SEED, QUICK[0], world=OPEN)
        if c.stratum == "single"
    )
    one, other = (study_case(QUICK[0], number, SEED, tmp_path / k, fresh=2) for k in "ab")
    assert one.acting == other.acting and one.rig.name == QUICK[0]
    recordings = [*one.fitted, *one.held_out, *one.fresh]
    assert [r.path.stem for r in recordings] == ["recording", "held-out", "fresh-1", "fresh-2"]
    for mine, again in zip(recordings, [*other.fitted, *other.held_out, *other.fresh], strict=True):
        assert all(np.array_equal(mine.columns[k], again.columns[k]) for k in mine.columns)
    pumped = [r.columns["pump_v"] for r in recordings]
    assert not any(np.array_equal(a, b) for i, a in enumerate(pumped) for b in pumped[:i])
    assert one.acting[0].change >= one.acting[-1].change > 0.0
    given = [r.path.with_suffix(".toml").read_text() + repr(list(r.columns)) for r in recordings]
    for word in (*(a.fault.partition("@")[0] for a in one.acting), "single", OPEN + " world"):
        assert word not in repr(given), "the tool sees nothing of the truth"


def test_a_recording_starts_in_motion_and_keeps_its_length() -> None:
    case = draw_case("calibration", 2, SEED, QUICK[0], world=OPEN)
    still = replace(case.conditions, logger=replace(case.conditions.logger, warm_up_s=0.0))
    moving, resting = (CaseMachine.of(c).run({}) for c in (case, replace(case, conditions=still)))
    assert all(len(moving[k]) == len(resting[k]) for k in resting)
    assert np.array_equal(moving["time_s"], resting["time_s"])
    assert abs(resting["level_cm"][0] - 5.0) < 1.0 < abs(moving["level_cm"][0] - 5.0)


def test_the_gauge_shows_few_values_and_the_others_many() -> None:
    case = draw_case("calibration", 2, SEED, QUICK[0], world=OPEN)
    gauge = replace(
        case.conditions.logger, gauge=0.0, gauge_steps=40.0, gauge_bend=0.4, correlation=0.9
    )
    conditions = replace(case.conditions, channels="all", logger=gauge)
    m = CaseMachine.of(replace(case, conditions=conditions))
    columns = m.run({})
    assert m.readings == ["level_cm", "upper_level_cm"]
    values = {k: len(np.unique(columns[k])) for k in m.readings}
    assert values["level_cm"] <= 42 < 200 < values["upper_level_cm"]


@pytest.mark.parametrize("rig", ["servo-pendulum", "one-dof"])
def test_a_jittering_clock_moves_readings_along_their_slope(rig: str) -> None:
    """Error of a reading = its rate x delay; what is sent is on time."""
    case = draw_case("calibration", 2, SEED, rig, world=OPEN)
    quick: dict[str, Any] = {"seconds": 6.0, "noise": 0.0, "loop": "open"}
    if rig == "one-dof":
        quick["hold_s"] = (0.4, 1.6)
    late, sharp = (
        replace(case, conditions=replace(case.conditions, **quick, logger=Logger(jitter=j)))
        for j in (0.2, 0.0)
    )
    jittering, even = (CaseMachine.of(c).run({}) for c in (late, sharp))
    period = case.machine.period_s
    rate = np.gradient(even["angle_deg"], period)
    apart = jittering["angle_deg"] - even["angle_deg"]
    expected = 0.2 * period * float(np.sqrt(np.mean(rate**2)))
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(expected, rel=0.25)
    sent = "voltage_v" if rig == "servo-pendulum" else "command"
    assert np.array_equal(jittering[sent], even[sent])


def test_the_tool_holds_a_recording_of_its_own_out(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[list[Recording]] = []

    def diagnose(
        recordings: list[Recording], rig: Rig, *, held_out: list[Recording], **how: Any
    ) -> None:
        assert rig.name == QUICK[0] and how["without"] == ()
        shown.append([*recordings, *held_out])
        raise DataError("seen enough")

    monkeypatch.setattr(trial_cases, "diagnose", diagnose)
    case = draw_case("calibration", 2, SEED, QUICK[0], world=OPEN)
    assert CaseWork()(case)["failed"]["message"] == "seen enough"
    ((fitted, held_out),) = shown
    assert (fitted.path.stem, held_out.path.stem) == ("recording", "held-out")
    m = CaseMachine.of(case)
    for number, recording in ((FITTED, fitted), (HELD_OUT, held_out)):
        assert m.run({}, number)["pump_v"] == pytest.approx(recording.columns["pump_v"], rel=1e-6)


# ---- which answers are right -----------------------------------------------------------------

FAMILIES = {
    "coulomb-friction": "friction",
    "stribeck-friction": "friction",
    "constant-offset": "offset",
    "offset": "sensor-offset",
    "leak": "leak",
    "dead-time": "command-timing",
}
CONDITIONS = {"background": 0.03, "channels": "all", "loop": "open", "noise": 1.0}


def acting(*effects: str) -> list[dict[str, Any]]:
    """The first removes most."""
    return [
        {
            "fault": e,
            "family": FAMILIES.get(e, ""),
            "port": "shaft",
            "exact": [e] if e in FAMILIES else [],
            "planted": i == 0,
            "change": 1.0 / (i + 1),
            "removes": 1.0 / (i + 1),
        }
        for i, e in enumerate(effects)
    ]


def marked(
    verdict: str,
    *causes: str,
    there: tuple[str, ...] = ("coulomb-friction", "leak"),
    remainder: dict[str, Any] | None = None,
    forecast: tuple[float, float] | None = (0.5, 0.6),
    visibility: float = 2.0,
    stratum: str = "single",
) -> Marked:
    """forecast: lower end of the claimed shrinkage, and what was achieved."""
    present = acting(*there)
    rows = [
        {"effect": e, "family": FAMILIES[e], "port": "shaft", "probability": 0.8} for e in causes
    ]
    held = forecast and {
        "predicted": forecast[0] + 0.1,
        "low": forecast[0],
        "high": 0.9,
        "achieved": forecast[1],
    }
    label = {
        "number": 0,
        "stratum": stratum,
        "world": OPEN,
        "truth": present[:1],
        "conditions": CONDITIONS,
    }
    return Marked(
        label,
        {
            "case": 0,
            "failed": None,
            "acting": present,
            "visibility": visibility,
            "visibility_each": visibility,
            "seconds": 1.0,
            "shrinkage": held,
            "diagnosis": {
                "verdict": verdict,
                "causes": rows,
                "ranking": rows,
                "comparison": [],
                "where": {"port": "shaft", "indistinguishable": []},
                "remainder": remainder or {"share": 0.3, "port": "pump", "real": True},
            },
        },
    )


DRY = ("coulomb-friction", "constant-offset", "offset")


@pytest.mark.parametrize(
    ("answer", "right"),
    [
        (marked("partly-explained", "coulomb-friction"), True),
        (marked("partly-explained", "stribeck-friction"), True),  # of the same family
        (marked("explained", "coulomb-friction", "leak"), True),
        (marked("explained", "leak", "coulomb-friction"), False),  # the lesser one first
        (marked("partly-explained", "leak"), False),
        (marked("ambiguous", "leak", "coulomb-friction"), True),  # a set of two
        (marked("ambiguous", *DRY), True),  # one group, which predicts the same
        (marked("unknown-effect"), False),
        (marked("cannot-tell"), False),
        (marked("no-structural-gap"), False),
    ],
)
def test_the_effect_that_removes_most_is_to_be_named(answer: Marked, right: bool) -> None:
    assert (answer.open_answer == "leader") == right
    assert answer.open_right == right


def test_each_answer_has_its_word() -> None:
    words = {
        marked("explained", "stribeck-friction").open_answer: "leader",
        marked("explained", "leak", "dead-time").open_answer: "lesser",
        marked("ambiguous", "dead-time", "offset").open_answer: "wrong",
        marked("unknown-effect").open_answer: "left-open",
    }
    assert tuple(words) == tuple(words.values()) == OPEN_ANSWERS


@pytest.mark.parametrize(
    ("remainder", "reported"),
    [
        ({"share": 0.3, "port": "pump"}, True),
        ({"share": 0.3, "port": ""}, False),  # no place
        ({"share": None, "port": "pump"}, False),  # no size
        ({"share": 0.1, "port": ""}, True),  # less than is material
        ({}, False),
    ],
)
def test_the_remainder_has_a_size_and_a_place(remainder: dict[str, Any], reported: bool) -> None:
    answer = marked("partly-explained", "coulomb-friction", remainder=remainder or {"real": True})
    assert answer.remainder_reported == answer.open_right == reported


def test_the_same_effect_elsewhere_is_another_answer() -> None:
    """A lag of the amplifier is not one of the ammeter, unless the fault has no place."""
    named = marked("explained", "dead-time", there=("coulomb-friction",))
    for fault, right in (("coulomb-friction@ammeter", False), ("coulomb-friction", True)):
        named.result["acting"][0].update(fault=fault, exact=["dead-time"], family="sensor-dynamics")
        assert (replace(named).open_answer == "leader") == right


def test_nothing_removes_less_than_claimed() -> None:
    assert not marked("explained", "coulomb-friction", forecast=(0.5, 0.4)).open_right
    assert marked("explained", "coulomb-friction", forecast=(0.5, 0.5)).open_right
    assert marked("explained", "coulomb-friction", forecast=None).open_right


def test_an_effect_without_a_name_is_not_blamed_on_lesser_ones() -> None:
    there = ("nameless:swirl", "leak")
    half = {"share": 0.6, "port": "pipe", "real": True}
    quarter = {"share": 0.25, "port": "pipe", "real": True}

    def rejected(verdict: str, *causes: str, remainder: dict[str, Any]) -> bool:
        m = marked(verdict, *causes, there=there, remainder=remainder, stratum="nameless")
        assert m.family == "" and [p["family"] for p in m.present] == ["leak"]
        return m.leaves_nameless

    assert rejected("partly-explained", "leak", remainder=half)
    assert not rejected("partly-explained", "leak", remainder=quarter)
    assert rejected("unknown-effect", remainder=half)
    assert rejected("cannot-tell", remainder=quarter)
    assert not rejected("no-structural-gap", remainder={"share": 0.1, "real": False})


def test_open_cases_are_counted() -> None:
    answers = [
        marked("partly-explained", "coulomb-friction"),
        marked("partly-explained", "leak"),
        marked("partly-explained", "dead-time"),
        marked("unknown-effect"),
        marked("partly-explained", "dead-time", visibility=1.15),  # removes 13 %: need not be named
    ]
    labels = [{**m.label, "number": i} for i, m in enumerate(answers)]
    results = [{**m.result, "case": i} for i, m in enumerate(answers)]
    found = score_cases(labels, results, rig="servo-pendulum", world=OPEN)
    counted = {k: (r.hits, r.of) for k, r in found.rates.items() if k.startswith("open_")}
    assert counted == {
        "open_right": (1, 4),
        "open_leader": (1, 4),
        "open_lesser": (1, 4),
        "open_wrong": (1, 4),
        "open_left_open": (1, 4),
        "open_remainder": (3, 3),
        "open_claims": (3, 3),
    }
    assert "both_of_two" not in found.rates
    text = trial_text(json.loads(json.dumps(found.as_json())))
    assert "in an open world" in text and ">= 88 %" in text


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def examine(case: Any, place: Path) -> dict[str, Any]:
        assert case.world == OPEN
        m = marked("no-structural-gap", there=tuple(FAMILIES)[: len(case.planted)], forecast=None)
        wanted = ("diagnosis", "visibility", "visibility_each", "seconds", "acting", "shrinkage")
        return {k: m.result[k] for k in wanted}

    monkeypatch.setattr(trial_cases, "examine", examine)
    words = ["trial", "--output", str(tmp_path / "run"), "--cases", "5", "--jobs", "1"]
    words += ["--rig", QUICK[0], "--resume"]
    assert frame.run([*words, "--world", "open"]) == 0
    assert "in an open world" in capsys.readouterr().out
    for name in ("trial.json", "labels.json"):
        assert read_json(tmp_path / "run" / name)["world"] == OPEN
    assert frame.run(words) == 3, "a folder holds one trial"


def test_a_recorded_case_names_what_the_tool_may_name(tmp_path: Path) -> None:
    recorded: RecordedCase = machine(QUICK[0], 2).recorded(tmp_path, fresh=0)
    assert recorded.fresh == () and "leak" in recorded.catalogue
    assert not any(name.startswith(NAMELESS) for name in recorded.catalogue)
