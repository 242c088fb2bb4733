"""Jobs on a Dask cluster: workers on other machines that a scheduler hands them to.

What a job needs, recordings and fitted models, goes to the scheduler once and from there to every
worker that requests it; a worker that dies is replaced by another, and only the jobs it held
are done again. A job that ends its workers `distributed.scheduler.allowed-failures` + 1 times
(four, unless the scheduler is configured otherwise) is given up; where several are suspected, each
is first done again alone.

Scheduler and workers have to be trusted, and so does everybody who can reach them: jobs and results
are pickles, which run code where they are unpacked, on the workers and here. At a tls:// address
only who has a certificate is let in; which are used stands in Dask's configuration
(`distributed.comm.tls`).
"""

from __future__ import annotations

import asyncio
import contextlib
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from threadpoolctl import threadpool_limits

from pamid.base.errors import FileError, PamidError
from pamid.base.parallel.jobs import Failed, Work, packed_or_failure
from pamid.base.parallel.packing import Packed
from pamid.base.parallel.result_store import code_sha256, digest

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as DaskFuture

T = TypeVar("T")

LISTEN_S = 5.0


@dataclass(frozen=True)
class Patience:
    """How long to wait, s: for the scheduler to answer, for its first worker, without any worker
    while jobs wait."""

    answer_s: float = 15.0
    first_s: float = 15.0
    alone_s: float = 120.0


DEFAULT_PATIENCE = Patience()


@contextlib.contextmanager
def cluster(address: str, patience: Patience = DEFAULT_PATIENCE) -> Iterator[Cluster]:
    """The cluster whose scheduler listens at an address such as tcp://host:8786.

    FileError where distributed is not installed, nobody answers in time, there is no worker, or the
    workers run another pamid than here.
    """
    client = _connected(address, patience.answer_s)
    try:
        _require_alike(client, address, patience.first_s)
        yield Cluster(client, address, patience)
    finally:
        client.close(timeout=LISTEN_S)


def _connected(address: str, patience_s: float) -> Client:
    try:
        from distributed import Client, Security, rpc
    except ImportError:
        message = "--cluster needs the package distributed, which is not installed."
        raise FileError(message, "pip install 'pamid[cluster]'", code="missing-package") from None

    async def name() -> str:
        arguments = Security().get_connection_args("client")
        async with rpc(address, connection_args=arguments) as scheduler:
            return str((await scheduler.identity(n_workers=0))["id"])

    try:
        # checked first: a port on which something else listens keeps a client waiting whatever its
        # limit
        asyncio.run(asyncio.wait_for(name(), patience_s))
        return Client(address, timeout=patience_s, set_as_default=False, name="pamid")
    # the first: time limits, certificates
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        why = f": {error}" if str(error) else ""
        if address.startswith("tls:"):
            why += (
                "; its certificates are those of Dask's configuration, as "
                "DASK_DISTRIBUTED__COMM__TLS__CA_FILE"
            )
        hint = "Start one with `dask scheduler` and give the address it prints"
        raise _refused(
            f"no scheduler answers at {address} within {patience_s:g} s{why}",
            f"{hint}, such as tcp://host:8786.",
        ) from error


def fingerprint() -> dict[str, str]:
    """Properties in which all machines must agree for equal results; other processors round
    differently."""
    return {"code": code_sha256(), "processor": f"{platform.system()} {platform.machine()}"}


def _refused(message: str, hint: str) -> FileError:
    return FileError(message, hint, code="cluster")


def _require_alike(client: Client, address: str, patience_s: float) -> None:
    deadline = time.monotonic() + patience_s
    while not client.scheduler_info(n_workers=-1)["workers"]:
        if time.monotonic() > deadline:
            hint = f"Start some: `dask worker {address} --nworkers 4 --nthreads 1`."
            raise _refused(f"the scheduler at {address} has no workers", hint)
        time.sleep(0.1)
    expected = fingerprint()
    try:
        fingerprints = client.run(fingerprint)
    except (ImportError, AttributeError) as error:
        message = f"the workers of {address} cannot load pamid: {error}"
        raise _refused(message, "Install the same version there.") from error
    other = sorted(worker for worker, theirs in fingerprints.items() if theirs != expected)
    if other:
        raise _refused(
            f"{len(other)} of {len(fingerprints)} workers of {address} run another version of "
            f"pamid or of a numerical package than this machine: {', '.join(other[:3])}",
            "Install the same versions everywhere: results would depend on the worker.",
        )


