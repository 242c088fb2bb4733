"""A diagnosis that is killed or interrupted goes on with --resume: nothing finished is done again, no bit differs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from small_cart import RIG, others, record_cart

from pamid.results import Store
from pamid.run import read_json

FILES = ("diagnosis.json", "fit.json", "residual.csv", "next-experiment.csv", "next-experiment.toml")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


@pytest.fixture(scope="module")
def undisturbed(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of the same diagnosis without a disturbance."""
    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    assert frame.run(words(recording, folder, "--jobs", "1")) == 0
    return folder


def words(recording: Path, folder: Path, *more: str) -> list[str]:
    return ["diagnose", str(recording), "--rig", RIG, *others(), "--output", str(folder), *more]


def same_files(one: Path, other: Path) -> bool:
    there = [name for name in FILES if (one / name).exists()]
    return "diagnosis.json" in there and all((one / n).read_bytes() == (other / n).read_bytes() for n in there)


def begun(recording: Path, folder: Path, jobs: int, finished: int) -> subprocess.Popen[bytes]:
    """A diagnosis in a process of its own, watched until so many jobs are finished."""
    return started(words(recording, folder, "--jobs", str(jobs)), folder, finished)


def started(command: list[str], folder: Path, finished: int) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, "-m", "pamid_cli", *command], start_new_session=True,
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 90.0
    while len(Store(folder / "jobs").journal()) < finished:
        assert process.poll() is None and time.monotonic() < deadline, "it ended before it could be disturbed"
        time.sleep(0.002)
    return process


def alive(session: int) -> list[str]:
    """Command lines of the processes of a session that are at work."""
    found = subprocess.run(["ps", "-o", "stat=,args=", "-s", str(session)], capture_output=True, text=True).stdout
    return [line for line in found.splitlines() if not line.startswith("Z")]


@pytest.mark.parametrize(("jobs", "finished"), [(1, 6), (2, 12)])
def test_killed_and_resumed(jobs: int, finished: int, recording: Path, undisturbed: Path, tmp_path: Path,
                            capfd: pytest.CaptureFixture[str]) -> None:
    folder, whole = tmp_path / "run", read_json(undisturbed / "run.json")["jobs"]
    process = begun(recording, folder, jobs, finished)
    process.kill()      # SIGKILL, of the main process alone
    process.communicate()
    first = Store(folder / "jobs").journal()
    assert read_json(folder / "run.json")["ended"] is None and len(first) < whole["worked"]

    assert frame.run(words(recording, folder, "--json")) == 3, "what is unfinished is not lost by accident"
    refused = json.loads(capfd.readouterr().out)
    assert "unfinished" in refused["message"] and "--resume" in refused["hint"] and "--overwrite" in refused["hint"]
    assert frame.run(words(recording, folder, "--resume", "--seed", "1")) == 3, "another diagnosis"
    assert frame.run(words(recording, folder, "--resume", "--overwrite")) == 2

    assert frame.run(words(recording, folder, "--resume", "--jobs", str(3 - jobs))) == 0
    record = read_json(folder / "run.json")
    assert record["jobs"] == {"worked": whole["worked"] - len(first), "kept": len(first), "failed": 0}
    assert record["outcome"] == "done" and len(record["resumed"]) == 1
    assert same_files(undisturbed, folder) and not (folder / "jobs").exists()
    assert not [line for line in alive(process.pid) if "pamid_cli" in line], "no process outlives the killed one"

    capfd.readouterr()
    assert frame.run(words(recording, folder, "--resume", "--json")) == 0, "finished: there is nothing to do"
    assert json.loads(capfd.readouterr().out) == read_json(folder / "diagnosis.json")
    assert read_json(folder / "run.json") == record


