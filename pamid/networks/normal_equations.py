"""Normal equations from rows of a Jacobian that come in chunks, the end of every network's pass."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.networks.root_sums import RootSums

Array = NDArray[np.float64]
Rows = tuple[int, Array, Array]  # first sample, output (n,), its derivative (n, n_weights)

# samples whose Jacobian rows a network holds at once: 0.8 MB at 95 weights, 1.4 MB at 171, so that
# they stay inside a processor's second-level cache while they are summed
CHUNK = 1024
# bytes in a line of the cache: vectors that straddle two of them load at half speed
_CACHE_LINE = 64


def aligned(*shape: int) -> Array:
    """Zeros (C order) that begin at a cache line."""
    # numpy may align to 16 bytes only.
    raw = np.zeros(int(np.prod(shape)) + _CACHE_LINE // 8)
    skip = (-raw.ctypes.data % _CACHE_LINE) // 8
    return raw[skip : skip + int(np.prod(shape))].reshape(shape)


def add_up(
    sums: RootSums, chunks: Iterator[Rows], target: Array, washout: int = 0, threads: int = 1
) -> None:
    """Add e = target - y and J over samples `washout` .. N-1 to the sums.

    Chunks are added in their order whatever `threads` is: with two, the next one is made while this
    one is added. Its maker must leave the chunk before untouched.
    """
    with np.errstate(all="ignore"):
        for start, y, jacobian in _computed_ahead(chunks) if threads > 1 else chunks:
            skip = min(max(washout - start, 0), len(y))
            sums.add(jacobian[skip:], target[start + skip : start + len(y)] - y[skip:])


def side_by_side(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Results in the order of the items, with one thread for each where there are several.

    A plain pool, since it is part of every step: jobs.run_jobs first settles the threads of BLAS,
    which takes milliseconds.
    """
    if len(items) < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(len(items)) as pool:
        return list(pool.map(work, items))


def _computed_ahead(chunks: Iterator[Rows]) -> Iterator[Rows]:
    """The same chunks, each computed while the one before is in use."""
    # One chunk ahead is enough to keep both threads busy, and two buffers hold it.
    with ThreadPoolExecutor(1) as maker:
        coming = maker.submit(next, chunks, None)
        while (chunk := coming.result()) is not None:
            coming = maker.submit(next, chunks, None)
            yield chunk
