"""Independent jobs: pure functions, done in sequence, on this machine's cores or on a
cluster.

Whoever does them, a result is known by the digest of all that went into it and is the same to the
last bit: it does not depend on who did the job, how many did, or whether it was read back from an
earlier attempt. A job done in this process hands its result over as it is; from another process or
a file it comes packed (`pamid.base.parallel.packing`). The compiled sweeps release Python's lock,
so threads share the work where little else runs; a diagnosis, in which much else does, shares the
cores as processes. BLAS is held to a single thread per job: the matrices are small.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar
from weakref import WeakValueDictionary

from threadpoolctl import threadpool_limits

from pamid.base.errors import PamidError
from pamid.base.parallel.packing import Numbers, Packed, Question
from pamid.base.parallel.result_store import Store, code_sha256, digest
from pamid.base.progress import Progress, silent

T = TypeVar("T")
R = TypeVar("R")

_ENDING = (signal.SIGINT, signal.SIGTERM)
LARGE = 1 << 16  # bytes, from which equal arrays of results are held once
ATTEMPTS = 3  # times that a job's process may die before the job is held to be the reason


class Work(Generic[T, R]):
    """A kind of job: a pure function of an item and of its fields. Derive a frozen dataclass
    from it.

    Its result is made of plain data, of objects of pamid, and of parts of the item and the work
    (`pamid.base.parallel.packing`). A field that is declared with compare=False must not change it.
    """

    what: ClassVar[str]

    def __call__(self, item: T) -> R:
        raise NotImplementedError

    def name(self, item: T) -> str:
        return str(getattr(item, "label", item))

    def cost(self, item: T) -> float:
        """About how long it takes, in any unit: longer jobs are begun first."""
        return 0.0

    def label(self, item: T) -> str:
        return f"{self.what} {self.name(item)}".rstrip()


@dataclass(frozen=True)
class Failed:
    """A job without a result: what it was, and why it failed. The other jobs go on."""

    job: str
    why: str


class Jobs(Protocol):
    """Those who do jobs: (number of the item, result) as they come; `Failed` is a result, too."""

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Packed | Failed]]: ...


@dataclass(eq=False)
class WorkerPool:
    """Who does the jobs of a run, and where their results are stored.

    jobs: processes on this machine; executor: others who do them instead (a cluster); worked:
    how many were computed; from_store: how many were found there; failed: those without a result.
    """

    jobs: int = 1
    store: Store | None = None
    executor: Jobs | None = None
    worked: int = 0
    from_store: int = 0
    failed: list[Failed] = field(default_factory=list)
    _arrays: WeakValueDictionary[str, Numbers] = field(default_factory=WeakValueDictionary)

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
            stored = self._stored(keys[i], work, items[i])
            if stored:
                yield i, stored[0]
            else:
                todo.append(i)
        if self.executor is None and self.jobs <= 1:
            for i in todo:
                outcome = attempted(work, items[i], partial(self._here, work, items[i], keys[i]))
                self.failed += [outcome] if isinstance(outcome, Failed) else []
                yield i, outcome
            return
        do = self.executor or LocalJobs(self.jobs)
        for k, done in do(work, [items[i] for i in todo]) if todo else ():
            i = todo[k]
            if isinstance(done, Failed):
                self.failed.append(done)
                yield i, done
            else:
                self._count(keys[i], work.label(items[i]), done)
                yield i, self._unpacked(done, work, items[i])

    def one(self, work: Work[T, R], item: T) -> R:
        """A single job, done here and now; its errors are its caller's."""
        (key,) = self._keys(work, [item])
        stored = self._stored(key, work, item)
        return stored[0] if stored else self._here(work, item, key)

    def _stored(self, key: str, work: Work[T, R], item: T) -> tuple[R] | tuple[()]:
        packed = self.store.get(key) if self.store else None
        if packed is not None:
            with contextlib.suppress(LookupError, TypeError, ValueError, AttributeError):
                result = self._unpacked(packed, work, item)
                self.from_store += 1
                return (result,)
        return ()

    def _unpacked(self, packed: Packed, work: Work[T, R], item: T) -> R:
        # Models hold the samples that they were compared on: most of the memory of many models.
        arrays = [
            self._arrays.setdefault(digest(a), a) if a.nbytes >= LARGE else a for a in packed.arrays
        ]
        result: R = Question(work, item).unpacked(Packed(packed.tree, tuple(arrays)))
        return result

    def _here(self, work: Work[T, R], item: T, key: str) -> R:
        """The result, worked out in this process."""
        with threadpool_limits(limits=1, user_api="blas"):
            result = work(item)
        packed = Question(work, item).packed(result) if self.store else None
        self._count(key, work.label(item), packed)
        return result

    def _count(self, key: str, label: str, result: Packed | None) -> None:
        self.worked += 1
        if self.store and result:
            self.store.put(key, label, result)

    def _keys(self, work: Work[T, R], items: Sequence[T]) -> list[str]:
        """The items' keys; empty ones where nothing is stored."""
        ground = digest(code_sha256(), work) if self.store else ""
        return [digest(ground, item) if self.store else "" for item in items]


