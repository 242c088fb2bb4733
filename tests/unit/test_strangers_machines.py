"""The machines of benchmarks/strangers can be drawn, and their rigs and recordings pass a check."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scripts import BENCHMARKS, load_script

from pamid.checks.conformance import finite_everywhere
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("strangers/run.py")


def test_every_machine_is_drawn_and_taken_by_its_rig(script: ModuleType, tmp_path: Path) -> None:
    for stranger in script.STRANGERS:
        script.write_machine(tmp_path / stranger.name, stranger)
        rig = rig_named(str(tmp_path / stranger.name / stranger.rig))
        fitted, held_out = (
            [read_recording(tmp_path / stranger.name / f"rec-{number}.csv")] for number in (1, 2)
        )
        evidence = split_recordings(rig, fitted, held_out)
        assert set(evidence.channels) == set(rig.outputs), stranger.name
        assert set(stranger.ports) <= set(rig.ports), stranger.name


@pytest.mark.parametrize(
    "name", sorted(p.name for p in (BENCHMARKS / "strangers/rigs").glob("*.py"))
)
def test_its_rig_runs(name: str) -> None:
    assert finite_everywhere(rig_named(str(BENCHMARKS / "strangers" / "rigs" / name))) == []


def test_what_is_missing_shows_and_vanishes(script: ModuleType) -> None:
    """Sealed: the same machine without what its rig lacks is another recording, with the same
    input wherever no controller answers."""
    machine = next(s for s in script.STRANGERS if s.name == "filter-circuit")
    with_it, without = (machine.records(lacking)[0] for lacking in (1.0, 0.0))
    assert np.array_equal(with_it["drive_v"], without["drive_v"])
    assert np.std(with_it["output_v"] - without["output_v"]) > 0.1 * np.std(without["output_v"])


@pytest.mark.parametrize(
    ("verdict", "families", "counted"),
    [
        ("explained", ["friction"], "right"),
        ("ambiguous", ["friction", "leak"], "honest"),
        ("ambiguous", ["drag", "leak"], "wrong"),
        ("partly-explained", ["leak"], "wrong"),
        ("unknown-effect", [], "honest"),
        ("no-structural-gap", [], "missed"),
    ],
)
def test_an_answer_is_counted(
    script: ModuleType, verdict: str, families: list[str], counted: str
) -> None:
    machine = next(s for s in script.STRANGERS if s.name == "shaker-mass")
    assert script.counted(machine, verdict, "friction" in families, True) == counted
    whole = script.whole(machine)
    expected = {"no-structural-gap": "right", "unknown-effect": "honest"}.get(verdict, "wrong")
    assert script.counted(whole, verdict, False, False) == expected
