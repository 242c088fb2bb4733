"""Results known by what went into them, and those who work them out."""

import json
import math
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.errors import DataError, PamidError
from pamid.base.parallel.jobs import ATTEMPTS, Failed, Work, WorkerPool
from pamid.base.parallel.packing import Question
from pamid.base.parallel.result_store import Store, digest
from pamid.model.registry import effects, rig_named

KEY = "ab" * 32
RESULT = {
    "values": np.arange(6.0).reshape(2, 3),
    "turned": np.arange(6.0).reshape(2, 3).T,
    "none": None,
    "empty": [],
    "found": [
        {
            "word": "größer",
            "yes": True,
            "count": 3,
            "size": 0.1,
            "worst": -math.inf,
            "off": math.nan,
        }
    ],
    "where": np.array([1, 2], np.int64),
    "chosen": np.array([True, False]),
}


# ---- the store --------------------


def journal(store: Store) -> list[dict[str, str]]:
    """What was worked out, in order."""
    return [json.loads(line) for line in (store.folder / "journal.jsonl").read_text().splitlines()]


def same(one: Any, other: Any) -> bool:
    """Equal to the last bit, kinds and memory layout included."""
    if isinstance(one, np.ndarray):
        return (
            isinstance(other, np.ndarray)
            and one.dtype == other.dtype
            and one.tobytes() == other.tobytes()
            and one.flags.f_contiguous == other.flags.f_contiguous
            and one.shape == other.shape
        )
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(v, other[k]) for k, v in one.items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and (one == other or one != one and other != other)


def test_a_result_comes_back_to_the_last_bit(tmp_path):
    store = Store(tmp_path / "jobs")
    assert store.get(KEY) is None
    store.put(KEY, "fitting", Question().packed(RESULT))
    packed = store.get(KEY)
    assert packed is not None and same(Question().unpacked(packed), RESULT)
    assert journal(store) == [{"key": KEY, "what": "fitting"}]
    (tmp_path / "jobs" / "notes.txt").write_text("mine")
    store.clear()
    assert [p.name for p in (tmp_path / "jobs").iterdir()] == ["notes.txt"], (
        "only its own files are removed"
    )


@pytest.mark.parametrize(
    "damage", ["cut", "flipped", "renamed", "pickle", "object", "number", "empty"]
)
def test_a_damaged_or_foreign_file_is_not_trusted(damage, tmp_path):
    store, marker = Store(tmp_path), tmp_path / "ran"
    store.put(KEY, "fitting", Question().packed(RESULT))
    path = tmp_path / f"{KEY}.npz"
    content, key = path.read_bytes(), KEY
    if damage == "cut":
        path.write_bytes(content[:-200])
    elif damage == "flipped":
        at = content.index(np.arange(6.0).tobytes()[:24]) + 8
        path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    elif damage == "renamed":
        key = "cd" * 32
        path.rename(tmp_path / f"{key}.npz")
    elif damage == "pickle":
        path.write_bytes(pickle.dumps(_Loud(marker)))
    elif damage == "object":
        np.savez(path, about=np.array([_Loud(marker)], object), allow_pickle=True)
    elif damage == "number":  # a whole file, but its digest is of another result
        with np.load(path) as held:
            arrays = dict(held)
        np.savez(path, **{**arrays, "a0": arrays["a0"] + 1e-9})
    else:
        path.write_bytes(b"")
    assert store.get(key) is None and not marker.exists()
    store.put(key, "fitting", Question().packed(RESULT))
    assert store.get(key) is not None, "worked out again, it stands there as new"


class _Loud:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.marker),)


# ---- digests --------------------


@dataclass(frozen=True)
class Thing:
    size: float
    watch: Any = field(default=None, compare=False)


def test_a_digest_sees_every_part():
    a = np.arange(6.0)
    different = [
        1,
        1.0,
        "1",
        True,
        None,
        (1,),
        [1],
        {"a": 1},
        {"a": 2},
        {"b": 1},
        a,
        a.reshape(2, 3),
        a.astype(int),
        a + 1e-15,
        Thing(1.0),
        Thing(2.0),
        Path("1"),
        frozenset({1}),
        Thing,
        effects()["leak"](),
        effects()["dead-time"](),
        rig_named("one-dof"),
        rig_named("one-dof:polynomial"),
        np.float32(1.0),
    ]
    digests = [digest(d) for d in different]
    assert len(set(digests)) == len(digests)
    assert digest(Thing(1.0, watch=3)) == digest(Thing(1.0, watch=print)), (
        "what does not change the result"
    )
    assert digest(a, a) == digest(a.copy(), a) != digest(a)
    assert digest(-0.0) != digest(0.0)


def test_a_digest_is_the_same_in_every_process():
    code = (
        "from pamid.model.registry import effects, rig_named; "
        "from pamid.base.parallel.result_store import digest; "
        "import numpy as np;print(digest(rig_named('one-dof'), "
        "sorted(effects().items()), {'b', 'a', 'c'}, np.arange(3.0)))"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }
    assert len(found) == 1


# ---- jobs --------------------


