"""What is said beside a verdict."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pamid.diagnosis.notes import _between


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
        judged=SimpleNamespace(best=model),
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
