"""Compiled models on disk: found again, deleted, damaged, in the way of nobody, shared by two
processes."""

import json
import os
import pickle
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from compiled import program, run, state

from pamid.base import trust
from pamid.base.arrays import Array
from pamid.engine import jit_cache as machine
from pamid.engine.program import build_program

X = state("x")


def _unseen(seed: float) -> Array:
    """Output of a model that no other test compiles."""
    return run(program({"x": -(3.0 + seed) * X}, {"x": X}), np.zeros(10), x=[1.0])


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Iterator[Path]:
    monkeypatch.setenv("PAMID_CACHE", str(tmp_path / "cache"))
    _forget(monkeypatch)
    yield tmp_path / "cache" / "models"
    build_program.cache_clear()  # its programs live in the table that goes now


def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a new process would begin (the code already loaded stays alive: `monkeypatch` keeps the
    old table)."""
    build_program.cache_clear()
    monkeypatch.setattr(machine, "_loaded", {})


@pytest.fixture
def compiled_texts(monkeypatch) -> list[str]:
    seen: list[str] = []
    real = machine._compile

    def counted(ir_text):
        seen.append(ir_text)
        return real(ir_text)

    monkeypatch.setattr(machine, "_compile", counted)
    return seen


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:40],
        lambda data: data[:-1],
        lambda data: b"\0" * len(data),
        lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:],
        lambda data: data + b"more",
    ],
    ids=["empty", "cut", "one byte short", "zeros", "one bit", "longer"],
)
def test_a_damaged_file_is_compiled_again(damage, cache, compiled_texts, monkeypatch):
    first = _unseen(0.25)
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    _forget(monkeypatch)
    np.testing.assert_array_equal(_unseen(0.25), first)
    assert len(compiled_texts) == 2 and file.read_bytes() == whole


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path, compiled_texts, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv("PAMID_CACHE", str(blocked))
    _forget(monkeypatch)
    assert np.isfinite(_unseen(0.5)).all() and len(compiled_texts) == 1


def test_two_processes_at_once(tmp_path):
    code = (
        "import json, numpy as np\n"
        "from pamid.model.assembly import Assembly\n"
        "from pamid.model.registry import rig_named\n"
        "from pamid.simulation.free_runs import free_run\n"
        "a = Assembly(rig_named('one-dof'))\n"
        "u = np.zeros((100, 2)); u[10:50, 0] = 0.5\n"
        "print(json.dumps(free_run(a, u, a.values(), 0.003).outputs[-1].tolist()))\n"
    )
    env = {**os.environ, "PAMID_CACHE": str(tmp_path)}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=env,
        )
        for _ in range(2)
    ]
    said = [p.communicate() for p in both]
    assert [p.returncode for p in both] == [0, 0], said
    assert json.loads(said[0][0]) == json.loads(said[1][0])
    files = list((tmp_path / "models").iterdir())
    assert files and all(f.suffix == ".o" for f in files)  # nothing half-written is left


# ---- what others may have written is not loaded --------------------


def _planted(cache: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Array, Array]:
    """A file of the cache with another model's code in it, which vouches for itself; that model's
    answer, and the right one."""
    right, wrong = _unseen(0.75), _unseen(0.875)
    _forget(monkeypatch)
    names = {}
    for seed in (0.75, 0.875):
        build_program.cache_clear()
        before = set(machine._loaded)
        _unseen(seed)
        (names[seed],) = set(machine._loaded) - before
    file = cache / f"{names[0.75]}.o"
    file.write_bytes((cache / f"{names[0.875]}.o").read_bytes())
    _forget(monkeypatch)
    assert not np.array_equal(right, wrong)
    return file, wrong, right


def _link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to(path.with_name("elsewhere"))


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


OTHERS: dict[str, Callable[[Path], None]] = {
    "everybody writes the folder": lambda file: file.parent.chmod(0o777),
    "as /tmp": lambda file: file.parent.chmod(0o1777),
    "a group writes the folder": lambda file: file.parent.chmod(0o770),
    "everybody writes the file": lambda file: file.chmod(0o666),
    "a group writes the file": lambda file: file.chmod(0o660),
    "the folder is a link": lambda file: _link(file.parent),
    "the file is a link": _link,
    "the file is a pipe": _pipe,
}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
def test_what_others_may_have_written_is_never_loaded(cache, compiled_texts, monkeypatch):
    """Loading it runs it: an object planted in a folder that a group may write once gave its own
    answer."""
    file, wrong, right = _planted(cache, monkeypatch)
    planted = file.read_bytes()
    # planted by the user himself: it does what it says
    np.testing.assert_array_equal(_unseen(0.75), wrong)
    monkeypatch.setattr(trust, "_private_group", lambda gid: False)
    for told, share in OTHERS.items():
        file.write_bytes(planted)
        share(file)
        _forget(monkeypatch)
        count = len(compiled_texts)
        np.testing.assert_array_equal(_unseen(0.75), right, err_msg=told)
        assert len(compiled_texts) == count + 1, told
        cache.unlink() if cache.is_symlink() else shutil.rmtree(cache)
        shutil.rmtree(cache.with_name("elsewhere"), ignore_errors=True)
        cache.mkdir(mode=0o700)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
def test_nothing_is_left_where_others_may_write_and_the_own_folder_is_private(cache, monkeypatch):
    before = os.umask(0)
    try:
        _unseen(0.9375)
    finally:
        os.umask(before)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert [stat.S_IMODE(file.stat().st_mode) for file in cache.iterdir()] == [0o600]
    cache.chmod(0o777)
    _forget(monkeypatch)
    _unseen(0.96875)
    assert len(list(cache.iterdir())) == 1


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
def test_somebody_elses_folder_is_not_used(cache, compiled_texts, monkeypatch):
    _unseen(0.3125)
    _forget(monkeypatch)
    monkeypatch.setattr(trust, "_is_anothers", lambda found: True)
    _unseen(0.3125)
    assert len(compiled_texts) == 2


CACHE_OF_NUMBA = (
    "import pamid.engine.integrator, numba.core.config as c; c.reload_config(); print(c.CACHE_DIR)"
)


def _cache_of_numba(folder: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CACHE_OF_NUMBA],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    return done.stdout.strip()


def test_numba_takes_no_settings_from_the_working_folder(tmp_path):
    """The files of its cache are pickles: a folder that says where they lie would run code."""
    pytest.importorskip("yaml")
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: ./planted\n")
    assert "planted" not in _cache_of_numba(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
def test_numba_keeps_nothing_where_others_may_write(tmp_path):
    (own := tmp_path / "own").mkdir(mode=0o700)
    assert _cache_of_numba(tmp_path, NUMBA_CACHE_DIR=str(own)) == str(own)
    (shared := tmp_path / "shared").mkdir()
    shared.chmod(0o777)
    for chosen in (shared, shared / "not" / "there"):
        used = Path(_cache_of_numba(tmp_path, NUMBA_CACHE_DIR=str(chosen), TMPDIR=str(own)))
        assert used.is_relative_to(own) and not used.exists()  # gone with its process


KERNEL = """
from pamid.engine.numba_cache import njit

@njit(cache=True)
def twice(x):
    return 2.0 * x
"""


def test_a_function_compiled_by_a_version_with_other_modules_is_compiled_again(tmp_path):
    (own := tmp_path / "own").mkdir(mode=0o700)
    (tmp_path / "kernel.py").write_text(KERNEL)
    words = [sys.executable, "-c", "import kernel; print(kernel.twice(2.0))"]

    def ran():
        paths = os.pathsep.join([str(tmp_path), *sys.path])
        environment = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(own)}
        return subprocess.run(
            words, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert ran() == "4.0\n"
    (index,) = own.rglob("kernel*.nbi")
    version = pickle.dumps(pickle.loads(index.read_bytes()))
    index.write_bytes(version + b"cpamid.moved\nTyp\n.")
    with pytest.raises(ModuleNotFoundError):
        pickle.loads(index.read_bytes()[len(version) :])
    assert ran() == "4.0\n"
    assert b"pamid.moved" not in index.read_bytes()
