"""Errors a user can act on: what is wrong, where, and how to correct it.

Every error raised on purpose is a `PamidError`. The command line prints it as a line and a hint
(or as a JSON object), and leaves with its exit code. Anything else that escapes is a fault of
pamid itself.
"""

from __future__ import annotations

import difflib
import os
import shlex
from collections.abc import Iterable
from typing import ClassVar

ERROR_SCHEMA = "pamid.error/1"


class PamidError(Exception):
    """Something the user can correct. `message` states what and where, `hint` how; `code` is a
    stable word for scripts."""

    default_code: ClassVar[str] = "error"
    default_exit_code: ClassVar[int] = 1

    def __init__(
        self, message: str, hint: str = "", *, code: str = "", exit_code: int | None = None
    ) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.code = code or self.default_code
        self.exit_code = self.default_exit_code if exit_code is None else exit_code

    def __str__(self) -> str:
        if not self.hint:
            return self.message
        return (
            f"{self.message}{'' if self.message.endswith(('.', '!', '?', ':')) else '.'} "
            f"{self.hint}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        # the default would lose the keyword arguments on the way back from a worker process
        return (_rebuild, (type(self), self.message, self.hint, self.code, self.exit_code))

    def as_dict(self) -> dict[str, str]:
        """The JSON object of a failed command."""
        return {
            "schema": ERROR_SCHEMA,
            "code": self.code,
            "message": self.message,
            "hint": self.hint,
        }


class UsageError(PamidError):
    """The command was called wrongly."""

    default_code, default_exit_code = "usage", 2


class FileError(PamidError):
    """A file, mapping, rig or effect is wrong or missing."""

    default_code, default_exit_code = "file", 3


class DataError(PamidError):
    """The data cannot answer the question: too short, or not excited."""

    default_code, default_exit_code = "data", 4


class ConvergenceError(PamidError):
    """A fit or training did not converge and nothing usable came of it."""

    default_code, default_exit_code = "convergence", 5


def quoted(word: str | os.PathLike[str]) -> str:
    """A path or a name as it stands in a command that is to be copied into a shell: whatever it
    holds, it is a single word, in a single line, and no option. What cannot be seen is written out
    ($'...', as bash, zsh and ksh read it)."""
    text = os.fspath(word)
    text = f"./{text}" if text.startswith("-") else text
    if all(c == " " or c.isprintable() for c in text):
        return shlex.quote(text)
    seen = {"'": "\\'", "\\": "\\\\", "\n": "\\n", "\t": "\\t"}
    return (
        "$'"
        + "".join(
            seen.get(c)
            or (c if c.isprintable() else "".join(f"\\x{b:02x}" for b in os.fsencode(c)))
            for c in text
        )
        + "'"
    )


def _rebuild(
    kind: type[PamidError], message: str, hint: str, code: str, exit_code: int
) -> PamidError:
    error = kind.__new__(kind)  # a subclass may have a separate __init__
    PamidError.__init__(error, message, hint, code=code, exit_code=exit_code)
    return error


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names parted by commas; of many the first ones and how many more there are."""
    every = list(names)
    shown = ", ".join(every[:most])
    return f"{shown} and {len(every) - most} more" if len(every) > most else shown


def join_words(words: Iterable[str], last: str = "and") -> str:
    """ "a, b and c"."""
    every = list(words)
    return f" {last} ".join(filter(None, (", ".join(every[:-1]), *every[-1:])))


def nearest(name: str, names: Iterable[str]) -> str:
    """A sentence offering the valid name closest to `name`, or "" when none is close, or it is
    valid itself."""
    by_folded = {candidate.casefold(): candidate for candidate in names}
    if name in by_folded.values():
        return ""
    close = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return f"Did you mean {by_folded[close[0]]!r}?" if close else ""
