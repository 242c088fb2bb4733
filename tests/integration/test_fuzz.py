"""Damaged recordings, settings, logs, run folders and words: always an answer, never a traceback, a
hang, a half-written file, or code that runs. A sample of what benchmarks/fuzz.py (`make fuzz`) goes
through by the hundred thousand: input (kind, number) is the same there."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from fuzz_inputs import KINDS, Site
from fuzz_seeds import make_seeds
from fuzzing import broken_bytes, broken_json, broken_table, broken_toml
from pamid_cli.frame import run

from pamid.report import writing
from pamid.report.style import Picture

#: inputs of each kind; those of a kind that takes long
SAMPLE, FEW = int(os.environ.get("PAMID_FUZZ", "8")), 2
SLOW = ("fit", "binary_log", "run_folder", "trial", "training", "force_map")
#: inputs that were faults of pamid's when the hundred thousand were first gone through
FOUND = {
    "run_folder": (820, 12060, 51088),
    "words": (4824,),
    "settings": (3144, 9882, 51205, 59271, 76423),
    "force_map": (2733,),
    "training": (8723, 52130),
    "binary_log": (15944,),
    "raw_log": (20396,),
    "resumed": (627, 966),
    "fit": (96557,),
    "trial": (109190,),
    "excitation": (1667,),
    "model": (23788,),
}
NOTHING = '<svg viewBox="0 0 1 1"></svg>'
#: done, usage, a file is wrong, the data cannot answer, not converged, partly done: everything but
#: a fault of pamid's
ALLOWED = {0, 2, 3, 4, 5, 6}
#: absurd numbers may well draw a warning from a plot; only faults are looked for
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.usefixtures("unchecked")]


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_seeds(tmp_path_factory.mktemp("seeds") / "whole")


def answer(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    """What `pamid ... --json` says: one object with a schema, and an exit code that is no fault of
    pamid's."""
    code = run([*map(str, words), "--json"])
    out = capsys.readouterr().out
    said = json.loads(out)
    assert isinstance(said, dict) and said["schema"].startswith("pamid."), out[:200]
    assert code in ALLOWED and said.get("code") != "unexpected", (words, code, said.get("message"))
    if code and said["schema"] == "pamid.error/1":
        assert said["message"], said
        assert (said["message"] + said["hint"]).count("Did you mean") <= 1, said
    return said


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_input(
    kind: str,
    seeds: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    # figures are drawn in benchmarks/fuzz.py; here their content is worked out
    monkeypatch.setattr(
        writing,
        "render",
        lambda drawing: Picture(drawing.name, drawing.title, NOTHING, NOTHING, NOTHING, b""),
    )
    for number in (*range(min(FEW, SAMPLE) if kind in SLOW else SAMPLE), *FOUND.get(kind, ())):
        place = tmp_path / str(number)
        place.mkdir()
        monkeypatch.chdir(place)
        for words in KINDS[kind](Site(seeds, place, Random(f"{kind}-{number}"))):
            said = answer(capsys, *words)
            if said["schema"] == "pamid.error/1" and "out.csv" in words:
                assert not list(place.glob("out.*")), "half an output was left behind"
        assert not list(place.rglob("*.tmp")), "a file was begun and not finished"


def test_the_same_number_damages_alike() -> None:
    """What a fault is reported by is enough to make it again, on any machine."""
    made = [
        damage(Random("x-1"), content)
        for damage, content in (  # type: ignore[operator]
            (broken_bytes, bytes(range(256))),
            (broken_table, "time_s,angle_deg\n0,1\n1,2\n"),
            (broken_json, {"a": [1.5, {"b": None}], "c": "text"}),
            (broken_toml, "[known]\nmass_kg = 1.0\n"),
        )
        for _ in "12"
    ]
    assert made[::2] == made[1::2] and len(set(map(str, made))) == 4


def _copied(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


class Payload:
    """Unpickled, it leaves a file: the proof that code was run."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.canary,))


def _object_array(canary: Path) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, weights=np.array([Payload(canary)], dtype=object))
    return buffer.getvalue()


def _bare_pickle(canary: Path) -> bytes:
    return pickle.dumps(Payload(canary))


def _pickle_as_member(canary: Path) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("weights.npy", pickle.dumps(Payload(canary)))
    return buffer.getvalue()


def _endless(canary: Path) -> bytes:
    """A header that promises more numbers than any machine holds."""
    header = (
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776000,), }".ljust(117)
        + b"\n"
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(
            "weights.npy",
            b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + b"\0" * 64,
        )
    return buffer.getvalue()


@pytest.mark.parametrize("crafted", [_object_array, _bare_pickle, _pickle_as_member, _endless])
@pytest.mark.parametrize("name", ["network.npz", "checkpoint.npz"])
def test_a_crafted_archive_runs_nothing(
    crafted: Any, name: str, seeds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, canary = _copied(seeds / "explained", tmp_path), tmp_path / "canary"
    (folder / name).write_bytes(crafted(canary))
    writing.content_of(folder)  # all that `report` reads, without the figures
    answer(
        capsys,
        "train-residual",
        folder,
        "--iterations",
        "1",
        "--hidden",
        "2",
        "--jobs",
        "1",
        "--resume",
    )
    for words in (
        (
            "simulate",
            "--model",
            folder,
            "--excitation",
            folder / "residual.csv",
            "--output",
            tmp_path / "x",
        ),
        ("export", folder, "--to", "c", "--output", tmp_path / "model"),
    ):
        answer(capsys, *words)
    assert not canary.exists(), "something unpickled it"
