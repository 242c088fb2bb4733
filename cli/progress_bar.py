"""Progress on stderr: a line that updates itself on a terminal, otherwise one line every 15 s (for
log files)."""

from __future__ import annotations

import contextlib
import sys
import time
from types import TracebackType
from typing import TextIO

from .terminal import printable

_TERMINAL_S = 0.1
_LOG_S = 15.0
_WIDTH = 100


class ProgressBar:
    """`with ProgressBar("fitting", 12) as progress: progress.update(3, "coulomb-friction")`. Quick
    work says nothing."""

    def __init__(
        self, label: str, total: int | None = None, *, stream: TextIO | None = None
    ) -> None:
        self._label = label
        self._total = total
        self._stream = stream if stream is not None else sys.stderr
        self._live = self._stream is not None and self._stream.isatty()
        self._begun = self._told = time.monotonic()
        self._shown = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live and self._shown:
            self._write("\r\x1b[K")

    def update(self, done: int, text: str = "") -> None:
        """Say that `done` of the total are finished; `text` is what is going on. The rest is taken
        to go as fast, and may not be needed."""
        now = time.monotonic()
        if now - self._told < (_TERMINAL_S if self._live else _LOG_S):
            return
        self._told, self._shown = now, True
        count = f"{done}/{self._total} " if self._total is not None else "" if text else f"{done}"
        spent = now - self._begun
        left = (
            f", at most {spent * (self._total - done) / done:.0f} s left"
            if self._total and done > 0
            else ""
        )
        line_start = printable(f"{self._label}: {count}{text}".rstrip().replace("\n", " "))[:_WIDTH]
        line = f"{line_start} ({spent:.0f} s{left})"
        self._write(f"\r{line}\x1b[K" if self._live else line + "\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # a closed or full stderr stops no work
            if self._stream is not None:
                self._stream.write(text)
                self._stream.flush()