def packed_or_failure(work: Work[T, Any], item: T) -> Packed | Failed:
    """The job's result, or why there is none."""
    return attempted(work, item, lambda: Question(work, item).packed(work(item)))


def attempted(work: Work[T, Any], item: T, do: Callable[[], R]) -> R | Failed:
    """Result of `do`, or the reason why there is none."""
    try:
        return do()
    except PamidError as error:
        return Failed(work.label(item), str(error))
    # the tool's fault, or an effect file's: it must not cost the other jobs
    except Exception as error:
        return Failed(work.label(item), fault_text(error))


def fault_text(error: Exception) -> str:
    """An error nobody expected in a line: what, and where it was raised."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"


@dataclass(frozen=True)
class LocalJobs:
    """Processes of this machine that inherit all there is, so that only results are sent. A process
    that dies costs its job an attempt, and other jobs no more than their time.

    Of the jobs that were going on when a process died any may be the reason. Each of them is done
    again in a separate process.
    """

    count: int

    def __call__(
        self, work: Work[T, Any], items: Sequence[T]
    ) -> Iterator[tuple[int, Packed | Failed]]:
        todo = deque(range(len(items)))
        while todo:
            suspects, _ = yield from self._done(work, items, todo, self.count)
            for i in suspects:
                for _ in range(ATTEMPTS):
                    died, reason = yield from self._done(work, items, deque([i]), 1)
                    if not died:
                        break
                else:
                    why = f"its process was killed {ATTEMPTS} times ({reason}), perhaps for lack of"
                    yield i, Failed(work.label(items[i]), f"{why} memory")

    def _done(
        self, work: Work[T, Any], items: Sequence[T], todo: deque[int], count: int
    ) -> Generator[tuple[int, Packed | Failed], None, tuple[list[int], str]]:
        """Do jobs until none is left or a process dies. Returns those that were going on then, and
        how the process died."""
        context = multiprocessing.get_context("fork")
        pool = ProcessPoolExecutor(min(count, len(todo)), context, _begin, (work, items))
        processes: list[BaseProcess] = []
        busy: dict[Future[Packed | Failed], int] = {}
        try:
            while todo or busy:
                while todo and len(busy) < count:
                    # A signal that comes before a process is ready would end it with this process's
                    # answer to it.
                    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
                    try:
                        busy[pool.submit(_done_here, todo[0])] = todo[0]
                    finally:
                        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
                        # public as `terminate_workers` from Python 3.14 on
                        processes[:] = processes or pool._processes.values()
                    todo.popleft()
                for future in wait(busy, return_when=FIRST_COMPLETED).done:
                    outcome = future.result()
                    yield busy.pop(future), outcome
        except BrokenProcessPool:
            pass
        except BaseException:
            for process in processes:
                process.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
        # how the first process ended that was not terminated from here
        codes = [p.exitcode for p in processes if p.exitcode not in (None, 0)]
        code = next((c for c in codes if c != -signal.SIGTERM), -signal.SIGTERM) or 0
        return list(busy.values()), f"signal {-code}" if code < 0 else f"exit code {code}"


_given: list[tuple[Work[Any, Any], Sequence[Any]]] = []  # to this process, if it does jobs


def _begin(work: Work[T, Any], items: Sequence[T]) -> None:
    # Ctrl-C reaches every process of a terminal; the first decides
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)

    # it would wait for ever for the next job of a parent that was killed
    def end_with_parent() -> None:
        parent = multiprocessing.parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    threadpool_limits(limits=1, user_api="blas")
    _given.append((work, items))


def _done_here(number: int) -> Packed | Failed:
    work, items = _given[-1]
    return packed_or_failure(work, items[number])
