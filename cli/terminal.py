"""Output to the terminal: control characters in names from files are shown, not executed; a closed
stream raises nothing."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, TextIO

import click

if TYPE_CHECKING:
    from pamid.base.progress import ProgressLine
    from pamid.base.work_stages import WorkStage


def say(text: str) -> None:
    """Print to stdout; OSError where that is closed or full."""
    if sys.stdout is None:
        raise OSError(errno.EBADF, "standard output is closed")
    click.echo(text)
    sys.stdout.flush()


def aside(text: str) -> None:
    """Print beside the result, to stderr: nothing is lost where nobody can read it."""
    from pamid.base.printable_text import printable

    with contextlib.suppress(OSError):
        click.echo(printable(text), err=True)


def warning(text: str) -> None:
    """Warn of an oddity that is no error, in addition to the result."""
    aside(f"Warning: {text}")


def progress_line(
    label: str, total: int | None = None, *, stages: tuple[WorkStage, ...] | None = None
) -> ProgressLine:
    """Progress on stderr, in log files, too; see `pamid.base.progress.ProgressLine`."""
    from pamid.base.progress import ProgressLine

    return ProgressLine(label, total, in_logs=True, stages=stages)


@contextlib.contextmanager
def told_progress(
    label: str, *, stages: tuple[WorkStage, ...] | None = None
) -> Iterator[ProgressLine]:
    """The same for work that tells of itself from its depth; see `pamid.base.progress.tell`."""
    from pamid.base.progress import listening

    with progress_line(label, stages=stages) as line, listening(line.say):
        yield line


def hang_up(stream: TextIO | None = None) -> None:
    """Let go of a stream (default: stdout) that nobody reads or that is full, so that the end of
    the process does not stumble over it."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), (stream or sys.stdout).fileno())


def quoted(word: str | os.PathLike[str]) -> str:
    """A path or a name as a command to be copied holds it; see `pamid.base.errors.quoted`."""
    from pamid.base.errors import quoted as found

    return found(word)
