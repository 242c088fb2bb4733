"""Notes that a reader needs before believing a figure."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_models import comparison, effect, model

from pamid.diagnosis.settings import DEFAULT
from pamid.model.registry import rig_named
from pamid.model.rig import Port
from pamid.recording.recording import recording_of
from pamid.schemas.diagnosis_file import Reach, Remainder
from pamid.verdict.notes import (
    _between,
    _fits,
    _instead,
    _no_place,
    _row_order,
    _set_aside,
    _split,
    _windows,
    roughness,
    unexplained,
)


def told(late_periods: float, between: dict[str, str]) -> list[str]:
    """The notes on a model whose readings are late by so many sampling periods of 2 ms."""
    bound = SimpleNamespace(owner="clock-skew", unit="s")
    mass = SimpleNamespace(owner="", unit="kg")
    model = SimpleNamespace(
        assembly=SimpleNamespace(parameters=[mass, bound]),
        fit=SimpleNamespace(p=[1.0, late_periods * 0.002]),
    )
    rig = SimpleNamespace(inputs={"force_n": "N", "slope_rad": "rad"}, between=between)
    recordings = [SimpleNamespace(sampling_period_s=0.002)]
    d: Any = SimpleNamespace(
        answer=SimpleNamespace(model=model),
        evidence=SimpleNamespace(rig=rig, recordings=recordings),
    )
    return _between(d)


@pytest.mark.parametrize("late", [-0.5, -0.47, 0.52])
def test_half_a_sample_points_to_what_inputs_do_between_samples(late: float) -> None:
    (said,) = told(late, {"slope_rad": "linear"})
    column, way = ("force_n", "linear") if late < 0.0 else ("slope_rad", "held")
    assert f'between = {{"{column}": "{way}"}}' in said


@pytest.mark.parametrize("late", [-0.9, 0.0, 0.3, 2.0])
def test_other_delays_do_not(late: float) -> None:
    assert told(late, {"slope_rad": "linear"}) == []


def test_nor_where_no_input_is_taken_so() -> None:
    assert told(0.5, {}) == []


@pytest.mark.parametrize(
    ("periods", "noted"), [(1.0, True), (-0.98, True), (1.2, False), (2.0, False), (0.0, False)]
)
def test_a_delay_of_one_sample_is_the_log(periods: float, noted: bool) -> None:
    delay, lag = (
        SimpleNamespace(owner="dead-time", key=f"dead-time:{name}")
        for name in ("delay", "time_constant")
    )
    model = SimpleNamespace(
        assembly=SimpleNamespace(parameters=[lag, delay]),
        fit=SimpleNamespace(p=[0.002, periods * 0.002]),
        attached=(),
    )
    still = recording_of(0.002 * np.arange(60), {"voltage_v": np.zeros(60)})
    evidence = SimpleNamespace(rig=rig_named("dc-motor"), recordings=[still])
    d: Any = SimpleNamespace(
        answer=SimpleNamespace(model=model), verdict="explained", evidence=evidence
    )
    told = _row_order(d)
    assert ["this is the log, not the machine" in note for note in told] == [True] * noted
    assert not noted or f"{abs(periods):.2f} sampling periods" in told[0]


@pytest.mark.parametrize("verdict", ["explained", "partly-explained", "unknown-effect"])
def test_what_the_rig_cannot_express_is_stated_where_something_is_left(verdict: str) -> None:
    evidence = SimpleNamespace(rig=rig_named("dc-motor"))
    d: Any = SimpleNamespace(answer=SimpleNamespace(), verdict=verdict, evidence=evidence)
    told = _no_place(d)
    assert len(told) == (verdict != "explained")
    assert all("dc-motor has no place for coupling-play" in note for note in told)
    assert all("which geared-motor has" in note for note in told)


@pytest.mark.parametrize("remark", ["", "The data sheet predicts better: it is the baseline."])
def test_a_mended_refit_is_told(remark: str) -> None:
    budget = SimpleNamespace(
        baseline=SimpleNamespace(fit=SimpleNamespace(converged=True)),
        model=SimpleNamespace(remark=remark),
    )
    d: Any = SimpleNamespace(budget=budget, settings=DEFAULT, cause=None)
    assert _fits(d) == ([remark] if remark else [])


def test_a_family_that_does_as_well_in_the_place_of_a_cause_is_told() -> None:
    causes = (
        SimpleNamespace(effect=effect("coulomb-friction", "friction"), instead=()),
        SimpleNamespace(effect=effect("leak"), instead=("overflow", "dead-time")),
    )
    d: Any = SimpleNamespace(answer=SimpleNamespace(causes=causes), verdict="explained")
    assert _instead(d) == [
        "An effect of the family overflow or dead-time does as well in the place of leak@joint."
    ]
    d.verdict = "ambiguous"
    assert _instead(d) == [], "they are named"


def test_what_physics_objects_to_is_told_where_it_would_have_led() -> None:
    before = np.linspace(9.0, 30.0, 24)
    made = comparison(before)
    best, objected, behind = (
        model(1.0 + left * (before - 1.0), effect(name))
        for left, name in ((0.4, "leak"), (0.1, "saturation"), (0.6, "backlash"))
    )
    why = ("its limit is a bound",)
    d: Any = SimpleNamespace(
        set_aside={objected.label: why, behind.label: why},
        silent=(),
        cause=best,
        budget=made.budget,
        comparison=made,
        ranking=[objected, best, behind],
        settings=DEFAULT,
    )
    assert _set_aside(d) == [
        "saturation@joint removes 90 % of the gap and is set aside: its limit is a bound."
    ]
    d.silent = ("angle_deg",)
    assert _set_aside(d) == []


@pytest.mark.parametrize(("count", "few"), [(4, True), (11, True), (12, False)])
def test_few_held_out_windows_are_counted(count: int, few: bool) -> None:
    for whole in (False, True):
        evidence = SimpleNamespace(whole_held_out=whole)
        d: Any = SimpleNamespace(half=np.ones(count, bool), evidence=evidence)
        notes = _windows(d)
        assert [f"rests on {count} held-out windows" in note for note in notes] == [True] * few
        assert ["--held-out" in note for note in notes] == [not whole] * few


@pytest.mark.parametrize("whole", [False, True])
def test_no_option_is_recommended_that_is_in_use(whole: bool) -> None:
    evidence = SimpleNamespace(whole_held_out=whole, held_out_rests=True)
    d: Any = SimpleNamespace(evidence=evidence)
    (note,) = _split(d)
    assert "Hold out a recording that moves as much" in note and ("--held-out" in note) != whole


LEFT = Remainder(
    share=1.0,
    low=1.0,
    high=1.0,
    floors=8.0,
    real=True,
    port="shaft",
    missing_rms=0.3,
    passing_rms=10.0,
    unit="N m",
)


def of_roughness(background: dict[str, Any], **changes: Any) -> list[str]:
    rig = SimpleNamespace(
        background=background,
        group_of=lambda port: port.rstrip("12"),
        ports={
            "shaft1": Port("motion", "N m", ("position",)),
            "shaft2": Port("motion", "N m", ("position",)),
            "motor": Port("command", "V"),
        },
    )
    d: Any = SimpleNamespace(evidence=SimpleNamespace(rig=rig), settings=DEFAULT)
    return roughness(d, LEFT.model_copy(update=changes))


def test_what_a_rough_map_would_leave_as_well_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pamid.model.port_guide._of", lambda rig, name: "")  # no balance
    (said,) = of_roughness({"motor": object()})
    assert "3 % of what passes" in said
    assert '"shaft2": RoughMap("shaft2_map", "position", tolerance=0.02)}' in said


@pytest.mark.parametrize(
    "changes",
    [{"missing_rms": 1.0}, {"real": False}, {"missing_rms": None}, {"passing_rms": 0.0}],
)
def test_what_is_larger_or_not_real_or_not_known_is_no_roughness(changes: dict[str, Any]) -> None:
    assert of_roughness({}, **changes) == []


def test_nor_is_it_where_the_rig_states_its_own() -> None:
    assert of_roughness({"shaft2": object()}) == []


@pytest.mark.parametrize(
    ("sheet", "cause", "floor", "told"),
    [
        (5.0, 4.9, 0.1, True),
        (5.0, 6.0, 0.1, True),
        (5.0, 4.0, 0.1, False),  # a fifth of the error is explained
        (0.5, 0.49, 0.1, False),  # the noise explains a fifth of it
        (5.0, None, 0.1, False),
    ],
)
def test_a_channel_that_no_model_explains_is_always_told(
    sheet: float, cause: float | None, floor: float, told: bool
) -> None:
    reach = Reach(mae_data_sheet=sheet, mae_with_cause=cause, noise_floor=floor)
    good = Reach(mae_data_sheet=5.0, mae_with_cause=0.2, noise_floor=0.1)
    said = unexplained({"current_a": reach, "angle_deg": good})
    assert len(said) == told
    assert not said or "No model explains current_a" in said[0] and " A, with" in said[0]
