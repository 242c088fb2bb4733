"""The recording in data/example is what the commands in data/README.md make."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.frame import run

from pamid.recording import read_recording
from pamid.run import sha256_of

DATA = Path(__file__).resolve().parent.parent / "data"
PAGE = (DATA / "README.md").read_text(encoding="utf-8")


def test_sums_are_those_written_down() -> None:
    sums = re.findall(r"^([0-9a-f]{64})  (example/\S+)$", PAGE, re.MULTILINE)
    assert {name for _, name in sums} == {f"example/{p.name}" for p in (DATA / "example").iterdir()}
    for wanted, name in sums:
        assert sha256_of(DATA / name) == wanted, name


def test_the_commands_make_it_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    block = next(b for b in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL) if "simulate" in b)
    for line in block.splitlines():
        assert run(shlex.split(line)[1:]) == 0
    kept, made = read_recording(DATA / "example" / "joint.csv"), read_recording(tmp_path / "joint.csv")
    assert list(made.columns) == list(kept.columns)
    assert (made.loop, made.rig, made.known, made.controller) == (kept.loop, kept.rig, kept.known, kept.controller)
    np.testing.assert_array_equal(made.time, kept.time)
    for name, values in kept.columns.items():
        np.testing.assert_allclose(made.columns[name], values, rtol=0.0, atol=1e-6 * float(np.ptp(values)),
                                   err_msg=name)


def test_it_is_small() -> None:
    assert (DATA / "example" / "joint.csv").stat().st_size < 700_000
