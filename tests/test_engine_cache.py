"""Compiled models on disk: found again, deleted, damaged, in the way of nobody, shared by two processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from compiled import Array, program, run, state

from pamid.engine import machine
from pamid.engine.program import build_program

X = state("x")


def _unseen(seed: float) -> Array:
    """Output of a model that no other test compiles."""
    return run(program({"x": -(3.0 + seed) * X}, {"x": X}), np.zeros(10), x=[1.0])


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("PAMID_CACHE", str(tmp_path / "cache"))
    _forget(monkeypatch)
    yield tmp_path / "cache" / "models"
    build_program.cache_clear()  # its programs live in the table that goes now


def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a new process would begin (the code already loaded stays alive: `monkeypatch` keeps the old table)."""
    build_program.cache_clear()
    monkeypatch.setattr(machine, "_loaded", {})


@pytest.fixture
def compiled_texts(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    seen: list[str] = []
    real = machine._compile

    def counted(ir_text: str) -> bytes:
        seen.append(ir_text)
        return real(ir_text)

    monkeypatch.setattr(machine, "_compile", counted)
    return seen


def test_the_cache_is_used_and_may_be_deleted(cache: Path, compiled_texts: list[str],
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    first = _unseen(0.125)
    (file,) = cache.iterdir()
    assert len(compiled_texts) == 1 and len(file.stem) == 64
    _forget(monkeypatch)
    np.testing.assert_array_equal(_unseen(0.125), first)
    assert len(compiled_texts) == 1                      # from the file
    file.unlink()
    cache.rmdir()
    np.testing.assert_array_equal(_unseen(0.125), first)  # code already loaded does not need it
    _forget(monkeypatch)
    np.testing.assert_array_equal(_unseen(0.125), first)
    assert len(compiled_texts) == 2 and len(list(cache.iterdir())) == 1
    np.testing.assert_array_equal(first, _unseen(0.125))


@pytest.mark.parametrize("damage", [
    lambda data: b"", lambda data: data[:40], lambda data: data[:-1], lambda data: b"\0" * len(data),
    lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:], lambda data: data + b"more",
], ids=["empty", "cut", "one byte short", "zeros", "one bit", "longer"])
def test_a_damaged_file_is_compiled_again(damage: Callable[[bytes], bytes], cache: Path, compiled_texts: list[str],
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    first = _unseen(0.25)
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    _forget(monkeypatch)
    np.testing.assert_array_equal(_unseen(0.25), first)
    assert len(compiled_texts) == 2 and file.read_bytes() == whole


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path: Path, compiled_texts: list[str],
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv("PAMID_CACHE", str(blocked))
    _forget(monkeypatch)
    assert np.isfinite(_unseen(0.5)).all() and len(compiled_texts) == 1


def test_text_of_a_model_does_not_depend_on_the_process(compiled_texts: list[str],
                                                        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The file's name is a digest of the text: were that to change, nothing would ever be found again."""
    code = ("import sys; sys.path.insert(0, sys.argv[1])\n"
            "from pamid.engine import machine\n"
            "machine._compile = lambda text: (print(machine._key(text)), sys.exit(0))\n"
            "from pamid.assembly import Assembly\n"
            "from pamid.attaching import attach\n"
            "from pamid.library import effects, rig_named\n"
            "rig = rig_named('one-dof')\n"
            "Assembly(rig, (attach(rig, 'lugre-friction', effects()), attach(rig, 'dead-time', effects()))).program\n")
    keys = set()
    for seed in ("1", "2"):
        done = subprocess.run([sys.executable, "-c", code, str(Path(__file__).parent)], capture_output=True, text=True,
                              env={**os.environ, "PYTHONHASHSEED": seed, "PAMID_CACHE": str(tmp_path / seed)},
                              check=True)
        keys.add(done.stdout.strip())
    assert len(keys) == 1 and len(keys.pop()) == 64


def test_two_processes_at_once(tmp_path: Path) -> None:
    code = ("import json, numpy as np\n"
            "from pamid.assembly import Assembly\n"
            "from pamid.library import rig_named\n"
            "from pamid.simulation import free_run\n"
            "a = Assembly(rig_named('one-dof'))\n"
            "u = np.zeros((100, 2)); u[10:50, 0] = 0.5\n"
            "print(json.dumps(free_run(a, u, a.values(), 0.003).outputs[-1].tolist()))\n")
    env = {**os.environ, "PAMID_CACHE": str(tmp_path)}
    both = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                             env=env) for _ in range(2)]
    said = [p.communicate() for p in both]
    assert [p.returncode for p in both] == [0, 0], said
    assert json.loads(said[0][0]) == json.loads(said[1][0])
    files = list((tmp_path / "models").iterdir())
    assert files and all(f.suffix == ".o" for f in files)       # nothing half-written is left
