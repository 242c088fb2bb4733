"""Independent jobs: pure functions, done one after the other, on this machine's cores or on a
cluster.

Whoever does them, a result is known by the digest of all that went into it and is the same to the
last bit: it does not depend on who did the job, how many did, or whether it was read back from an
earlier attempt. What crosses to another process or into a file is plain data; a job of objects
(`ObjectWork`) that is done in this process hands them over as they are. The compiled sweeps release
Python's lock, so threads share the work where little else runs; a diagnosis, in which much else
does, shares the cores as processes. BLAS is held to one thread per job: the matrices are small.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from pamid.base.errors import PamidError
from pamid.base.progress import Progress, silent
from pamid.parallel.result_store import Plain, Store, code_sha256, digest, plain

T = TypeVar("T")
R = TypeVar("R")

_ENDING = (signal.SIGINT, signal.SIGTERM)
ATTEMPTS = 3  # times that a job's process may die before the job is held to be the reason


class Work(Generic[T, R]):
    """One kind of job: a pure function of an item and of its own fields. Derive a frozen dataclass
    from it.

    Calling it returns plain data (see result_store.py); `restored` makes of that what the caller
    wants. A field that is declared with compare=False must not change the result.
    """

    what: ClassVar[str]

    def __call__(self, item: T) -> Plain:
        raise NotImplementedError

    def restored(self, item: T, plain: Plain) -> R:
        raise NotImplementedError

    def name(self, item: T) -> str:
        """Name of the item."""
        return str(item)

    def cost(self, item: T) -> float:
        """About how long it takes, in any unit: longer jobs are begun first."""
        return 0.0

    def label(self, item: T) -> str:
        return f"{self.what} {self.name(item)}".rstrip()


class ObjectWork(Work[T, R]):
    """Jobs whose results are objects, made plain only to be sent or kept.

    `restored(item, plain(plain_form(item, found)))` equals `found` to the last bit, the memory
    layout of its arrays included: they have one digest (`pamid.parallel.result_store.digest`).
    """

    def result(self, item: T) -> R:
        raise NotImplementedError

    def plain_form(self, item: T, result: R) -> Plain:
        raise NotImplementedError

    def __call__(self, item: T) -> Plain:
        return self.plain_form(item, self.result(item))


@dataclass(frozen=True)
class Failed:
    """A job without a result: what it was, and why it failed. The other jobs go on."""

    job: str
    why: str


class Executor(Protocol):
    """Those who do jobs: (number of the item, result) as they come; `Failed` is a result, too."""

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Plain | Failed]]: ...


@dataclass(eq=False)
class WorkerPool:
    """Who does the jobs of a run, and where their results are stored.

    jobs: processes on this machine; executor: others who do them instead (a cluster); worked:
    how many were computed; from_store: how many were found there; failed: those without a result.
    """

    jobs: int = 1
    store: Store | None = None
    executor: Executor | None = None
    worked: int = 0
    from_store: int = 0
    failed: list[Failed] = field(default_factory=list)

    @property
    def failed_jobs(self) -> list[dict[str, str]]:
        """The jobs that failed, as results tell them."""
        return [{"job": f.job, "why": f.why} for f in self.failed]

    @property
    def counts(self) -> dict[str, int]:
        """How many jobs were computed, found in the store, and failed."""
        return {"worked": self.worked, "kept": self.from_store, "failed": len(self.failed)}

    def run(
        self, work: Work[T, R], items: Iterable[T], progress: Progress = silent
    ) -> list[R | Failed]:
        """Results in the order of the items; progress: how far it is. PamidError where there were
        several jobs and all failed."""
        todo = list(items)
        results: dict[int, R | Failed] = {}
        for i, outcome in self.finished(work, todo):
            results[i] = outcome
            progress(f"{work.what} {len(results)}/{len(todo)}: {work.name(todo[i])}")
        failed = [f for f in results.values() if isinstance(f, Failed)]
        if len(failed) == len(todo) > 1:
            raise PamidError(
                f"all {len(todo)} jobs failed, the first of them, {failed[0].job}: {failed[0].why}",
                code="jobs",
            )
        return [results[i] for i in range(len(todo))]

    def finished(self, work: Work[T, R], items: Sequence[T]) -> Iterator[tuple[int, R | Failed]]:
        """(number of the item, result) as they come, those from the store first."""
        keys = self._keys(work, items)
        todo = []
        for i in sorted(range(len(items)), key=lambda i: -work.cost(items[i])):
            stored = self.store.get(keys[i]) if self.store else None
            if stored is None:
                todo.append(i)
            else:
                self.from_store += 1
                yield i, work.restored(items[i], stored)
        if self.executor is None and self.jobs <= 1:
            for i in todo:
                outcome = attempted(work, items[i], partial(self._here, work, items[i], keys[i:]))
                self.failed += [outcome] if isinstance(outcome, Failed) else []
                yield i, outcome
            return
        for k, done in self._executor()(work, [items[i] for i in todo]) if todo else ():
            i = todo[k]
            if isinstance(done, Failed):
                self.failed.append(done)
                yield i, done
            else:
                self._store_result(keys[i:], work.label(items[i]), done)
                yield i, work.restored(items[i], done)

    def one(self, work: Work[T, R], item: T) -> R:
        """A single job, done here and now; its errors are its caller's."""
        keys = self._keys(work, [item])
        stored = self.store.get(keys[0]) if self.store else None
        if stored is None:
            return self._here(work, item, keys)
        self.from_store += 1
        return work.restored(item, stored)

    def _here(self, work: Work[T, R], item: T, keys: list[str]) -> R:
        """The result, worked out in this process; keys: its own first."""
        with threadpool_limits(limits=1, user_api="blas"):
            if isinstance(work, ObjectWork):
                result: R = work.result(item)
                plain_result = work.plain_form(item, result) if self.store else {}
                self._store_result(keys, work.label(item), plain_result)
                return result
            outcome = plain(work(item))
        self._store_result(keys, work.label(item), outcome)
        return work.restored(item, outcome)

    def _store_result(self, keys: list[str], label: str, result: Plain) -> None:
        self.worked += 1
        if self.store:
            self.store.put(keys[0], label, plain(result))

    def _keys(self, work: Work[T, R], items: Sequence[T]) -> list[str]:
        """The items' keys; none where nothing is stored."""
        ground = digest(code_sha256(), work) if self.store else ""
        return [digest(ground, item) for item in items] if self.store else []

    def _executor(self) -> Executor:
        if self.executor is not None:
            return self.executor
        return (
            Processes(self.jobs)
            if "fork" in multiprocessing.get_all_start_methods()
            else Threads(self.jobs)
        )


