"""Does a cause hold elsewhere: what counts as elsewhere, and the figures there."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_joint import record

from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.verdict.verdict_figures import differences, transfer
from pamid.model.registry import rig_named
from pamid.simulation.data_split import split_recordings

SENSORS = ("reference_deg", "command", "angle_deg")


def model(absolutes: Any) -> Any:
    return SimpleNamespace(absolutes=absolutes, replays=(SimpleNamespace(windows=(0, 1, 2, 3)),))


def told(tmp_path: Path, heavy: dict[str, float]) -> Any:
    """As much of a diagnosis as transfer reads."""
    known = ({"inertia_kg_m2": 0.014}, heavy)
    light, other = (
        record(tmp_path / f"{k}.csv", 6.0, seed=k, columns=SENSORS, known=own)
        for k, own in enumerate(known, start=1)
    )
    before = np.radians([[1.0], [1.0], [2.0], [2.0]])
    return SimpleNamespace(
        evidence=split_recordings(rig_named("one-dof"), [light], [other]),
        budget=SimpleNamespace(baseline=model(before), settings=DEFAULT),
        cause=model(0.25 * before),
        reported=lambda c: c.absolutes,
    )


def test_another_inertia_is_elsewhere(tmp_path):
    found = transfer(told(tmp_path, {"inertia_kg_m2": 0.0896}))
    assert len(found) == 1
    assert found[0].differs == {"inertia_kg_m2": 0.0896}
    angle = found[0].channels["angle_deg"]
    assert angle.mae_refitted == pytest.approx(1.5), "the mean over its windows"
    assert angle.mae_with_cause == pytest.approx(0.375) and angle.shrinkage == pytest.approx(0.75)


def test_the_same_conditions_are_not(tmp_path):
    d = told(tmp_path, {"inertia_kg_m2": 0.014})
    assert "inertia_kg_m2" not in differences(d, d.evidence.held_out[0])
    assert all("inertia_kg_m2" not in row.differs for row in transfer(d))


def test_without_a_cause_nothing_is_transferred(tmp_path):
    d = told(tmp_path, {"inertia_kg_m2": 0.0896})
    d.cause = None
    assert transfer(d) == ()
