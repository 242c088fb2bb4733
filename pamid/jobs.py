"""Independent jobs on this machine's cores: pure functions, results in the order of the jobs.

The compiled sweeps release Python's lock, so threads share the work without copying recordings. BLAS is held to one
thread per job: the matrices are small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import threadpool_limits

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
