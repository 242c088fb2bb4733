"""Run folders: claimed once, closed at the end, whole files only."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pamid.base.errors import FileError, PamidError
from pamid.base.files import sha256_of, write_atomically
from pamid.base.json_file import json_text, read_json, write_json
from pamid.base.run_folder import Run


def _create(folder: Path, **settings: object) -> Run:
    arguments: dict[str, object] = {"command": ["pamid", "fit"], "seed": 1, **settings}
    return Run.create(folder, **arguments)  # type: ignore[arg-type]


def test_a_run_from_begin_to_end(tmp_path):
    data = tmp_path / "rec.csv"
    data.write_text("x")
    run = _create(tmp_path / "a" / "run", inputs=[data], options={"jobs": 2})
    record = run.record
    assert (record["schema"], record["seed"], record["ended"]) == ("pamid.run/1", 1, None)
    assert record["inputs"] == [{"path": str(data), "sha256": sha256_of(data)}]
    assert {"pamid", "python", "numpy", "numba"} <= record["versions"].keys()
    assert (
        record["command"] == ["pamid", "fit"]
        and record["options"] == {"jobs": 2}
        and record["begun"]
    )
    run.finish("done")
    assert Run.open(run.folder).record["ended"] and run.record["outcome"] == "done"
    assert run.path("figures/gap.svg").parent.is_dir()


def test_a_taken_folder_is_refused(tmp_path):
    _create(tmp_path / "empty")
    with pytest.raises(FileError, match="already holds a run"):
        _create(tmp_path / "empty")
    other = tmp_path / "mine"
    other.mkdir()
    (other / "notes.txt").write_text("keep")
    for overwrite in (False, True):
        with pytest.raises(FileError, match="not a run") as caught:
            _create(other, overwrite=overwrite)
    assert caught.value.exit_code == 3 and (other / "notes.txt").read_text() == "keep"
    assert sorted(item.name for item in other.iterdir()) == ["notes.txt"]
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file"):
        _create(tmp_path / "file")
    with pytest.raises(FileError, match="cannot be made"):
        _create(tmp_path / "file" / "below")


def test_overwriting_removes_old_results_and_nothing_else(tmp_path):
    run = _create(tmp_path / "run")
    write_json(run.path("diagnosis.json"), {})
    run.path("figures/gap.svg").write_text("old")
    assert run.record["files"] == ["diagnosis.json", "figures/gap.svg"]
    strangers = [
        "figures/mine.png",
        "figures/ranking.svg",
        "jobs/mine.npz",
        "jobs/notes.tmp",
        "recording.csv",
        "rig.py",
    ]
    (run.folder / "jobs").mkdir()
    for name in strangers:
        (run.folder / name).write_text("mine")
    _create(tmp_path / "run", overwrite=True, seed=2)
    assert _files(run.folder) == sorted([*strangers, "run.json"]) and run.record["seed"] == 2
    assert run.record["files"] == []


def _files(folder: Path) -> list[str]:
    return sorted(
        item.relative_to(folder).as_posix() for item in folder.rglob("*") if not item.is_dir()
    )


def test_overwriting_follows_no_link_out_of_the_run(tmp_path, unchecked):
    away = tmp_path / "away"
    away.mkdir()
    for name in ("gap.png", f"{'a' * 64}.npz", "journal.jsonl", "thesis.tex"):
        (away / name).write_text("mine")
    run = _create(tmp_path / "run")
    (run.folder / "figures").symlink_to(away)
    (run.folder / "thesis.tex").symlink_to(away / "thesis.tex")
    names = [
        "figures/gap.png",
        "../away/thesis.tex",
        str(away / "thesis.tex"),
        "thesis.tex",
        "",
        ".",
        "..",
        "a\0b",
        7,
        "x" * 5000,
        "figures/../figures/gap.png",
    ]
    write_json(run.folder / "run.json", {**run.record, "files": names})
    _create(run.folder, overwrite=True)
    assert len(_files(away)) == 4 and {item.read_text() for item in away.iterdir()} == {"mine"}
    assert (run.folder / "thesis.tex").is_symlink(), "a link is none of pamid's files"
    with pytest.raises(FileError, match="is a link"):
        run.path("figures/gap.png")
    with pytest.raises(FileError, match="leads out"):
        run.path("../gap.png")
    (run.folder / "jobs").symlink_to(away)
    with pytest.raises(FileError, match="jobs is a link"):
        _create(run.folder, overwrite=True, resume=False)
    with pytest.raises(FileError, match="jobs is a link"):
        _create(run.folder, resume=True)
    assert len(_files(away)) == 4


def test_a_run_without_a_list_is_not_replaced(tmp_path):
    """Runs of older versions, and those whose run.json is damaged: what is theirs is not known."""
    for old in ('{"schema": "pamid.run/1"}', '{"schema": "pamid.run/1", "files": "all"}', "{"):
        folder = tmp_path / f"run{len(old)}"
        (folder / "figures").mkdir(parents=True)
        for name in ("diagnosis.json", "report.html", "figures/mine.png", "mine.csv"):
            (folder / name).write_text("old")
        (folder / "run.json").write_text(old)
        before = _files(folder)
        with pytest.raises(FileError, match="does not list its files"):
            _create(folder, overwrite=True)
        assert _files(folder) == before and (folder / "run.json").read_text() == old


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    (tmp_path / "target").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    (tmp_path / "device").symlink_to("/dev/null")
    os.mkfifo(tmp_path / "pipe")
    write_atomically(tmp_path / "link", b"new")
    assert (tmp_path / "target").read_text() == "mine" and not (tmp_path / "link").is_symlink()
    for name, word in (("device", "a device"), ("pipe", "a pipe"), (".", "a folder")):
        with pytest.raises(FileError, match=f"is {word}"):
            write_atomically(tmp_path / name, b"new")
    assert (tmp_path / "device").is_symlink() and len(list(tmp_path.iterdir())) == 4


def test_opening_what_is_no_run(tmp_path):
    with pytest.raises(FileError, match="not a run folder"):
        Run.open(tmp_path)
    (tmp_path / "run.json").write_text("[]")
    with pytest.raises(FileError, match="single JSON object"):
        Run.open(tmp_path)
    (tmp_path / "run.json").write_text('{"schema": "other/1"}')
    with pytest.raises(FileError, match="other/1"):
        Run.open(tmp_path)


def test_json_is_strict_and_takes_numpy(tmp_path):
    path = tmp_path / "a.json"
    write_json(
        path,
        {
            "b": np.float64(0.1),
            "a": np.arange(2),
            "c": (np.bool_(True), None, np.int32(3)),
            "p": path,
        },
    )
    plain = {"b": 0.1, "a": [0, 1], "c": [True, None, 3], "p": str(path)}
    assert path.read_text() == json.dumps(plain, indent=1) + "\n"
    for bad in (float("nan"), np.inf, np.array([1.0, np.nan])):
        with pytest.raises(PamidError, match=r"a\.json\.how_far\.angle") as caught:
            write_json(path, {"how_far": {"angle": bad}})
        assert caught.value.code == "not-finite"
    with pytest.raises(PamidError, match="no JSON form"):
        json_text({"a": {1, 2}})
    with pytest.raises(PamidError, match="keys of JSON are text"):
        json_text({1: 2})
    assert read_json(path)["b"] == 0.1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"a": 1,\n "b": }', "line 2, column 7"),
        (b"", "line 1, column 1"),
        (b'{"a": NaN}', "NaN"),
        (b'{"a": "\xff"}', "not UTF-8"),
        (b"[" * 100000, "nested"),
    ],
)
def test_broken_json_is_located(tmp_path, content, words):
    path = tmp_path / "fit.json"
    path.write_bytes(content)
    with pytest.raises(FileError, match=words):
        read_json(path)
    with pytest.raises(FileError, match="does not exist"):
        read_json(tmp_path / "other.json")


def test_an_interrupt_leaves_no_temporary_file(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.bin", b"x")
    assert os.listdir(tmp_path) == []


_WRITER = """
import sys
from pathlib import Path
from pamid.base.json_file import write_json
from pamid.base.files import write_atomically
from pamid.base.run_folder import Run
run = Run.create(sys.argv[1], command="test", seed=0)
print("begun", flush=True)
for count in range(10**6):
    write_json(run.path("fit.json"), {"count": count, "values": [count] * 20000})
    write_atomically(run.path("residual.csv"), b"%07d\\n" % count * 30000)
