"""Results that are objects: handed over as they are in one process, packed where they are sent or
kept, and the same to the last bit either way."""

import json
from dataclasses import dataclass
from typing import Any

import pytest
from small_cart import cart_evidence, record_cart

from pamid.base.parallel.jobs import Work, WorkerPool
from pamid.base.parallel.packing import Packed, Question
from pamid.base.parallel.result_store import Store, digest
from pamid.base.progress import silent
from pamid.diagnosis.budget import _Baseline
from pamid.diagnosis.search import RefitStart, RefitWork
from pamid.model.attachment import attach
from pamid.model.registry import effects
from pamid.simulation.data_split import DataSplit


@pytest.fixture(scope="module")
def evidence(tmp_path_factory) -> DataSplit:
    return cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))


@dataclass(frozen=True)
class Doubling(Work[int, set[int]]):
    what = "doubling"

    def __call__(self, item: int) -> set[int]:
        return {2 * item}


@pytest.mark.parametrize("jobs", [1, 2])
def test_sent_and_kept_they_come_back(jobs, tmp_path):
    for again in (False, True):
        pool = WorkerPool(jobs, Store(tmp_path))
        assert pool.run(Doubling(), [1, 2]) == [{2}, {4}] and pool.one(Doubling(), 3) == {6}
        assert (pool.from_store if again else pool.worked) == 3


def packed_and_unpacked(work: Work[Any, Any], item: Any, result: Any) -> Any:
    packed = Question(work, item).packed(result)
    packed = Packed(json.loads(json.dumps(packed.tree, allow_nan=False)), packed.arrays)
    return Question(work, item).unpacked(packed)


def test_models_are_the_same_objects_to_the_last_bit(evidence):
    """Values, kinds and memory layout: one digest. What belongs to the question is not copied."""
    baseline = _Baseline(evidence, silent)
    model = baseline(0)
    unpacked = packed_and_unpacked(baseline, 0, model)
    assert digest(unpacked) == digest(model) and unpacked.evidence is evidence
    start = RefitStart((attach(evidence.rig, "coulomb-friction", effects()),), assembly=None)
    work = RefitWork(evidence, model.fit, model.assembly.sizes)
    refitted = work(start)
    again = packed_and_unpacked(work, start, refitted)
    assert digest(again) == digest(refitted) and again.runs is again.replays
    assert again.assembly.rig is evidence.rig and again.attached is start.attached
    tracks = zip(again.fit.problem.tracks, model.fit.problem.tracks, strict=True)
    assert all(track.u is of_model.u for track, of_model in tracks)


@dataclass(frozen=True)
class Alien:
    size: float


def test_only_what_is_known_is_packed_and_unpacked():
    """An object of neither pamid nor the question is no result, and no name loads a class."""
    alien = Alien(1.0)
    assert packed_and_unpacked(Doubling(), alien, [alien, (alien,)])[1][0] is alien
    with pytest.raises(TypeError, match="Alien, which is no plain data"):
        Question(1).packed([alien])
    for name in ("os:_Environ", "pamid.base.files:Path", "pamid.not_there:Name", "sys"):
        with pytest.raises((ValueError, TypeError)):
            Question(1).unpacked(Packed({"object": name, "parts": {}}, ()))
