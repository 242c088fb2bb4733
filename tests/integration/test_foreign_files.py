"""Pipes, devices, files without end and packed bombs, where data is expected: refused at once, with
exit code 3."""

import io
import json
import os
import pickle
import shutil
import signal
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame
from small_cart import RIG, record_cart

from pamid.base.errors import FileError
from pamid.base.files import read_lines
from pamid.base.npz import load_arrays
from pamid.base.parallel.result_store import Store


@pytest.fixture(autouse=True)
def _never_blocks() -> Iterator[None]:
    """What waits for a pipe ends as a failure; a busy machine is given its time."""

    def hangs(*_):
        raise AssertionError("it waits for a file that never ends")

    former = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, former)


def endless(path: Path) -> None:
    """A terabyte of zeros that takes no room on the disk."""
    with open(path, "wb") as file:
        file.truncate(1 << 40)


NOT_FILES: dict[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "too large": endless,
    "folder": Path.mkdir,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A recording of a cart and a run fitted to it, with a checkpoint."""
    place = tmp_path_factory.mktemp("made")
    record_cart(place)
    run = str(place / "run")
    assert frame.run(["fit", str(place / "rec.csv"), "--rig", RIG, "--output", run]) == 0
    assert frame.run(["train-residual", run, "--hidden", "2", "--iterations", "1"]) in (0, 5)
    return place


@pytest.fixture
def place(made, tmp_path, monkeypatch) -> Path:
    """A copy of it, as working folder."""
    shutil.copytree(made, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


def refused(capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    capsys.readouterr()
    assert frame.run([*words, "--json"]) == 3
    said = json.loads(capsys.readouterr().out)
    return str(said.get("message") or said["findings"])


#: the file that is replaced, and a command that reads it
READ = {
    "rec.csv": "check rec.csv",
    "rec.toml": f"fit rec.csv --rig {RIG} --output other",
    "push.csv": f"simulate --rig {RIG} --excitation push.csv --output sim.csv",
    "map.toml": "ingest push.csv --mapping map.toml --output out.csv",
    "log.csv": "ingest --guess log.csv --output guess.toml",
    "log.mat": "ingest --guess log.mat --output guess.toml",
    "points.csv": "force-law points.csv --output law",
    "run/fit.json": "report run",
    "run/residual.csv": "report run",
    "run/trace.csv": "report run",
    "run/diagnosis.json": "report run",
    "run/report.html": "report run",
    "run/trial.json": "report run",
    "run/network.json": f"export run --to c --output c --rig {RIG}",
    "run/network.npz": (f"simulate --model run --rig {RIG} --excitation push.csv --output sim.csv"),
    "run/checkpoint.npz": "train-residual run --hidden 2 --iterations 2 --resume",
    "pose/run.json": "animate pose",
    "before/fit.json": f"fit rec.csv --rig {RIG} --from before --output other",
}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (name, kind)
        for name in READ
        for kind in NOT_FILES
        # that is exit code 2
        if (name, kind) != ("map.toml", "folder")
    ],
)
def test_what_is_no_plain_file_is_refused_at_once(name, kind, place, capsys):
    if name.startswith("before"):
        shutil.copytree("run", "before")
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    NOT_FILES[kind](path)
    said = refused(capsys, READ[name].split())
    assert path.name in said and (kind in said or "no run.json" in said or "is a folder" in said), (
        said
    )
    assert not Path("out.csv").exists() and not Path("sim.csv").exists()


def test_a_line_without_end_is_refused(tmp_path, capsys):
    for name, head in (("rec.csv", b""), ("other.csv", b"time_s,angle_deg\n0,1\n")):
        (tmp_path / name).write_bytes(head + b"1" * (4 << 20))
        assert "line" in refused(capsys, ["check", str(tmp_path / name)])
    with pytest.raises(FileError, match="line 1 is longer than 1 MiB"):
        list(read_lines(tmp_path / "rec.csv"))


# ---- npz --------------------

MANY, NAME = 200_000_000, "weights.npy"


def header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return buffer.getvalue()


def packed(path: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def holding_the_same_often(path: Path) -> None:
    """Every entry of its directory points to one and the same array."""
    one = packed(path, {"a.npy": header((100_000,)) + bytes(800_000)}).read_bytes()
    end = one.rindex(b"PK\x05\x06")
    start = struct.unpack("<L", one[end + 16 : end + 20])[0]
    entry, count = one[start:end], 1000
    tail = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, count * len(entry), start, 0)
    path.write_bytes(one[:start] + entry * count + tail)


def with_a_directory_of_gigabytes(path: Path) -> None:
    one = packed(path, {"a.npy": header((10,)) + bytes(80)}).read_bytes()
    path.write_bytes(one[:-10] + struct.pack("<LLH", 1 << 30, 0, 0))


class Trap:
    """Unpickled, it would leave a file behind."""

    def __init__(self, sprung: Path) -> None:
        self.sprung = sprung

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.sprung,)


def holding_an_object(path: Path) -> None:
    np.savez(path, weights=np.array([Trap(path.with_name("sprung"))], dtype=object))


#: every npz that pamid reads is read by `load_arrays`, as pyproject.toml has it (banned-api)
BOMBS: dict[str, Callable[[Path], Any]] = {
    "compressed": lambda path: packed(
        path, {NAME: header((4_000_000,)) + bytes(32_000_000)}, zipfile.ZIP_DEFLATED
    ),
    "promising": lambda path: packed(path, {NAME: header((MANY,)) + bytes(800)}),
    "overflowing": lambda path: packed(path, {NAME: header((1 << 62, 4)) + bytes(800)}),
    "same often": holding_the_same_often,
    "directory": with_a_directory_of_gigabytes,
    "object": holding_an_object,
    "pickle": lambda path: path.write_bytes(pickle.dumps(Trap(path.with_name("sprung")))),
    "pickled member": lambda path: packed(
        path, {NAME: pickle.dumps(Trap(path.with_name("sprung")))}
    ),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_packed_bomb_is_refused_before_it_is_unpacked(bomb, tmp_path):
    path = tmp_path / "bomb.npz"
    BOMBS[bomb](path)
    data = path.read_bytes()
    tracemalloc.start()
    for read in (lambda: load_arrays(path), lambda: load_arrays(path, data)):
        with pytest.raises(FileError, match="not an? (plain )?npz"):
            read()
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert not (tmp_path / "sprung").exists()


def test_results_of_jobs_that_are_no_files_are_worked_out_again(tmp_path):
    store, key = Store(tmp_path), "ab" * 32
    for kind in ("pipe", "device", "too large"):
        (tmp_path / f"{key}.npz").unlink(missing_ok=True)
        NOT_FILES[kind](tmp_path / f"{key}.npz")
        assert store.get(key) is None