@dataclass(eq=False)
class Cluster:
    """A connection that does jobs."""

    client: Client
    address: str
    patience: Patience = DEFAULT_PATIENCE
    # by digest: the parts of works that are there already
    sent: dict[str, DaskFuture] = field(default_factory=dict)

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Packed | Failed]]:
        import dask

        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "2GiB"}):
            parts = {f.name: self._part(getattr(work, f.name)) for f in fields(work) if f.compare}  # type: ignore[arg-type]
            kind = _pickled(type(work))
            executor = self.client.get_executor(pure=False)

            def submit(i: int) -> Future[Packed | Failed]:
                key = f"{work.what}-{i}-{time.monotonic_ns()}"
                packed = _pickled(items[i])
                return executor.submit(_done, kind, parts, packed, code_sha256(), key=key)

            waiting = {submit(i): i for i in range(len(items))}
        suspects: dict[int, Packed | Failed] = {}
        for i, future in self._ended(waiting, executor):
            outcome = self._outcome(future, work.label(items[i]))
            if _killed(future):
                suspects[i] = outcome
            else:
                yield i, outcome
        if len(suspects) == 1:
            yield from suspects.items()
            return
        # the scheduler blames a worker's death on every job that was queued there
        for suspect in suspects:
            for i, future in self._ended({submit(suspect): suspect}, executor):
                yield i, self._outcome(future, work.label(items[i]))

    def _ended(
        self, waiting: dict[Future[Packed | Failed], int], executor: Executor
    ) -> Iterator[tuple[int, Future[Packed | Failed]]]:
        """Jobs as they end, by their item's number. PamidError if the cluster is lost."""
        alone = 0.0
        try:
            while waiting:
                ended = wait(waiting, LISTEN_S, FIRST_COMPLETED).done
                for future in ended:
                    yield waiting.pop(future), future
                if self.client.status != "running":
                    raise self._lost()
                there = ended or self.client.scheduler_info(n_workers=-1)["workers"]
                alone = 0.0 if there else alone + LISTEN_S
                if alone >= self.patience.alone_s:
                    raise PamidError(
                        f"the scheduler at {self.address} has had no workers for {alone:.0f} s",
                        "Start workers and continue with --resume; finished jobs are kept.",
                        code="cluster",
                    )
        finally:
            if waiting and self.client.status == "running":
                executor.shutdown(wait=False)

    def _part(self, value: Any) -> DaskFuture:
        """Something that many jobs need, as a separate task: where every worker that held it has
        died, the scheduler still knows it."""
        key = f"part-{digest(value)}"
        if key not in self.sent:
            self.sent[key] = self.client.submit(_unpickled, _pickled(value), key=key)
        return self.sent[key]

    def _outcome(self, future: Future[Packed | Failed], label: str) -> Packed | Failed:
        if future.cancelled():
            raise self._lost()
        error = future.exception()
        if error is None:
            return future.result()
        if _killed(future):
            times = error.allowed_failures + 1  # type: ignore[attr-defined]
            return Failed(label, f"its worker was killed {times} times, perhaps for lack of memory")
        return Failed(label, f"{type(error).__name__}: {error}")

    def _lost(self) -> PamidError:
        return PamidError(
            f"the connection to the scheduler at {self.address} was lost",
            "Continue with --resume; finished jobs are kept.",
            code="cluster",
        )


def _killed(future: Future[Any]) -> bool:
    """Whether a job was given up because its workers died."""
    from distributed import KilledWorker

    return not future.cancelled() and isinstance(future.exception(), KilledWorker)


def _pickled(value: Any) -> bytes:
    """Bytes for a worker. What a rig or effect file defines is sent along: the file need not be
    there."""
    import cloudpickle

    for name, module in list(sys.modules.items()):
        if name.startswith("pamid_user_"):
            cloudpickle.register_pickle_by_value(module)
    pickled: bytes = cloudpickle.dumps(value)
    return pickled


def _unpickled(pickled: bytes) -> Any:
    import cloudpickle

    return cloudpickle.loads(pickled)


@lru_cache
def _hold_blas() -> None:
    """For good: a worker may do several jobs in threads."""
    threadpool_limits(limits=1, user_api="blas")


def _done(kind: bytes, parts: dict[str, Any], item: bytes, code: str) -> Packed | Failed:
    """On a worker; code: that of the machine which asks (a worker may have been replaced since they
    were compared)."""
    _hold_blas()
    work, unpacked = _unpickled(kind)(**parts), _unpickled(item)
    if code != code_sha256():
        return Failed(work.label(unpacked), "its worker runs another pamid")
    return packed_or_failure(work, unpacked)
