"""Memory budget of reading one raw log.

A file of a few kilobytes can declare more values than a machine can hold. Every reader therefore
charges what the file declares before it allocates: bytes that stay until the log is closed, and
bytes that are needed only for a moment.

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
FLOAT = 8  # bytes of a float64: every channel becomes one


class MemoryBudget:
    """Bytes that the log at `path` may take in memory."""

    def __init__(self, path: Path, limit: int | None = None) -> None:
        self.path = path
        self.limit = memory_limit() if limit is None else limit
        self.used = 0

    def charge(self, name: str, values: int, *, raw: int = 0) -> None:
        """Reserve float64 for `values` numbers of `name`, and `raw` bytes for a moment.

        raw     bytes of the values as the file holds them, freed once they are converted

        FileError if the sum of everything reserved exceeds the limit.
        """
        self.charge_bytes(name, FLOAT * values, raw=raw)

    def charge_bytes(self, name: str, size: int, *, raw: int = 0) -> None:
        """Reserve `size` bytes for good and `raw` more for a moment; errors as `charge`."""
        needed = self.used + size + raw
        if needed > self.limit:
            raise FileError(
                f"{self.path} is too large: up to {name!r} it needs {size_words(needed)} of "
                f"memory; the limit for one log is {size_words(self.limit)}.",
                "Is it the file you meant? Export fewer channels or a shorter stretch of it, or "
                f"allow more: --memory-limit {math.ceil(needed / GIB)} (GiB; memory_limit in "
                "Python).",
                code="too-large",
            )
        self.used += size


def memory_limit() -> int:
    """The limit in bytes that holds in this process."""
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
    """Read logs with another limit, here and in child processes; None leaves it as it is."""
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
            f"A memory limit of {gib:g} GiB cannot be kept.", "Give a positive number of GiB."
        )
    return int(gib * GIB)
