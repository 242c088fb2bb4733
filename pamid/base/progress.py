"""Long work says how far it is: a callback that takes one line of text; and where a person looks, a
line that updates itself, in a terminal and in a notebook."""

from __future__ import annotations

import contextlib
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Literal, Protocol, TextIO, TypeAlias, runtime_checkable

Progress: TypeAlias = Callable[[str], None]


def silent(text: str) -> None:
    """The callback of those who do not want to know."""


@runtime_checkable
class CountedProgress(Protocol):
    """Takes how many steps are done, beside the text: it may say how long the rest will take."""

    def update(self, done: int, text: str) -> object: ...


#: None: a line that updates itself; False: nothing; else a function that takes a line of text, or
#: what counts steps
ShowProgress: TypeAlias = Progress | CountedProgress | Literal[False] | None

_LIVE_S = 0.1
_LOG_S = 15.0
_FIRST_S = 3.0  # a log gets its first line sooner than the next ones
_WIDTH = 100
_COUNTED = re.compile(r"(.+?) (\d+)/(\d+)")  # "screening 15/33: coulomb-friction"


@contextmanager
def progress_steps(
    wanted: ShowProgress, label: str, total: int | None = None
) -> Iterator[tuple[Progress, Callable[[int, str], object]]]:
    """A callback for lines of text, and one for steps: (how many of the total are done, text)."""
    if isinstance(wanted, CountedProgress):
        counted = wanted

        def say(text: str) -> None:
            counted.update(0, text)

        yield say, counted.update
    elif callable(wanted):
        told = wanted
        yield told, lambda done, text: told(f"{done}/{total} {text}")
    elif wanted is False:
        yield silent, lambda done, text: None
    else:
        with ProgressLine(label, total) as line:
            yield line.say, line.update


class ProgressLine:
    """`with ProgressLine("fitting", 12) as line: line.update(3, "coulomb-friction")`.

    On a terminal and in a notebook a line on stderr that updates itself and is wiped at the end;
    log files and pipes get a line after 3 s, then every 15 s, where `in_logs`, else nothing. Quick
    work says nothing. Stages that count (`screening 15/33: ...`) say how much of them is done, and
    how long the rest of them takes if it goes as fast.
    """

    def __init__(
        self,
        label: str,
        total: int | None = None,
        *,
        in_logs: bool = False,
        stream: TextIO | None = None,
    ) -> None:
        self._label, self._total = label, total
        self._stream = stream if stream is not None else sys.stderr
        self._live = self._stream is not None and _updates(self._stream)
        self._silent = self._stream is None or not (self._live or in_logs)
        self._begun = self._shown = time.monotonic()
        self._length = 0
        self._stage = ("", 0, self._begun)  # its name, what was done, and when it was first told

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live and self._length:
            self._write("\r" + " " * self._length + "\r")

    def say(self, text: str) -> None:
        """Say what is going on."""
        self.update(0, text)

    def update(self, done: int, text: str = "") -> None:
        """Say that `done` of the total are finished; `text` is what is going on. The rest is taken
        to go as fast, and may not be needed."""
        if self._silent:
            return
        now = time.monotonic()
        stage = self._counted(text, now)
        wait = _LIVE_S if self._live else _LOG_S if self._length else _FIRST_S
        if now - self._shown < wait:
            return
        self._shown = now
        count = f"{done}/{self._total} " if self._total is not None else "" if text else f"{done}"
        spent = now - self._begun
        left = (
            f", at most {spent * (self._total - done) / done:.0f} s left"
            if self._total and done > 0
            else stage
        )
        said = f"{self._label}: {count}{text}".rstrip()[:_WIDTH]
        plain = "".join(c if c.isprintable() else " " for c in said)
        line = f"{plain} ({spent:.0f} s{left})"
        # blanks over the rest of the line before: notebooks do not know the terminal's codes
        self._write("\r" + line.ljust(self._length) if self._live else line + "\n")
        self._length = len(line)

    def _counted(self, text: str, now: float) -> str:
        """How much of a stage that counts is done, and what of it is left; else nothing."""
        found = _COUNTED.match(text)
        if found is None or int(found[3]) == 0:
            return ""
        name, done, total = found[1], int(found[2]), int(found[3])
        if name != self._stage[0] or done < self._stage[1]:
            self._stage = (name, done, now)
        _, before, since = self._stage
        said = f", {100 * done // total} % of this stage"
        if done <= before or done >= total:
            return said
        return f"{said}, about {(now - since) * (total - done) / (done - before):.0f} s of it left"

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # a closed or full stderr stops no work
            if self._stream is not None:
                self._stream.write(text)
                self._stream.flush()


def _updates(stream: TextIO) -> bool:
    """Does a carriage return bring its line back: a terminal's, or a notebook's?"""
    return stream.isatty() or type(stream).__module__.startswith("ipykernel.")
