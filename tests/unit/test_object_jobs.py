"""Jobs of objects: handed over as they are in one process, plain where they are sent or kept, and
the same to the last bit either way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from small_cart import cart_evidence, record_cart

from pamid.base.progress import silent
from pamid.diagnosis.budget import _Baseline
from pamid.diagnosis.search import RefitStart, RefitWork
from pamid.model.attachment import attach
from pamid.model.registry import effects
from pamid.parallel.jobs import ObjectWork, Work, WorkerPool
from pamid.parallel.result_store import Store, digest, plain
from pamid.simulation.data_split import DataSplit


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
    work = RefitWork(evidence, model.fit, model.assembly.sizes)
    found = work.result(start)
    assert digest(through_the_plain_form(work, start, found)) == digest(found)
