"""Estimated memory of a diagnosis, before it starts.

What grows with the recordings are Jacobians: for every sample and channel a derivative by every
parameter and state. A fit holds a few of them at a time, and each worker process a further array.
The factors are measured with `benchmarks/memory.py` and `benchmarks/scale.py --diagnose`.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from pamid.base.errors import DataError
from pamid.base.files import size_words
from pamid.model.assembly import Assembly
from pamid.simulation.data_split import DataSplit

PROMISED = 2_000_000_000  # bytes that the examples of README and tutorials stay below
PROGRAM = 350_000_000  # bytes of Python, its packages and compiled models, of all processes
TABLES = 10  # as large as all that was recorded, held at a time
JACOBIANS, PER_WORKER = 2.7, 1.0  # held at a time
EFFECT_COLUMNS = 8  # parameters and states that an effect and its tolerances add
FLOAT64 = 8  # bytes
_GROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_needed(evidence: DataSplit, jobs: int) -> int:
    """Estimated bytes that all processes of a diagnosis take together."""
    model = Assembly(evidence.rig)
    samples = sum(span.stop - span.start for span in (*evidence.fit, *evidence.held_out))
    columns = len(model.parameters) + len(evidence.rig.states) + EFFECT_COLUMNS
    jacobian = samples * len(evidence.channels) * columns * FLOAT64
    workers = jobs if jobs > 1 else 0
    recorded = sum(len(r) for r in evidence.recordings) * len(evidence.channels) * FLOAT64
    return PROGRAM + TABLES * recorded + round(jacobian * (JACOBIANS + PER_WORKER * workers))


def machine_memory() -> int | None:
    """Bytes that this machine has, or its control group allows; None where neither is readable."""
    known = []
    with contextlib.suppress(AttributeError, ValueError, OSError):
        known.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for path in _GROUP_LIMITS:
        with contextlib.suppress(OSError, ValueError):  # no such group, or "max"
            known.append(int(Path(path).read_text()))
    return min(known, default=None)


def memory_warning(evidence: DataSplit, jobs: int) -> str:
    """A sentence where a diagnosis takes more than `PROMISED`, else "".

    DataError where it takes more than the machine has.
    """
    needed, has = memory_needed(evidence, jobs), machine_memory()
    if needed <= PROMISED:
        return ""
    samples = sum(len(recording) for recording in evidence.recordings)
    estimate = f"{samples} samples will take about {size_words(needed)} of memory"
    cure = "Use shorter recordings, or ingest the logs with a longer period_s"
    if has is not None and needed > has:
        fewer = " or fewer --jobs" if jobs > 1 and memory_needed(evidence, 1) <= has else ""
        raise DataError(
            f"{estimate}; this machine has {size_words(has)}.", f"{cure}{fewer}.", code="memory"
        )
    return f"{estimate}. {cure} if that is too much."
