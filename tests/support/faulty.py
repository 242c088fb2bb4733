"""A disk that is full at any moment of a command: what it says, and what it leaves behind.

The command runs once. Before each of its writes below a folder (opening a file to write, writing,
fsync, a second name, replacing, making a folder) the process forks: the fork's disk is full from
there on, or fails this once, and it goes on to its end; then the folder is put back as it was, and
the command goes on to its next write. So every write of a long command is tried in little more time
than the command takes.
"""

from __future__ import annotations

import builtins
import contextlib
import errno
import io
import json
import os
import pickle
import shutil
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid_cli import frame
from small_cart import RIG, others, record_cart

ONCE, FULL = "once", "from then on"
ROOT = Path(__file__).resolve().parents[2]
JOURNAL = "journal.jsonl"
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND
Tree = dict[str, bytes]


@dataclass(frozen=True)
class Outcome:
    """What came of a command one of whose writes failed: exit code, what it printed, the files it
    left."""

    write: str
    code: int
    said: str
    tree: Tree


@dataclass
class Disk:
    """The folder whose writes fail in turn; the outcomes are collected in a file beside it."""

    place: Path
    every: int = 1
    count: int = 0
    fork: str = ""
    failed: str = ""
    _busy: bool = False  # putting the folder back

    def event(self, what: str, path: Any) -> None:
        """Called before every write. In a fork it raises the error of a full disk."""
        if not isinstance(path, str | os.PathLike) or not Path(
            os.fspath(path)
        ).absolute().is_relative_to(self.place):
            return
        if self.fork == FULL:
            self._refuse(path)
        if self.fork or self._busy:
            return
        self.count += 1
        if self.count % self.every:
            return
        self._busy = True
        self._try(what, path)
        self._busy = False

    def _try(self, what: str, path: Any) -> None:
        for mode in (ONCE, FULL):
            # what a rename or a second name needs is there on most full disks
            if mode == FULL and what in ("replace", "link"):
                continue
            kept = _Kept(self.place)
            child = os.fork()
            if child == 0:
                self.fork, self.failed = mode, f"{self.count}: {what} {Path(path).name}, {mode}"
                self._refuse(path)
            os.waitpid(child, 0)
            kept.put_back()

    def _refuse(self, path: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), os.fspath(path))


class _File:
    """An open file whose writes are events."""

    def __init__(self, file: Any, disk: Disk, path: Any) -> None:
        self._file, self._disk, self._path = file, disk, path

    def write(self, data: Any) -> Any:
        self._disk.event("write", self._path)
        return self._file.write(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *about: Any) -> None:
        self._file.close()


@contextlib.contextmanager
def watched(disk: Disk) -> Iterator[None]:
    """Every way of writing that pamid has goes through the disk's `event`."""
    former = {
        name: getattr(os, name) for name in ("open", "fsync", "replace", "rename", "mkdir", "link")
    }
    opened, named = builtins.open, {}

    def opening(path: Any, mode: str = "r", *more: Any, **options: Any) -> Any:
        if not set(mode) & set("wax+") or isinstance(path, int):
            return opened(path, mode, *more, **options)
        disk.event("open", path)
        file = opened(path, mode, *more, **options)
        with contextlib.suppress(OSError):
            named[file.fileno()] = path
        return _File(file, disk, path)

    def opening_low(path: Any, flags: int, *more: Any, **options: Any) -> Any:
        if flags & WRITING:
            disk.event("open", path)
        return former["open"](path, flags, *more, **options)

    def syncing(number: int) -> None:
        disk.event("fsync", named.get(number))
        former["fsync"](number)

    def moving(what: str) -> Callable[..., Any]:
        def move(*paths: Any, **options: Any) -> Any:
            if what != "mkdir" or not os.path.isdir(paths[0]):
                disk.event(what, paths[0] if what == "mkdir" else paths[1])
            return former[what](*paths, **options)

        return move

    patches = {
        "open": opening_low,
        "fsync": syncing,
        **{n: moving(n) for n in ("replace", "rename", "mkdir", "link")},
    }
    try:
        builtins.open = io.open = opening  # type: ignore[assignment]
        for name, patch in patches.items():
            setattr(os, name, patch)
        yield
    finally:
        builtins.open = io.open = opened
        for name, was in former.items():
            setattr(os, name, was)


