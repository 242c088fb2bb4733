"""A disk that is full at any write of any command: exit code 3, nothing half-written, the old files
as they were."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from faulty import complaints, fresh_copy, tree_of, walk
from pamid_cli import frame
from small_cart import RIG, record_cart


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cart's recording, a run fitted to it, and outputs of earlier commands to be replaced."""
    place = tmp_path_factory.mktemp("made")
    record_cart(place, seconds=6.0)
    assert (
        frame.run(["fit", str(place / "rec.csv"), "--rig", RIG, "--output", str(place / "run")])
        == 0
    )
    run = place / "run" / "run.json"
    run.write_text(json.dumps(json.loads(run.read_text()) | {"command": ["pamid", "fit"]}))
    for name in (
        "a.csv",
        "a.toml",
        "a.json",
        "sim.csv",
        "sim.toml",
        "c/pamid_cart.c",
        "out.csv",
        "card.png",
    ):
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_text("old")
    words = [
        "ingest",
        "--guess",
        str(place / "push.csv"),
        "--rig",
        RIG,
        "--output",
        str(place / "map.toml"),
    ]
    assert frame.run(words) == 0
    return place


WRITE_TOGETHER = {
    "generate-aprbs": [
        "--rig",
        RIG,
        "--column",
        "force_n",
        "--duration",
        "3",
        "--amplitude",
        "3",
        "--hold",
        "0.2",
        "0.8",
        "--output",
        "a.csv",
        "--overwrite",
    ],
    "simulate": ["--rig", RIG, "--excitation", "push.csv", "--output", "sim.csv", "--overwrite"],
    "ingest": [
        "push.csv",
        "--mapping",
        "map.toml",
        "--rig",
        RIG,
        "--output",
        "out.csv",
        "--overwrite",
    ],
    "ingest ": ["--guess", "push.csv", "--rig", RIG, "--output", "a.toml", "--overwrite"],
    "check": ["rec.csv", "--rig", RIG, "--figure", "card.png", "--overwrite"],
    "export": ["run", "--rig", RIG, "--to", "c", "--output", "c", "--overwrite"],
    "export ": ["run", "--rig", RIG, "--to", "matlab", "--output", "new/model.m"],
    "report": ["run"],
    "report ": ["--compare", "run", "run/../run", "--output", "both.html"],
}
WRITE_IN_TURN = {
    "fit": ["rec.csv", "--rig", RIG, "--output", "other/run"],
    "fit ": ["rec.csv", "--rig", RIG, "--bootstrap", "3", "--output", "run", "--overwrite"],
}


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(one, marks=pytest.mark.slow if one == "fit " else ())
        for one in (*WRITE_TOGETHER, *WRITE_IN_TURN)
    ],
)
def test_every_write_may_fail(
    command: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = fresh_copy(made, tmp_path / "place")
    monkeypatch.chdir(place)
    words = [command.strip(), *(WRITE_TOGETHER | WRITE_IN_TURN)[command]]
    before, whole, failed = walk(words, place)
    assert whole.code == 0, whole.said
    assert len(failed) >= 5 and sum(one.code == 3 for one in failed) >= len(failed) / 2
    together = command in WRITE_TOGETHER
    assert not [
        text for one in failed for text in complaints(before, whole, one, together=together)
    ]
    assert not list((place / "tmp").iterdir())


def test_the_walk_sees_what_is_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Were files written in place, and one after the other, it would say so."""
    import pamid.base.files
    import pamid.recording.recording

    def careless(files: dict[Path, bytes]) -> None:
        for path, data in files.items():
            with open(path, "wb") as file:
                file.write(data[:10])
                file.flush()  # what a fork holds in its buffer would be written twice
                file.write(data[10:])

    record_cart(tmp_path, seconds=6.0)
    place = fresh_copy(tmp_path, tmp_path / "place")
    monkeypatch.chdir(place)
    monkeypatch.setattr(pamid.recording.recording, "write_together", careless)
    before, whole, failed = walk(
        ["simulate", "--rig", RIG, "--excitation", "push.csv", "--output", "sim.csv"], place
    )
    told = "\n".join(
        text for one in failed for text in complaints(before, whole, one, together=True)
    )
    assert "neither what it was nor" in told and "some were not" in told


def test_a_small_file_system_that_is_full(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real one, where this machine lets us mount one."""
    import subprocess

    disk = tmp_path / "disk"
    disk.mkdir()
    if (
        os.geteuid()
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(disk)], capture_output=True
        ).returncode
    ):
        pytest.skip("no file system can be mounted here")
    try:
        (disk / "sim.csv").write_text("old")
        monkeypatch.chdir(made)
        words = [
            "simulate",
            "--rig",
            RIG,
            "--excitation",
            "push.csv",
            "--output",
            str(disk / "sim.csv"),
            "--overwrite",
        ]
        (disk / "rest").write_bytes(bytes(56 * 1024))
        before = tree_of(disk)
        assert frame.run(words) == 3 and tree_of(disk) == before
        (disk / "rest").unlink()
        assert frame.run(words) == 0
    finally:
        subprocess.run(["umount", str(disk)], check=True)
