"""Long work reports how far it is: a callback that takes a line of text; and where a person looks,
a line that updates itself, in a terminal and in a notebook."""

from __future__ import annotations

import contextlib
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal, Protocol, TextIO, TypeAlias, runtime_checkable

from pamid.base.work_stages import WORK_STAGES, WorkStage

Progress: TypeAlias = Callable[[str], None]


def silent(text: str) -> None:
    """The callback of those who do not want to know."""


_LISTENER: ContextVar[Progress] = ContextVar("pamid_progress", default=silent)


def tell(text: str) -> None:
    """Report the current stage, from any depth of a command; without a listener, as in worker
    threads, nothing happens."""
    _LISTENER.get()(text)


@contextmanager
def listening(progress: Progress) -> Iterator[None]:
    """`progress` receives the reports within."""
    before = _LISTENER.set(progress)
    try:
        yield
    finally:
        _LISTENER.reset(before)


class Settled(str):
    """A line of progress that stays: a result that is final while the rest of the work goes on."""


@runtime_checkable
class CountedProgress(Protocol):
    """Takes how many steps are done, next to the text: it may state how long the rest will take."""

    def update(self, done: int, text: str) -> object: ...


#: None: a line that updates itself; False: nothing; else a function that takes a line of text, or
#: what counts steps
ShowProgress: TypeAlias = Progress | CountedProgress | Literal[False] | None

_LIVE_S = 0.1
_LOG_S = 15.0
_FIRST_S = 3.0  # a log gets its first line sooner than the next ones
_WIDTH = 100
_EARLY = 0.1  # share of the work before which no time left is printed: it would rest on nothing
_COUNTED = re.compile(r"(.+?) (\d+)/(\d+)")  # "screening 15/33: coulomb-friction"


@contextmanager
def progress_steps(
    wanted: ShowProgress, label: str, total: int | None = None
) -> Iterator[tuple[Progress, Callable[[int, str], object]]]:
    """A callback for lines of text, and a callback for steps: (how many of the total are done,
    text)."""
    if isinstance(wanted, CountedProgress):
        counted = wanted

        def say(text: str) -> None:
            counted.update(0, text)

        yield say, counted.update
    elif callable(wanted):
        show = wanted
        yield show, lambda done, text: show(f"{done}/{total} {text}")
    elif wanted is False:
        yield silent, lambda done, text: None
    else:
        with ProgressLine(label, total) as line:
            yield line.say, line.update


