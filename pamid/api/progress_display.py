"""Progress where a person looks: one line that updates itself, in a terminal and in a notebook."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal, Protocol, TextIO, TypeAlias, runtime_checkable

from pamid.base.progress import Progress, silent


@runtime_checkable
class CountedProgress(Protocol):
    """Takes how many steps are done, beside the text: it may say how long the rest will take."""

    def update(self, done: int, text: str) -> object: ...


#: None: a line that updates itself; False: nothing; else a function that takes a line of text, or
#: what counts steps
ShowProgress: TypeAlias = Progress | CountedProgress | Literal[False] | None

_EVERY_S = 0.1
_WIDTH = 100


@contextmanager
def progress_line(wanted: ShowProgress, label: str) -> Iterator[Progress]:
    """A callback for lines of text. Nothing is shown in log files and pipes, nor of quick work; at
    the end the line is wiped."""
    if isinstance(wanted, CountedProgress):
        counted = wanted

        def text_only(text: str) -> None:
            counted.update(0, text)

        yield text_only
        return
    if callable(wanted):
        yield wanted
        return
    stream = sys.stderr
    if wanted is False or stream is None or not _updates(stream):
        yield silent
        return
    line = _Line(stream, label)
    try:
        yield line.show
    finally:
        line.wipe()


@contextmanager
def progress_steps(
    wanted: ShowProgress, label: str, total: int
) -> Iterator[tuple[Progress, Callable[[int, str], object]]]:
    """The same, and beside it a callback for steps of a known number: (how many are done, text)."""
    with progress_line(wanted, label) as show:
        if isinstance(wanted, CountedProgress):
            yield show, wanted.update
        else:
            yield show, lambda done, text: show(f"{done}/{total} {text}")


class _Line:
    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label = stream, label
        self._begun = self._shown = time.monotonic()
        self._length = 0

    def show(self, text: str) -> None:
        now = time.monotonic()
        if now - self._shown < _EVERY_S:
            return
        self._shown = now
        plain = "".join(c if c.isprintable() else " " for c in f"{self._label}: {text}")[:_WIDTH]
        self._write(f"{plain} ({now - self._begun:.0f} s)")

    def wipe(self) -> None:
        if self._length:
            self._write("")
            with contextlib.suppress(OSError):
                self._stream.write("\r")

    def _write(self, line: str) -> None:
        # blanks over the rest of the line before: notebooks do not know the terminal's codes
        with contextlib.suppress(OSError):
            self._stream.write("\r" + line.ljust(self._length))
            self._stream.flush()
        self._length = len(line)


def _updates(stream: TextIO) -> bool:
    """Does a carriage return bring its line back: a terminal's, or a notebook's?"""
    return stream.isatty() or type(stream).__module__.startswith("ipykernel.")
