"""Jobs on a Dask cluster of two worker processes: bit for bit what one process finds, also where
workers are killed."""

import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame
from small_cart import FEW, RIG, cart_evidence, others, record_cart

from pamid.base.errors import FileError
from pamid.base.json_file import read_json
from pamid.base.parallel.dask_backend import Cluster, Patience, cluster
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.base.parallel.result_store import Store
from pamid.base.run_folder import Run
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.model.registry import effects

distributed = pytest.importorskip("distributed", reason="needs pamid[cluster]")

# whatever else this machine does: a limit only for what hangs
LONG = Patience(900.0, 900.0, 900.0)


@pytest.fixture(scope="module", autouse=True)
def _patient() -> Iterator[None]:
    import dask

    # a worker that was killed is called for as long as "connect": each time that a result lay with
    # it
    waits = {"distributed.comm.timeouts.connect": "20s", "distributed.comm.timeouts.tcp": "900s"}
    fewer = {"distributed.worker.daemon": True, "distributed.scheduler.allowed-failures": 1}
    with pytest.MonkeyPatch.context() as patch, dask.config.set({**fewer, **waits}):
        patch.setattr("pamid.base.parallel.dask_backend.DEFAULT_PATIENCE", LONG)
        yield


def local(workers: int, **options: Any) -> Any:
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=":0",
        silence_logs=50,
        **options,
    )


@pytest.fixture(scope="module")
def made() -> Iterator[Any]:
    """Two worker processes of one thread each, every one watched over by a nanny that replaces it
    when it dies."""
    with local(2, processes=True) as found:
        yield found


@pytest.fixture
def address(made) -> str:
    """Where they are found, both of them: what a test before has killed is replaced."""
    with distributed.Client(made, set_as_default=False) as client:
        client.wait_for_workers(2)
    found: str = made.scheduler_address
    return found


@pytest.fixture
def threads() -> Iterator[Any]:
    """Make a cluster of so many workers, threads of this process: where nothing is to be killed."""
    with contextlib.ExitStack() as open_ones:

        def made(n):
            return open_ones.enter_context(local(n, processes=False, protocol="tcp"))

        yield lambda n: made(n).scheduler_address


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


def workers(executor: Cluster) -> dict[str, int]:
    """Process numbers of the workers, by address."""
    found: dict[str, int] = executor.client.run(os.getpid)
    return found


def diagnosed(
    folder: Path, recording: Path, pool: WorkerPool, told: Any = lambda text: None
) -> dict[str, bytes]:
    """Files of a diagnosis."""
    run = Run.create(folder, command="test", seed=0)
    diagnose_into(
        run, cart_evidence(recording), {k: effects()[k] for k in FEW}, pool=pool, progress=told
    )
    return {
        name: (folder / name).read_bytes()
        for name in ("diagnosis.json", "fit.json", "residual.csv")
    }


def test_a_worker_killed_in_the_middle_changes_no_bit(address, recording, tmp_path):
    """The rig is a file that the workers have never seen: it is sent along."""
    alone = diagnosed(tmp_path / "alone", recording, WorkerPool())
    killed = []

    def told(text):
        if text.startswith("screening 2/") and not killed:
            killed.append(next(iter(workers(executor).values())))
            os.kill(killed[0], signal.SIGKILL)

    with cluster(address) as executor:
        pool = WorkerPool(store=Store(tmp_path / "jobs"), executor=executor)
        assert diagnosed(tmp_path / "together", recording, pool, told) == alone
        assert killed and killed[0] not in workers(executor).values()
    assert pool.failed == [] and json.loads(alone["diagnosis.json"])["verdict"] == "explained"
    resumed = WorkerPool(2, store=Store(tmp_path / "jobs"))
    assert diagnosed(tmp_path / "again", recording, resumed) == alone
    assert resumed.worked == 0 and resumed.from_store == pool.worked, (
        "found by the cluster, used by this machine"
    )


@dataclass(frozen=True, eq=False)
class _Deadly(Work[int, float]):
    """Sums; one item kills whoever takes it."""

    what = "sum"
    table: np.ndarray
    deadly: int

    def __call__(self, item: int) -> float:
        if item == self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.05)
        return float((self.table * item).sum())


def test_a_job_that_always_kills_its_worker_fails_alone():
    """With this saturation, a worker takes several jobs at once and its death is blamed on all of
    them. No worker has to come back, as a worker that dies while it starts is not replaced."""
    import dask

    table = np.random.default_rng(0).standard_normal((400, 40))
    expected = WorkerPool().run(_Deadly(table, -1), list(range(12)))
    queued = {
        "distributed.scheduler.worker-saturation": float("inf"),
        "distributed.scheduler.allowed-failures": 0,
    }
    with (
        dask.config.set(queued),
        local(3, processes=True) as made,
        cluster(made.scheduler_address) as executor,
    ):
        pool = WorkerPool(executor=executor)
        outcomes = pool.run(_Deadly(table, 5), list(range(12)))
    failed = outcomes.pop(5)
    assert isinstance(failed, Failed) and "was killed" in failed.why
    assert outcomes == expected[:5] + expected[6:]
    assert [f.job for f in pool.failed] == ["sum 5"]


def test_the_command(address, recording, tmp_path, capsys):
    words = ["diagnose", str(recording), "--rig", RIG, *others(), "--json"]
    far, near = tmp_path / "far", tmp_path / "near"
    assert frame.run([*words, "--output", str(far), "--cluster", address]) == 0
    assert frame.run([*words, "--output", str(near), "--jobs", "1"]) == 0
    assert (far / "diagnosis.json").read_bytes() == (near / "diagnosis.json").read_bytes()
    assert read_json(far / "run.json")["jobs"] == read_json(near / "run.json")["jobs"]
    capsys.readouterr()


def test_workers_have_to_be_alike(threads, monkeypatch):
    """Asked first for itself, this process has another code than afterwards, when its threads are
    asked."""
    said = iter(["another"])
    monkeypatch.setattr("pamid.base.parallel.dask_backend.code_sha256", lambda: next(said, "this"))
    with pytest.raises(FileError, match="2 of 2 workers .* another version"), cluster(threads(2)):
        pass
    with cluster(threads(2)):
        pass
