"""Machines of others, with rig files written the natural way: what is named first, on recordings
that nobody fitted."""

from pathlib import Path
from typing import Any

import pytest

from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings

ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT.parent / "shared" / "data"
pytestmark = pytest.mark.skipif(
    not MEASURED.is_dir(), reason="the measured recordings are not beside the project"
)


def found(rig: str, fitted: list[str], held_out: list[str]) -> dict[str, Any]:
    """diagnosis.json of recordings (paths below the folder of measured ones)."""
    read = [[read_recording(MEASURED / name) for name in part] for part in (fitted, held_out)]
    evidence = split_recordings(rig_named(str(ROOT / "data" / "rigs" / rig)), *read)
    return diagnosis_file(diagnose(evidence, effects(), jobs=2)).as_json()


@pytest.mark.slow
def test_the_seal_of_a_piston_rubs_more_under_pressure():
    """Reachable from area times pressure: Coulomb 75 %, with a level that follows the pressure
    82 % (RMS)."""
    said = found(
        "piston_bench.py",
        [f"piston_friction/oring_{bar}bar.csv" for bar in (1, 3, 7)],
        ["piston_friction/oring_5bar.csv"],
    )
    first = said["ranking"][0]
    assert first["family"] == "friction" and first["port"] == "piston"
    assert said["how_far"]["force_n"]["shrinkage"] > 0.75
    assert said["where"]["port"] == "piston"


@pytest.mark.slow
def test_the_spring_of_an_oscillator_hardens():
    said = found(
        "oscillator.py",
        ["silverbox/multisine.csv"],
        ["silverbox/tail.csv", "silverbox/arrow.csv"],
    )
    assert [c["effect"] for c in said["causes"]] == ["cubic-stiffness"]
    assert said["how_far"]["response_v"]["shrinkage"] > 0.75


@pytest.mark.slow
def test_a_tank_that_spills_is_named():
    """Reachable: 61 % (RMS of a free run, the loss of both tanks against none)."""
    said = found("tanks.py", ["cascaded_tanks/estimation.csv", "cascaded_tanks/validation.csv"], [])
    assert said["causes"][0]["effect"] == "overflow-into-store"
    assert said["how_far"]["level_v"]["shrinkage"] > 0.45


@pytest.mark.slow
def test_a_tank_that_spills_leads_on_a_record_of_its_own():
    """Fitted to one record. Windows that begin anew hide most of what spills, so that its share is
    at the edge of three standard errors."""
    said = found("tanks.py", ["cascaded_tanks/estimation.csv"], ["cascaded_tanks/validation.csv"])
    assert said["ranking"][0]["effect"] == "overflow-into-store"
    assert {c["effect"] for c in said["causes"]} <= {"overflow-into-store"}
    assert said["verdict"] != "no-structural-gap"
