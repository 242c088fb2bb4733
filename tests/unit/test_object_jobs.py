"""Jobs of objects: handed over as they are in one process, plain where they are sent or kept, and
the same to the last bit either way."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from small_cart import FEW, cart_evidence, record_cart

import pamid.model.assembly
import pamid.simulation.data_split
from pamid.base.progress import silent
from pamid.diagnosis.budget import _Baseline
from pamid.diagnosis.search import RefitStart, Refitting
from pamid.diagnosis.tournament import diagnose
from pamid.model.attachment import attach
from pamid.model.registry import effects
from pamid.parallel.jobs import ObjectWork, Work, WorkerPool
from pamid.parallel.result_store import Store, digest, plain
from pamid.simulation.data_split import DataSplit
from pamid.verdict.verdict_figures import diagnosis_file


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> DataSplit:
    return cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))


@dataclass(frozen=True)
class Doubling(ObjectWork[int, set[int]]):
    """Sets are no plain data."""

    what = "doubling"

    def result(self, item: int) -> set[int]:
        return {2 * item}

    def plain_form(self, item: int, found: set[int]) -> dict[str, Any]:
        return {"all": sorted(found)}

    def restored(self, item: int, found: dict[str, Any]) -> set[int]:
        return set(found["all"])


@dataclass(frozen=True)
class NeverPlain(Doubling):
    def plain_form(self, item: int, found: set[int]) -> dict[str, Any]:
        raise AssertionError("made plain, though it is neither sent nor kept")


def test_in_one_process_nothing_is_made_plain() -> None:
    pool = WorkerPool()
    assert pool.run(NeverPlain(), [1, 2]) == [{2}, {4}] and pool.one(NeverPlain(), 3) == {6}
    assert pool.counts == {"worked": 3, "kept": 0, "failed": 0}


@pytest.mark.parametrize("jobs", [1, 2])
def test_sent_and_kept_they_come_back(jobs: int, tmp_path: Path) -> None:
    for again in (False, True):
        pool = WorkerPool(jobs, Store(tmp_path))
        assert pool.run(Doubling(), [1, 2]) == [{2}, {4}] and pool.one(Doubling(), 3) == {6}
        assert (pool.from_store if again else pool.worked) == 3


def through_the_plain_form(work: Work[Any, Any], item: Any, found: Any) -> Any:
    assert isinstance(work, ObjectWork)
    return work.restored(item, plain(work.plain_form(item, found)))


def test_models_are_the_same_objects_to_the_last_bit(evidence: DataSplit) -> None:
    """Values, kinds and memory layout: one digest."""
    baseline = _Baseline(evidence, silent)
    model = baseline.result(0)
    assert digest(through_the_plain_form(baseline, 0, model)) == digest(model)
    start = RefitStart((attach(evidence.rig, "coulomb-friction", effects()),))
    work = Refitting(evidence, model.fit, model.assembly.sizes)
    found = work.result(start)
    assert digest(through_the_plain_form(work, start, found)) == digest(found)


def test_a_diagnosis_converts_recordings_once_per_model(
    evidence: DataSplit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same answer from one process, from two with a store, and read back; in one process every
    model meets a recording four times (screened, its further steps, fitted, held out), and is put
    together once."""
    catalogue = {name: effects()[name] for name in FEW}
    count: Counter[str] = Counter()

    def counted(module: Any, name: str) -> None:
        real = getattr(module, name)

        def call(*given: Any) -> Any:
            count[name] += 1
            return real(*given)

        monkeypatch.setattr(module, name, call)

    counted(pamid.simulation.data_split, "track_of")
    counted(pamid.model.assembly, "trace")

    def answer(pool: WorkerPool) -> dict[str, Any]:
        count.clear()
        return diagnosis_file(diagnose(evidence, catalogue, pool=pool)).as_json()

    alone = answer(WorkerPool())
    once = dict(count)
    models = len(alone["ranking"])
    assert once["track_of"] <= 4 * models + 8
    # of each model, of the free forms at each port, and of some without effects: the baseline, its
    # ways of feeding inputs and its checks
    assert once["trace"] <= models + 2 * len(evidence.rig.ports) + 11
    for _ in range(2):
        pool = WorkerPool(2, Store(tmp_path))
        assert answer(pool) == alone
    assert pool.worked == 0 < pool.from_store
