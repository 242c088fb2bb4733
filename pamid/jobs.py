"""Independent jobs on this machine's cores: pure functions, results in the order of the jobs.

The compiled sweeps release Python's lock, so threads share the work where little else runs; a diagnosis, in which much
else does, shares the cores as processes. BLAS is held to one thread per job: the matrices are small.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from pamid.errors import PartialError

T = TypeVar("T")
R = TypeVar("R")


def run_jobs(work: Callable[[T], R], items: Iterable[T], *, jobs: int = 1,
             done: Callable[[int, int], None] | None = None) -> list[R]:
    """[work(item) for item in items] on `jobs` threads; done(finished, total) after each."""
    todo = list(items)
    results: list[R] = []
    with threadpool_limits(limits=1, user_api="blas"):
        if jobs <= 1:
            for item in todo:
                results.append(work(item))
                if done is not None:
                    done(len(results), len(todo))
            return results
        pool = ThreadPoolExecutor(max_workers=jobs)
        try:
            for result in pool.map(work, todo):
                results.append(result)
                if done is not None:
                    done(len(results), len(todo))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        pool.shutdown()
    return results


def run_in_processes(work: Callable[[T], R], items: Iterable[T], *, jobs: int = 1,
                     done: Callable[[int, int], None] | None = None) -> list[R]:
    """[work(item) for item in items] in `jobs` fresh processes; done(finished, total) as each comes in.

    `work`, items and results have to be picklable. An interrupt or an error ends the processes at once: work that is
    to outlive it writes its result itself. PartialError where a process was killed.
    """
    todo = list(items)
    if jobs <= 1 or len(todo) <= 1:
        return run_jobs(work, todo, done=done)
    with _one_blas_thread():
        return _pooled("spawn", work, todo, jobs, done)


def run_forked(work: Callable[[T], R], items: Iterable[T], *, jobs: int = 1,
               done: Callable[[int, int], None] | None = None) -> list[R]:
    """The same in processes that inherit all there is, so that only results have to be picklable; begun in a moment.

    Where processes cannot be forked, or a result cannot be sent, `portable` says so beforehand: use threads there.
    """
    todo = list(items)
    if jobs <= 1 or len(todo) <= 1 or "fork" not in multiprocessing.get_all_start_methods():
        return run_jobs(work, todo, jobs=jobs, done=done)
    with threadpool_limits(limits=1, user_api="blas"):
        _inherited.append((work, todo))
        try:
            return _pooled("fork", _nth, range(len(todo)), jobs, done)
        finally:
            _inherited.pop()


_inherited: list[tuple[Callable[[Any], Any], list[Any]]] = []   # what forked processes find: the work and its items


def _nth(i: int) -> Any:
    work, items = _inherited[-1]
    return work(items[i])


def portable(*things: object) -> bool:
    """Can these be sent from one process to another? Classes defined inside a function cannot."""
    try:
        pickle.dumps(things)
    except (pickle.PicklingError, AttributeError, TypeError):
        return False
    return True


def _pooled(method: str, work: Callable[[T], R], todo: Sequence[T], jobs: int,
            done: Callable[[int, int], None] | None) -> list[R]:
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(min(jobs, len(todo)), multiprocessing.get_context(method), _leave_interrupts)
    try:
        futures = [pool.submit(work, item) for item in todo]
        for finished, future in enumerate(as_completed(futures), start=1):
            future.result()
            if done is not None:
                done(finished, len(todo))
        return [future.result() for future in futures]
    except BaseException as error:
        for child in multiprocessing.active_children():
            if child not in others:
                child.terminate()
        if isinstance(error, BrokenProcessPool):
            raise PartialError("a process was killed, perhaps for want of memory",
                               "what was finished is kept; run it again with fewer --jobs") from error
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_interrupts() -> None:
    """Ctrl-C reaches every process of a terminal; the one that started the others decides."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _one_blas_thread() -> Iterator[None]:
    """The environment in which processes are started; libraries read it when they are loaded."""
    names = [f"{library}_NUM_THREADS" for library in ("OPENBLAS", "OMP", "MKL")]
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
