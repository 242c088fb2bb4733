"""A disk that is full at any write of any command: exit code 3, nothing half-written, the old files
as they were."""

import os
import shutil
from pathlib import Path

import pytest
from faulty import COMMANDS, complaints, prepared, tree_of, walk
from pamid_cli import frame
from small_cart import RIG, record_cart

#: of the commands of benchmarks/faults.py those that take a moment
QUICK = (
    "simulate",
    "ingest",
    "ingest --guess",
    "check --figure",
    "export --to",
    "export --to   ",
    "report",
    "report --compare",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A cart's recording, a run fitted to it, and outputs of earlier commands to be replaced."""
    place = tmp_path_factory.mktemp("made")
    prepared(place)
    return place


@pytest.mark.parametrize(
    "command", [*QUICK, "generate-aprbs", pytest.param("fit", marks=pytest.mark.slow)]
)
def test_every_write_may_fail(command, made, tmp_path, monkeypatch, undrawn):
    place = Path(shutil.copytree(made, tmp_path / "place"))
    monkeypatch.chdir(place)
    words, together = COMMANDS[command]
    before, whole, failed = walk([*command.split(), *words], place)
    assert whole.code == 0, whole.said
    assert len(failed) >= 5 and sum(one.code == 3 for one in failed) >= len(failed) / 2
    assert not [
        text for one in failed for text in complaints(before, whole, one, together=together)
    ]
    assert not list((place / "tmp").iterdir())


def test_the_walk_sees_what_is_half_written(tmp_path, monkeypatch):
    """Were files written in place, and one after the other, it would say so."""
    import pamid.base.files
    import pamid.recording.recording

    def careless(files):
        for path, data in files.items():
            with open(path, "wb") as file:
                file.write(data[:10])
                file.flush()  # what a fork holds in its buffer would be written twice
                file.write(data[10:])

    record_cart(tmp_path, seconds=6.0)
    place = Path(shutil.copytree(tmp_path, tmp_path / "place"))
    monkeypatch.chdir(place)
    monkeypatch.setattr(pamid.recording.recording, "write_together", careless)
    before, whole, failed = walk(
        ["simulate", "--rig", RIG, "--excitation", "push.csv", "--output", "sim.csv"], place
    )
    told = "\n".join(
        text for one in failed for text in complaints(before, whole, one, together=True)
    )
    assert "neither what it was nor" in told and "some were not" in told


def test_a_small_file_system_that_is_full(made, tmp_path, monkeypatch):
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