def test_interrupted_and_resumed(recording: Path, undisturbed: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = begun(recording, folder, 2, 9)
    os.killpg(process.pid, signal.SIGINT)       # as a terminal does: to all processes
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and b"interrupted" in said and b"Traceback" not in said
    record = read_json(folder / "run.json")
    kept = len(list((folder / "jobs").glob("*.npz")))
    assert record["outcome"] == "interrupted" and record["jobs"]["worked"] == kept >= 9
    assert frame.run(words(recording, folder, "--resume")) == 0
    assert read_json(folder / "run.json")["jobs"]["kept"] == kept and same_files(undisturbed, folder)


def test_what_was_damaged_meanwhile_is_worked_out_again(recording: Path, undisturbed: Path, tmp_path: Path,
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    """Every job is worked out once and no more; after a failure in the end only the damaged ones are repeated."""
    import pamid.diagnosis.whole as whole

    def broken(*_: Any) -> None:
        raise RuntimeError("in the end")

    folder, store = tmp_path / "run", Store(tmp_path / "run" / "jobs")
    with monkeypatch.context() as patched:
        patched.setattr(whole, "diagnosis_json", broken)
        assert frame.run(words(recording, folder)) == 1
    assert read_json(folder / "run.json")["outcome"] == "failed"
    done = Counter(line["key"] for line in store.journal())
    assert set(done.values()) == {1} and len(done) == read_json(undisturbed / "run.json")["jobs"]["worked"]
    files = sorted(store.folder.glob("*.npz"))
    files[0].write_bytes(files[1].read_bytes())
    files[2].write_bytes(files[2].read_bytes()[:100])
    with monkeypatch.context() as patched:
        patched.setattr(whole, "diagnosis_json", broken)
        assert frame.run(words(recording, folder, "--resume")) == 1
    again = Counter(line["key"] for line in store.journal())
    assert again - done == Counter({files[0].stem: 1, files[2].stem: 1})
    assert frame.run(words(recording, folder, "--resume")) == 0 and same_files(undisturbed, folder)


def test_a_failed_job_is_told_and_tried_again(recording: Path, undisturbed: Path, tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch,
                                              capfd: pytest.CaptureFixture[str]) -> None:
    """Exit code 6, the result is written, the rest is kept; --resume tries what failed, and what follows from it."""
    from pamid.diagnosis import search

    screen, folder = search.screen, tmp_path / "run"

    def failing(evidence: Any, ground: Any, attachment: Any, *more: Any) -> Any:
        if attachment.label == "quadratic-drag":
            os.kill(os.getpid(), signal.SIGKILL)
        return screen(evidence, ground, attachment, *more)

    with monkeypatch.context() as patched:
        patched.setattr(search, "screen", failing)
        assert frame.run(words(recording, folder, "--jobs", "2", "--json")) == 6
    found = json.loads(capfd.readouterr().out)
    (failed,) = found["failed_jobs"]
    assert failed["job"] == "screening quadratic-drag" and "killed" in failed["why"]
    assert found == read_json(folder / "diagnosis.json") and found["verdict"] == "explained"
    assert [r["why"] for r in found["ranking"] if r["effect"] == "quadratic-drag"] == [failed["why"]]
    record = read_json(folder / "run.json")
    assert record["outcome"] == "partial" and record["jobs"]["failed"] == 1
    assert frame.run(words(recording, folder, "--resume")) == 0
    assert same_files(undisturbed, folder)
    assert read_json(folder / "run.json")["jobs"] == {"worked": 3, "kept": record["jobs"]["worked"] - 1, "failed": 0}, (
        "its screening, its refit, and the next experiment, which knew one model less")


def test_a_bootstrap_goes_on_where_it_was_killed(recording: Path, tmp_path: Path) -> None:
    def fitted(folder: Path, *more: str) -> list[str]:
        return ["fit", str(recording), "--rig", RIG, "--bootstrap", "40", "--output", str(folder), *more]

    whole, folder = tmp_path / "whole", tmp_path / "run"
    assert frame.run(fitted(whole, "--jobs", "2")) == 0 and not (whole / "jobs").exists()
    process = started(fitted(folder, "--jobs", "1"), folder, 5)
    process.kill()
    process.communicate()
    kept = len(Store(folder / "jobs").journal())
    assert 5 <= kept < 40 and frame.run(fitted(folder)) == 3
    assert frame.run(fitted(folder, "--resume")) == 0
    assert read_json(folder / "run.json")["jobs"] == {"worked": 40 - kept, "kept": kept, "failed": 0}
    assert (folder / "fit.json").read_bytes() == (whole / "fit.json").read_bytes()