@dataclass(frozen=True)
class Rooting(Work[float, float]):
    """Square roots; -1 is a mistake, -2 data that cannot answer, -3 kills its process, -4 once
    only."""

    what = "root of"
    shift: float = 0.0
    once: Path | None = None

    def __call__(self, item: float) -> float:
        if item == -2.0:
            raise DataError("too short")
        if item == -4.0 and self.once and not self.once.exists():
            self.once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if item == -3.0:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.01 * (5.0 - abs(item)) if abs(item) < 5.0 else 0.0)
        return math.sqrt(item if item != -4.0 else 4.0) + self.shift


ITEMS = [4.0, 1.0, 9.0, 16.0, 2.0]
ROOTS = [2.0, 1.0, 3.0, 4.0, math.sqrt(2.0)]


@pytest.mark.parametrize(
    "pool", [WorkerPool(), WorkerPool(2), WorkerPool(8)], ids=["one", "two", "many"]
)
def test_results_stand_in_order_whoever_does_the_jobs(pool):
    told: list[str] = []
    assert pool.run(Rooting(), ITEMS, told.append) == ROOTS and pool.run(Rooting(), []) == []
    assert len(told) == 5 and told[-1].startswith("root of 5/5: ")
    assert pool.counts == {"worked": 5, "kept": 0, "failed": 0}


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_job_that_fails_costs_only_itself(jobs):
    pool = WorkerPool(jobs)
    found = pool.run(Rooting(), [4.0, -1.0, -2.0, 9.0])
    assert found[0] == 2.0 and found[3] == 3.0
    wrong, short = found[1:3]
    assert (
        isinstance(wrong, Failed)
        and "ValueError" in wrong.why
        and "test_store_and_jobs.py, line" in wrong.why
    )
    assert short == Failed("root of -2.0", "too short") and sorted(
        f.job for f in pool.failed
    ) == sorted(["root of -1.0", "root of -2.0"])
    with pytest.raises(PamidError, match="all 2 jobs failed.*too short"):
        WorkerPool(jobs).run(Rooting(), [-2.0, -2.0])


def test_a_process_that_is_killed_costs_no_other_job_anything(tmp_path):
    before = {c.pid for c in multiprocessing.active_children()}
    found = WorkerPool(2).run(Rooting(once=tmp_path / "killed"), [4.0, -3.0, 1.0, 9.0, -4.0])
    assert found[:1] + found[2:4] == [2.0, 1.0, 3.0]
    assert (tmp_path / "killed").exists() and found[4] == 2.0, "killed once, it is done again"
    assert isinstance(found[1], Failed) and f"killed {ATTEMPTS} times (signal 9)" in found[1].why
    assert {c.pid for c in multiprocessing.active_children()} <= before


def test_an_interrupt_ends_the_processes(tmp_path):
    def interrupt(text):
        raise KeyboardInterrupt

    before, awake = (
        {c.pid for c in multiprocessing.active_children()},
        tmp_path / "slept to the end",
    )
    with pytest.raises(KeyboardInterrupt):
        WorkerPool(2).run(_Sleeping(awake), [0.0, 300.0, 300.0], interrupt)
    assert not awake.exists()
    assert {c.pid for c in multiprocessing.active_children()} <= before


def test_the_processes_end_with_a_parent_that_is_killed():
    """They hold its end of a pipe: the pipe ends when the last of them does."""
    code = (
        "import pathlib, test_store_and_jobs as t; "
        "ready = lambda text: print('ready', flush=True); "
        "t.WorkerPool(2).run(t._Sleeping(pathlib.Path('nowhere')), [0.0, 300.0, 300.0], ready)"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, cwd=Path(__file__).parent, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"ready\n"
        parent.kill()
        assert parent.stdout.read() == b""


@dataclass(frozen=True)
class _Sleeping(Work[float, None]):
    awake: Path
    what = "sleeping"

    def __call__(self, item: float) -> None:
        time.sleep(item)
        if item:
            self.awake.touch()


def test_what_is_kept_is_not_worked_out_again(tmp_path):
    store = Store(tmp_path / "jobs")
    assert WorkerPool(2, store).run(Rooting(), ITEMS[:3]) == ROOTS[:3]
    assert len(journal(store)) == 3
    later = WorkerPool(1, store)
    assert later.run(Rooting(), ITEMS) == ROOTS and later.one(Rooting(), 9.0) == 3.0
    assert later.counts == {"worked": 2, "kept": 4, "failed": 0} and len(journal(store)) == 5
    other = WorkerPool(1, store)
    assert other.run(Rooting(shift=1.0), ITEMS) == [r + 1.0 for r in ROOTS] and other.worked == 5, (
        "another question"
    )
    for path in store.folder.glob("*.npz"):
        path.write_bytes(b"PK damaged")
    again = WorkerPool(1, store)
    assert again.run(Rooting(), ITEMS) == ROOTS and again.worked == 5


def test_another_version_of_the_code_trusts_nothing_of_the_former(tmp_path, monkeypatch):
    store = Store(tmp_path / "jobs")
    WorkerPool(1, store).run(Rooting(), ITEMS)
    monkeypatch.setattr("pamid.base.parallel.jobs.code_sha256", lambda: "another")
    pool = WorkerPool(1, store)
    pool.run(Rooting(), ITEMS)
    assert pool.counts == {"worked": 5, "kept": 0, "failed": 0}