"""


def test_kill_9_in_the_middle_leaves_whole_files_only(tmp_path):
    folder = tmp_path / "run"
    for wait in (0.02, 0.045, 0.07, 0.11):
        child = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(folder)], stdout=subprocess.PIPE
        )
        assert child.stdout is not None and child.stdout.readline() == b"begun\n"
        while not (folder / "residual.csv").exists():
            time.sleep(0.002)
        time.sleep(wait)
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
        fit = read_json(folder / "fit.json")
        assert fit["values"] == [fit["count"]] * 20000
        rows = (folder / "residual.csv").read_bytes().split(b"\n")
        assert len(rows) == 30001 and len(set(rows[:-1])) == 1 and len(rows[0]) == 7
        run = Run.open(folder)
        assert run.record["ended"] is None
        assert {item.name for item in folder.iterdir() if not item.name.endswith(".tmp")} == {
            "run.json",
            "fit.json",
            "residual.csv",
        }
        # the next use of the folder clears what the killed process had not finished
        (folder / f".fit.json.{child.pid}.0.tmp").write_text("half")
        (folder / f".fit.json.{os.getppid()}.0.tmp").write_text("being written by someone alive")
        again = _create(folder, overwrite=True)
        assert {item.name for item in folder.iterdir()} == {
            "run.json",
            f".fit.json.{os.getppid()}.0.tmp",
        }
        for item in again.folder.iterdir():
            item.unlink()


def test_what_a_kill_after_the_end_left_is_cleared_by_resuming(tmp_path):
    """A kill may fall between the last write of run.json and the clearing of the jobs."""
    run = _create(tmp_path / "run", resume=False)
    run.finish()
    (run.folder / "jobs").mkdir()
    (run.folder / "jobs" / f"{'0a' * 32}.npz").write_bytes(b"done")
    (run.folder / "jobs" / "journal.jsonl").write_text("{}\n")
    ended = (run.folder / "run.json").read_bytes()
    _create(run.folder, resume=True)
    assert _files(run.folder) == ["run.json"] and (run.folder / "run.json").read_bytes() == ended