def result_or_failure(work: Work[T, Any], item: T) -> Plain | Failed:
    """The job's plain result, or why there is none."""
    return attempted(work, item, lambda: plain(work(item)))


def attempted(work: Work[T, Any], item: T, do: Callable[[], R]) -> R | Failed:
    """Result of `do`, or the reason why there is none."""
    try:
        return do()
    except PamidError as error:
        return Failed(work.label(item), str(error))
    # the tool's own fault, or an effect file's: it must not cost the other jobs
    except Exception as error:
        return Failed(work.label(item), fault_text(error))


def fault_text(error: Exception) -> str:
    """An error nobody expected in one line: what, and where it was raised."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"


@dataclass(frozen=True)
class Threads:
    """Threads of this process."""

    count: int

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Plain | Failed]]:
        pool = ThreadPoolExecutor(max_workers=self.count)
        try:
            with threadpool_limits(limits=1, user_api="blas"):
                futures = {
                    pool.submit(result_or_failure, work, item): i for i, item in enumerate(items)
                }
                for future in as_completed(futures):
                    yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@dataclass(frozen=True)
class Processes:
    """Processes of this machine that inherit all there is, so that only results are sent; begun in
    a moment. One that dies costs its own job an attempt and no other job anything."""

    count: int

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Plain | Failed]]:
        todo, attempts, idle = deque(range(len(items))), [0] * len(items), deque[_WorkerProcess]()
        busy: dict[Connection, tuple[_WorkerProcess, int]] = {}
        workers: list[_WorkerProcess] = []
        try:
            while todo or busy:
                while todo and len(busy) < self.count:
                    worker = idle.popleft() if idle else _WorkerProcess.begun(work, items, workers)
                    i = todo.popleft()
                    worker.ask(i)
                    busy[worker.connection] = worker, i
                for connection in wait(list(busy)):
                    assert isinstance(connection, Connection)
                    worker, i = busy.pop(connection)
                    try:
                        outcome = connection.recv()
                    except (EOFError, OSError):
                        attempts[i] += 1
                        reason = worker.end()
                        workers.remove(worker)
                        if attempts[i] < ATTEMPTS:
                            todo.appendleft(i)
                        else:
                            yield (
                                i,
                                Failed(
                                    work.label(items[i]),
                                    f"its process was killed {ATTEMPTS} times "
                                    f"({reason}), perhaps for want of memory",
                                ),
                            )
                        continue
                    idle.append(worker)
                    yield i, outcome
        finally:
            for worker in workers:
                worker.process.terminate()
            for worker in workers:
                worker.end()


@dataclass(frozen=True, eq=False)
class _WorkerProcess:
    """A process that works out the items whose numbers it is sent."""

    connection: Connection
    process: Any

    @classmethod
    def begun(
        cls, work: Work[T, Any], items: Sequence[T], workers: list[_WorkerProcess]
    ) -> _WorkerProcess:
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        # it inherits our ends of all lines: were they left open there, none would end if this
        # process died
        inherited = [ours, *(worker.connection for worker in workers)]
        process = context.Process(target=_serve, args=(theirs, inherited, work, items), daemon=True)
        # a signal that comes before the child is ready for it would end it with the parent's answer
        # to it
        held = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)
        theirs.close()
        worker = cls(ours, process)
        workers.append(worker)
        return worker

    def ask(self, number: int) -> None:
        # it has died: the line says so when it is listened to
        with contextlib.suppress(OSError):
            self.connection.send(number)

    def end(self) -> str:
        """Wait for the end of a process that has died or was asked to end; says how it ended."""
        self.process.join(5.0)
        self.connection.close()
        code = self.process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"


def _serve(
    connection: Connection, inherited: list[Connection], work: Work[T, Any], items: Sequence[T]
) -> None:
    # Ctrl-C reaches every process of a terminal; the first one decides
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    for other in inherited:
        other.close()
    with threadpool_limits(limits=1, user_api="blas"), contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(result_or_failure(work, items[connection.recv()]))


def run_jobs(work: Callable[[T], R], items: Iterable[T], *, jobs: int = 1) -> list[R]:
    """[work(item) for item in items] on `jobs` threads; an error ends them all."""
    todo = list(items)
    with threadpool_limits(limits=1, user_api="blas"):
        if jobs <= 1:
            return [work(item) for item in todo]
        pool = ThreadPoolExecutor(max_workers=jobs)
        try:
            return list(pool.map(work, todo))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