class ProgressLine:
    """`with ProgressLine("fitting", 12) as line: line.update(3, "coulomb-friction")`.

    On a terminal and in a notebook a line on stderr that updates itself and is wiped at the end;
    log files and pipes get a line after 3 s, then every 15 s, where `in_logs`, else nothing. Quick
    work reports nothing. Work whose stages are known (by default those of the label in
    `WORK_STAGES`) lists them once, and reports how much of the whole is done and about how long the
    rest takes; other stages that count (`screening 15/33: ...`) the same of themselves. A `Settled`
    text stays on a separate line.
    """

    def __init__(
        self,
        label: str,
        total: int | None = None,
        *,
        in_logs: bool = False,
        stream: TextIO | None = None,
        stages: tuple[WorkStage, ...] | None = None,
    ) -> None:
        self._label, self._total = label, total
        self._stream = stream if stream is not None else sys.stderr
        # a carriage return brings the line back in a terminal and in a notebook
        notebook = type(self._stream).__module__.startswith("ipykernel.")
        self._live = self._stream is not None and (self._stream.isatty() or notebook)
        self._silent = self._stream is None or not (self._live or in_logs)
        self._begun = self._shown = time.monotonic()
        self._length = 0
        # its name, what was done, and when it was first reported
        self._stage = ("", 0, self._begun)
        self._stages = WORK_STAGES.get(label, ()) if stages is None else stages
        self._listed = False
        self._settled: list[str] = []
        self._reached, self._share = 0, 0.0  # the stage, and how much of the whole is done
        self._again = False  # is it a stage that has come before?

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._live and self._length:
            self._write("\r" + " " * self._length + "\r")

    def say(self, text: str) -> None:
        """Say what is going on."""
        self.update(0, text)

    def update(self, done: int, text: str = "", total: int | None = None) -> None:
        """Say that `done` of the total are finished (total: where only now it is known); `text` is
        what is going on. The rest is taken to go as fast, and may not be needed."""
        self._total = self._total if total is None else total
        if self._silent:
            return
        now = time.monotonic()
        if isinstance(text, Settled):
            self._settled.append(text)
            self._say_what_stays(now - self._begun)
            return
        stage = self._counted(text, now)
        wait = _LIVE_S if self._live else _LOG_S if self._length else _FIRST_S
        if now - self._shown < wait:
            return
        self._shown = now
        self._say_what_stays(now - self._begun)
        count = f"{done}/{self._total} " if self._total is not None else "" if text else f"{done}"
        spent = now - self._begun
        if self._stages:
            count = f"{self._reached + 1} of {len(self._stages)}, "
            # how many rounds are still to come nobody knows before they are done
            if self._again:
                stage = f", a further round{stage}"
            else:  # if shares are as usual
                left = _time_left(spent, self._share)
                stage = f", {100 * self._share:.0f} %, about {left} left" if left else ""
        elif self._total and done > 0:
            stage = f", {100 * done // self._total} %"
            if left := _time_left(spent, done / self._total):
                stage += f", at most {left} left"
        message = f"{self._label}: {count}{text}".rstrip()[:_WIDTH]
        line = f"{_plain(message)} ({_time_text(spent)}{stage})"
        # blanks over the rest of the line before: notebooks do not know the terminal's codes
        self._write("\r" + line.ljust(self._length) if self._live else line + "\n")
        self._length = len(line)

    def _say_what_stays(self, spent: float) -> None:
        """The list of stages, once, and results that are final. Not of quick work: it ends before
        anybody has read them."""
        if spent < _FIRST_S:
            return
        lines = []
        if self._stages and not self._listed:
            self._listed = True
            titles = ", ".join(stage.title for stage in self._stages)
            lines.append(f"{self._label}: {len(self._stages)} stages: {titles}")
        lines += [f"{self._label}: {_plain(text)}" for text in self._settled]
        self._settled = []
        for line in lines:
            self._write(("\r" + line.ljust(self._length) if self._live else line) + "\n")

    def _counted(self, text: str, now: float) -> str:
        """Note the stage of the text, and how much of the whole is done. Return how much of a stage
        that counts is done, and what of it is left; else nothing."""
        match = _COUNTED.match(text)
        name, done, total = (match[1], int(match[2]), int(match[3])) if match else ("", 0, 0)
        part = min(1.0, done / total) if total else 0.0
        at = next((k for k, s in enumerate(self._stages) if text.startswith(s.begins)), None)
        if at is not None:
            self._again = at < self._reached
            self._reached = max(self._reached, at)
            # never less than before, as some stages come again
            earlier = sum(stage.share for stage in self._stages[:at])
            self._share = max(self._share, earlier + part * self._stages[at].share)
        if not total:
            return ""
        if name != self._stage[0] or done < self._stage[1]:
            self._stage = (name, done, now)
        _, before, since = self._stage
        share = f", {100 * done // total} % of this stage"
        # of what was to do when the stage was first seen
        left = _time_left(now - since, (done - before) / max(1, total - before))
        return f"{share}, about {left} of it left" if left and done < total else share

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # a closed or full stderr stops no work
            if self._stream is not None:
                self._stream.write(text)
                self._stream.flush()


def _plain(text: str) -> str:
    """Nothing that a terminal obeys."""
    return "".join(c if c.isprintable() else " " for c in text)


def _time_left(spent: float, share: float) -> str:
    """Time for the rest at the pace so far; "" in the first tenth, whose pace is no estimate, and
    at the end."""
    return _time_text(spent * (1.0 - share) / share) if _EARLY <= share < 1.0 else ""


def _time_text(seconds: float) -> str:
    """ "40 s", "7 min", "2 h 5 min"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
