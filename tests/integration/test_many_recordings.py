"""Many short recordings at once, each as short as a fit takes."""

from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from small_cart import PERIOD_S, RIG, others
from virtual_recordings import virtual_recording

from pamid.base.json_file import read_json
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import FEWEST_SAMPLES
from pamid.simulation.excitation.aprbs import aprbs


def recorded(folder: Path, count: int) -> list[str]:
    """Paths of recordings of a cart with friction that its model lacks."""
    paths = []
    for k in range(count):
        sent = {"force_n": aprbs(FEWEST_SAMPLES * PERIOD_S, PERIOD_S, 4.0, (0.1, 0.4), seed=k)}
        truth: dict[str, Any] = {
            "true": {"mass_kg": 1.2},
            "seed": k,
            "path": folder / f"rec-{k}.csv",
        }
        made = virtual_recording(RIG, sent, PERIOD_S, "coulomb-friction", **truth)
        paths.append(str(made.path))
    return paths


def test_several_are_diagnosed(tmp_path, monkeypatch):
    paths, read = recorded(tmp_path, 5), []

    def watched(path):
        read.append(str(path))
        return read_recording(path)

    monkeypatch.setattr("pamid.api.given.read_recording", watched)
    assert frame.run(["fit", *paths, "--rig", RIG, "--output", str(tmp_path / "one")]) == 0
    assert frame.run(["fit", *paths[::-1], "--rig", RIG, "--output", str(tmp_path / "other")]) == 0
    assert sorted(read) == sorted(2 * paths)
    one, other = (read_json(tmp_path / name / "fit.json") for name in ("one", "other"))
    assert one["parameters"] == other["parameters"] and len(one["recordings"]) == 5
    words = ["--rig", RIG, *others(), "--jobs", "1", "--output", str(tmp_path / "run")]
    assert frame.run(["diagnose", *paths, *words]) == 0
    found = read_json(tmp_path / "run" / "diagnosis.json")
    assert found["verdict"] == "explained" and found["causes"][0]["effect"] == "coulomb-friction"


@pytest.mark.slow
def test_two_hundred_are_diagnosed(tmp_path):
    paths = recorded(tmp_path, 200)
    words = ["--rig", RIG, *others(), "--output", str(tmp_path / "run")]
    assert frame.run(["diagnose", *paths, *words]) == 0
    found = read_json(tmp_path / "run" / "diagnosis.json")
    assert found["causes"][0]["effect"] == "coulomb-friction"