def tree_of(place: Path) -> Tree:
    """Every file below a folder."""
    return {
        p.relative_to(place).as_posix(): p.read_bytes()
        for p in sorted(place.rglob("*"))
        if p.is_file()
    }


def walk(
    words: Sequence[str], place: Path, *, every: int = 1
) -> tuple[Tree, Outcome, list[Outcome]]:
    """Run a command whose writes below `place` fail in turn (every: only each so-manieth); files
    before, the outcome undisturbed, and with each write failing."""
    os.makedirs(place / "tmp", exist_ok=True)
    former = tempfile.tempdir
    tempfile.tempdir = str(place / "tmp")
    before = tree_of(place)
    disk = Disk(place, every)
    handle, results = tempfile.mkstemp(dir=place.parent)
    os.close(handle)
    try:
        whole = _outcome(disk, words, results)
        with open(results, "rb") as file:
            failed = []
            while True:
                try:
                    failed.append(pickle.load(file))
                except EOFError:
                    return before, whole, failed
    finally:
        tempfile.tempdir = former
        os.unlink(results)


def _outcome(disk: Disk, words: Sequence[str], results: str) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    code = -1
    try:
        with watched(disk), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = frame.run([*words, "--json"])
    except BaseException:
        err.write(traceback.format_exc())
        if not disk.fork:
            raise
    finally:
        if disk.fork:
            with open(results, "ab") as file:
                pickle.dump(
                    Outcome(
                        disk.failed, code, out.getvalue() + err.getvalue(), tree_of(disk.place)
                    ),
                    file,
                )
            os._exit(0)
    return Outcome("", code, out.getvalue() + err.getvalue(), tree_of(disk.place))


class _Kept:
    """A folder as it is now, down to the very files: some of them are open."""

    def __init__(self, place: Path) -> None:
        self._place, self._beside = place, Path(tempfile.mkdtemp(dir=place.parent))
        self._files = [p for p in place.rglob("*") if not p.is_dir()]
        self._folders = [p for p in place.rglob("*") if p.is_dir()]
        # these grow in place
        self._journals = {p: p.read_bytes() for p in self._files if p.name == JOURNAL}
        for number, file in enumerate(self._files):
            os.link(file, self._beside / str(number))

    def put_back(self) -> None:
        for path in sorted(self._place.rglob("*"), reverse=True):
            if not path.is_dir():
                path.unlink()
            elif path not in self._folders:
                path.rmdir()
        for path in self._folders:
            path.mkdir(exist_ok=True)
        for number, file in enumerate(self._files):
            os.link(self._beside / str(number), file)
            if file in self._journals:
                file.write_bytes(self._journals[file])
        shutil.rmtree(self._beside)


def complaints(
    before: Tree, whole: Outcome, failed: Outcome, *, together: bool, codes: Sequence[int] = (3,)
) -> list[str]:
    """What is wrong with an outcome. together: the command writes all of its files or none; else
    each of them whole or not at all, and run.json says that the run did not end."""
    wrong = []
    if "Traceback" in failed.said:
        wrong.append(f"a traceback: {failed.said[-600:]}")
    # it could do without
    done = failed.code == whole.code and _results(failed.tree) == _results(whole.tree)
    if not done and failed.code not in codes:
        wrong.append(f"exit code {failed.code}: {failed.said[:300]}")
    if failed.code == 3 and '"schema": "pamid.error/1"' not in failed.said:
        wrong.append(f"no error: {failed.said[:300]}")
    for name, content in failed.tree.items():
        if name not in before and name not in whole.tree and not _of_progress(name):
            wrong.append(f"{name} is left behind")
        elif Path(name).name == "run.json":
            if (
                json.loads(content)["ended"] is not None
                and name not in before
                and not done
                and together is False
            ):
                wrong += (
                    [f"{name} says that it ended well"]
                    if json.loads(content)["outcome"] == "done"
                    else []
                )
        elif not _of_progress(name) and content not in (before.get(name), whole.tree.get(name)):
            wrong.append(f"{name} is neither what it was nor what it should become")
    if together and _results(failed.tree) not in (_results(before), _results(whole.tree)):
        wrong.append("some files were written and some were not")
    lost = [name for name in before if name in whole.tree and name not in failed.tree and together]
    return [f"{failed.write}: {what}" for what in [*wrong, *(f"{name} is lost" for name in lost)]]


