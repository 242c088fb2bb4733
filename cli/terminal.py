"""Output to the terminal. Control characters in names from files are made visible, and a closed
stream is not an error."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, TextIO

import click

from pamid.base.printable_text import printable

if TYPE_CHECKING:
    from pamid.base.progress import ProgressLine
    from pamid.base.work_stages import WorkStage


def say(text: str) -> None:
    """Print to stdout; OSError if that is closed or full."""
    if sys.stdout is None:
        raise OSError(errno.EBADF, "standard output is closed")
    click.echo(text)
    sys.stdout.flush()


def aside(text: str) -> None:
    """Print to stderr, in addition to the result; a closed stderr is ignored."""
    with contextlib.suppress(OSError):
        click.echo(printable(text), err=True)


def warning(text: str) -> None:
    """Print a warning to stderr, in addition to the result."""
    aside(f"Warning: {text}")


def failed_text(content: dict[str, Any]) -> list[str]:
    """One line per failed job."""
    return [f"Failed    {f['job']}: {f['why']}" for f in content.get("failed_jobs", ())]


def progress_line(
    label: str, total: int | None = None, *, stages: tuple[WorkStage, ...] | None = None
) -> ProgressLine:
    """Progress on stderr, also in log files; see `pamid.base.progress.ProgressLine`."""
    from pamid.base.progress import ProgressLine

    return ProgressLine(label, total, in_logs=True, stages=stages)


@contextlib.contextmanager
def staged_progress(
    label: str, *, stages: tuple[WorkStage, ...] | None = None
) -> Iterator[ProgressLine]:
    """Progress line of work that reports its stages itself; see `pamid.base.progress.tell`."""
    from pamid.base.progress import listening

    with progress_line(label, stages=stages) as line, listening(line.say):
        yield line


def hang_up(stream: TextIO | None = None) -> None:
    """Redirect a closed or full stream (default: stdout) to the null device.

    Python would otherwise fail at exit, when it flushes the stream.
    """
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), (stream or sys.stdout).fileno())
