"""Memory budget for reading a raw log.

A file of a few kilobytes can declare more values than fit into memory. Every reader therefore
charges the declared size before it allocates: bytes until the log is closed, and temporary bytes.

The limit travels in the environment, because most readers run in a child process.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pamid.base.errors import FileError, UsageError
from pamid.base.files import GIB, LOG_MEMORY, size_words

#: limit in GiB; also the variable of `pamid ingest --memory-limit`
LIMIT_VARIABLE = "PAMID_INGEST_MEMORY_LIMIT"
FLOAT = 8  # bytes of a float64: every channel becomes float64


class MemoryBudget:
    """Memory for the log at `path`, in bytes."""

    def __init__(self, path: Path) -> None:
        self.path, self.limit, self.used = path, memory_limit(), 0

    def charge(self, name: str, values: int, *, raw: int = 0) -> None:
        """Reserve float64 for `values` numbers of `name`, and `raw` temporary bytes.

        raw: of the values in the file's format. FileError if the reserved sum exceeds the limit.
        """
        needed = self.used + FLOAT * values + raw
        if needed > self.limit:
            raise FileError(
                f"{self.path} is too large: up to {name!r} it needs {size_words(needed)} of "
                f"memory; the limit for a log is {size_words(self.limit)}.",
                "Check the file. Export fewer channels or a shorter part of it, or allow more: "
                f"--memory-limit {math.ceil(needed / GIB)} (GiB; memory_limit in Python).",
                code="too-large",
            )
        self.used += FLOAT * values


def memory_limit() -> int:
    """Limit of this process, bytes."""
    text = os.environ.get(LIMIT_VARIABLE)
    if not text:
        return LOG_MEMORY
    try:
        return _checked(float(text))
    except ValueError:
        message = f"{LIMIT_VARIABLE}={text!r} is not a number of GiB."
        raise UsageError(message, "Write a number, for example 4.") from None


@contextmanager
def limited_memory(gib: float | None) -> Iterator[None]:
    """Use another limit, in this process and its children; None changes nothing."""
    if gib is None:
        yield
        return
    _checked(gib)
    before = os.environ.get(LIMIT_VARIABLE)
    os.environ[LIMIT_VARIABLE] = repr(float(gib))
    try:
        yield
    finally:
        if before is None:
            del os.environ[LIMIT_VARIABLE]
        else:
            os.environ[LIMIT_VARIABLE] = before


def _checked(gib: float) -> int:
    if not (math.isfinite(gib) and gib > 0.0):
        raise UsageError(
            f"A memory limit of {gib:g} GiB is not possible.", "Give a positive number of GiB."
        )
    return int(gib * GIB)
