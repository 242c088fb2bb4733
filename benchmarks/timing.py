"""Time of calls in this process."""

from __future__ import annotations

import resource
import statistics
from collections.abc import Callable


def cpu(call: Callable[[], object], repeats: int = 7, *, warm: bool = True) -> float:
    """Median CPU seconds of a call, its child processes included; warm: after one that is not
    counted."""

    def used() -> float:
        return sum(
            r.ru_utime + r.ru_stime
            for r in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        )

    if warm:
        call()
    taken = []
    for _ in range(repeats):
        begun = used()
        call()
        taken.append(used() - begun)
    return statistics.median(taken)