def _results(tree: Tree) -> Tree:
    return {k: v for k, v in tree.items() if Path(k).name not in ("run.json", JOURNAL)}


def _of_progress(name: str) -> bool:
    """Is it kept for --resume, and written again and again?"""
    return Path(name).parent.name == "jobs" or Path(name).name == "checkpoint.npz"


# ---- the commands --------------------

#: command, folder it works in is a copy of the same start -> (words, does it write all of its files
#: or none)
COMMANDS: dict[str, tuple[list[str], bool]] = {
    "generate-aprbs": (
        ["--duration", "20", "--output", "a.csv", "--figure", "a.png", "--overwrite"],
        True,
    ),
    "export --to   ": (["matlab", "run", "--rig", RIG, "--output", "new/model.m"], True),
    "report --compare": (["run", "run/../run", "--output", "both.html"], True),
    "simulate": (
        ["--rig", RIG, "--excitation", "push.csv", "--output", "sim.csv", "--overwrite"],
        True,
    ),
    "ingest": (
        ["push.csv", "--mapping", "map.toml", "--rig", RIG, "--output", "out.csv", "--overwrite"],
        True,
    ),
    "ingest --guess": (["push.csv", "--rig", RIG, "--output", "new.toml"], True),
    "check --figure": (["card.png", "rec.csv", "--rig", RIG, "--overwrite"], True),
    "report": (["run"], True),
    "animate": (["joint-run", "--size", "160", "--to", "4"], True),
    "export --to": (["c", "run", "--rig", RIG, "--output", "c"], True),
    "export --to ": (["fmu", "run", "--rig", RIG, "--output", "cart.fmu"], True),
    "export --to  ": (["onnx", "run", "--rig", RIG, "--output", "cart.onnx"], True),
    "fit": (["rec.csv", "--rig", RIG, "--bootstrap", "3", "--output", "run", "--overwrite"], False),
    "diagnose": (
        ["rec.csv", "--rig", RIG, *others(), "--jobs", "1", "--output", "run", "--overwrite"],
        False,
    ),
    "train-residual": (["run", "--hidden", "2", "--iterations", "3", "--jobs", "1"], False),
    "force-law": (["points.csv", "--output", "law", "--sets", "2", "--no-strict"], False),
    "trial": (["--output", "trial", "--cases", "3", "--jobs", "1"], False),
    "demo": (["--output", "demo", "--duration", "15", "--jobs", "1"], False),
    "reproduce-paper": (["joint", "--quick", "--output", "paper", "--jobs", "1"], False),
}


def prepared(place: Path, *, with_joint: bool = False) -> None:
    """What the commands work on; with_joint: also a run of the joint, for animate."""
    record_cart(place)
    assert (
        quietly(["fit", str(place / "rec.csv"), "--rig", RIG, "--output", str(place / "run")]) == 0
    )
    words = [
        "ingest",
        "--guess",
        str(place / "push.csv"),
        "--rig",
        RIG,
        "--output",
        str(place / "map.toml"),
    ]
    assert quietly(words) == 0
    for name in ("a.csv", "a.json", "a.png", "sim.csv", "sim.toml", "out.csv", "card.png"):
        (place / name).write_text("old")
    rows = [f"{e / 20},{p},{(1 - 2 * e / 20) * p}" for e in range(6) for p in range(100, 600, 100)]
    (place / "points.csv").write_text("\n".join(["contraction,pressure_kpa,force_n", *rows, ""]))
    if with_joint:
        words = [
            "fit",
            str(ROOT / "data/example/joint.csv"),
            "--rig",
            "one-dof",
            "--output",
            str(place / "joint-run"),
        ]
        assert quietly(words) in (0, 5)


def quietly(words: list[str]) -> int:
    with (
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        return frame.run(words)
