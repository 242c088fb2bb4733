"""Notes that a reader needs before believing a figure."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_models import comparison, effect, model

from pamid.base.schemas.diagnosis_file import Reach
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.verdict.notes import (
    _between,
    _instead,
    _row_order,
    _set_aside,
    remark,
    unexplained,
)
from pamid.estimation.lagged_linear import LaggedResponse
from pamid.model.registry import rig_named
from pamid.recording.recording import recording_of


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
def test_half_a_sample_points_to_what_inputs_do_between_samples(late):
    (said,) = told(late, {"slope_rad": "linear"})
    column, way = ("force_n", "linear") if late < 0.0 else ("slope_rad", "held")
    assert f'between = {{"{column}": "{way}"}}' in said


@pytest.mark.parametrize(
    ("periods", "noted"), [(1.0, True), (-0.98, True), (1.2, False), (2.0, False), (0.0, False)]
)
def test_a_delay_of_one_sample_is_the_log(periods, noted):
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
    assert ["the log is the cause, not the machine" in note for note in told] == [True] * noted
    assert not noted or f"{abs(periods):.2f} sampling periods" in told[0]


def test_a_family_that_does_as_well_in_the_place_of_a_cause_is_told():
    causes = (
        SimpleNamespace(effect=effect("coulomb-friction", "friction"), instead=()),
        SimpleNamespace(effect=effect("leak"), instead=("overflow", "dead-time")),
    )
    d: Any = SimpleNamespace(answer=SimpleNamespace(causes=causes), verdict="explained")
    assert _instead(d) == [
        "An effect of the family overflow or dead-time fits equally well in place of leak@joint."
    ]
    d.verdict = "ambiguous"
    assert _instead(d) == [], "they are named"


def test_what_physics_objects_to_is_told_where_it_would_have_led():
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
        "saturation@joint removes 90 % of the gap, but was rejected: its limit is a bound."
    ]
    d.silent = ("angle_deg",)
    assert _set_aside(d) == []


@pytest.mark.parametrize(("silent", "is_order"), [(("a_deg", "b_deg"), True), (("b_deg",), False)])
def test_reversed_rows_are_blamed_only_if_no_channel_is_predicted(silent, is_order):
    recording = SimpleNamespace(values={"torque_n_m": np.array([0.0, 1.0])})
    rig = SimpleNamespace(inputs=("torque_n_m",))
    response = LaggedResponse(forward=np.array([0.8, 0.95]), backwards=np.array([0.5, 0.5]))
    d: Any = SimpleNamespace(
        silent=silent,
        evidence=SimpleNamespace(rig=rig, channels=("a_deg", "b_deg"), recordings=(recording,)),
        response=response,
    )
    assert response.is_reversed and ("reverse order of time" in remark(d)) == is_order


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
def test_a_channel_that_no_model_explains_is_always_told(sheet, cause, floor, told):
    reach = Reach(mae_data_sheet=sheet, mae_with_cause=cause, noise_floor=floor)
    good = Reach(mae_data_sheet=5.0, mae_with_cause=0.2, noise_floor=0.1)
    said = unexplained({"current_a": reach, "angle_deg": good})
    assert len(said) == told
    assert not said or "No model explains current_a" in said[0] and " A with" in said[0]
