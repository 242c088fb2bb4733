"""Long work says how far it is: a callback that takes one line of text."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str], None]


def silent(text: str) -> None:
    """The callback of those who do not want to know."""
