"""Does a cause hold elsewhere: what counts as elsewhere, and the figures there."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_joint import record

from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.verdict.verdict_figures import differences, transfer
from pamid.model.registry import rig_named
from pamid.simulation.data_split import split_recordings

SENSORS = ("reference_deg", "command", "angle_deg")


@dataclass
class Model:
    absolutes: Any
    replays: Any = ()


@dataclass
class Progress:
    """As much of a diagnosis as transfer reads."""

    evidence: Any
    budget: Any
    cause: Any

    def reported(self, c: Any) -> Any:
        return c.absolutes


@dataclass
class Windows:
    windows: tuple[int, ...]


@dataclass
class Kept:
    baseline: Any
    settings: Settings = DEFAULT


def told(tmp_path: Path, heavy: dict[str, float]) -> Progress:
    light = record(
        tmp_path / "light.csv", 6.0, seed=1, columns=SENSORS, known={"inertia_kg_m2": 0.014}
    )
    other = record(tmp_path / "other.csv", 6.0, seed=2, columns=SENSORS, known=heavy)
    evidence = split_recordings(rig_named("one-dof"), [light], [other])
    before = np.radians([[1.0], [1.0], [2.0], [2.0]])
    base = Model(before, (Windows((0, 1, 2, 3)),))
    return Progress(evidence, Kept(base), Model(0.25 * before))


def test_another_inertia_is_elsewhere(tmp_path):
    found = transfer(told(tmp_path, {"inertia_kg_m2": 0.0896}))
    assert len(found) == 1
    assert found[0].differs == {"inertia_kg_m2": 0.0896}
    angle = found[0].channels["angle_deg"]
    assert angle.mae_refitted == pytest.approx(1.5), "the mean over its windows"
    assert angle.mae_with_cause == pytest.approx(0.375) and angle.shrinkage == pytest.approx(0.75)


def test_the_same_conditions_are_not(tmp_path):
    d = told(tmp_path, {"inertia_kg_m2": 0.014})
    assert "inertia_kg_m2" not in differences(d, d.evidence.held_out[0])  # type: ignore[arg-type]
    assert all("inertia_kg_m2" not in row.differs for row in transfer(d))  # type: ignore[arg-type]


def test_without_a_cause_nothing_is_transferred(tmp_path):
    d = told(tmp_path, {"inertia_kg_m2": 0.0896})
    d.cause = None
    assert transfer(d) == ()  # type: ignore[arg-type]
