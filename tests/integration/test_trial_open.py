"""Open cases of the trial: effects that act, recordings, and which answers are right."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from pamid.api import trial_cases
from pamid.api.trial_cases import CaseWork
from pamid.base.errors import DataError
from pamid.recording.recording import Recording
from pamid.trial.case_machine import FITTED, HELD_OUT, CaseMachine
from pamid.trial.cases import (
    BEYOND_TOLERANCE,
    MAP_TOLERANCE,
    OPEN,
    STRATA,
    Case,
    cases_sha256,
    draw_cases,
)
from pamid.trial.faults import NAMELESS
from pamid.trial.logger import Logger
from pamid.trial.machine import machine_names
from pamid.trial.marking import Marked

SEED = 5
QUICK = ("cascaded-tanks", "damper-bench", "servo-pendulum")


def case_of(number: int, rig: str) -> Case:
    return draw_cases("calibration", number + 1, SEED, rig, world=OPEN)[number]


@cache
def machine(rig: str, number: int) -> CaseMachine:
    return CaseMachine.of(case_of(number, rig))


# ---- what is drawn ---------------------------------------------------------------------------


@pytest.mark.parametrize("rig", machine_names())
def test_strata_and_conditions(rig):
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


def test_open_cases_are_none_of_the_closed_ones():
    drawn = [
        draw_cases(part, 40, SEED, QUICK[0], world=world)
        for part in ("test", "calibration")
        for world in STRATA
    ]
    assert len({c.seed for cases in drawn for c in cases}) == 4 * 40
    assert len({cases_sha256(cases) for cases in drawn}) == 4
    assert drawn[1] == draw_cases("test", 60, SEED, QUICK[0], world=OPEN)[:40]
    assert "logger" not in drawn[0][0].label()["conditions"], "closed labels stay as they were"


# ---- what acts -------------------------------------------------------------------------------


def test_what_removes_most_leads_even_where_it_was_not_planted():
    m = machine("damper-bench", 0)
    site = next(k for k in m.faults if k not in m.case.planted)
    larger = {
        k: 6.0 * v if k in m.machine.faults[site].amounts else v for k, v in m.faults[site].items()
    }
    swapped = replace(m)
    swapped.__dict__["faults"] = {**m.faults, site: larger}
    assert swapped.acting[0].fault == site and not swapped.acting[0].planted


# ---- how it is recorded ----------------------------------------------------------------------


def test_a_study_case_is_the_same_again_and_has_what_a_replay_needs(tmp_path):
    number = next(
        c.number
        for c in draw_cases("calibration", 20, SEED, QUICK[0], world=OPEN)
        if c.stratum == "single"
    )
    case = case_of(number, QUICK[0])
    one, other = (CaseMachine.of(case).recorded(tmp_path / k, fresh=2) for k in "ab")
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


def test_the_tool_holds_a_recording_of_its_own_out(monkeypatch):
    shown: list[list[Recording]] = []

    def diagnose(recordings, rig, *, held_out, **how):
        assert rig.name == QUICK[0] and how["without"] == ()
        shown.append([*recordings, *held_out])
        raise DataError("seen enough")

    monkeypatch.setattr(trial_cases, "diagnose", diagnose)
    case = case_of(2, QUICK[0])
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
def test_the_effect_that_removes_most_is_to_be_named(answer, right):
    assert (answer.open_answer == "leader") == right
    assert answer.open_right == right


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
def test_the_remainder_has_a_size_and_a_place(remainder, reported):
    answer = marked("partly-explained", "coulomb-friction", remainder=remainder or {"real": True})
    assert answer.remainder_reported == answer.open_right == reported


def test_an_effect_without_a_name_is_not_blamed_on_lesser_ones():
    there = ("nameless:swirl", "leak")
    half = {"share": 0.6, "port": "pipe", "real": True}
    quarter = {"share": 0.25, "port": "pipe", "real": True}

    def rejected(verdict, *causes, remainder):
        m = marked(verdict, *causes, there=there, remainder=remainder, stratum="nameless")
        assert m.family == "" and [p["family"] for p in m.present] == ["leak"]
        return m.leaves_nameless

    assert rejected("partly-explained", "leak", remainder=half)
    assert not rejected("partly-explained", "leak", remainder=quarter)
    assert rejected("unknown-effect", remainder=half)
    assert rejected("cannot-tell", remainder=quarter)
    assert not rejected("no-structural-gap", remainder={"share": 0.1, "real": False})
