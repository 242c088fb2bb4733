"""Cards: what a notebook shows of an object. Plain HTML without script; every text is escaped,
because names come out of other people's files."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TypeAlias

#: header and rows of a table
Cells: TypeAlias = tuple[Sequence[str], Sequence[Sequence[str]]]

_LONGEST_TEXT = 300  # letters of a text
_STYLE = (
    "border:1px solid rgba(128,128,128,.4);border-radius:6px;padding:.6em .9em;"
    "display:inline-block;max-width:60em;text-align:left"
)


def card(title: str, *parts: str) -> str:
    """A framed card: a title, then parts that are HTML already (`paragraph`, `html_table`)."""
    head = f'<div style="font-weight:600;margin-bottom:.3em">{escaped(title)}</div>'
    return f'<div style="{_STYLE}">{head}{"".join(parts)}</div>'


def paragraph(text: str) -> str:
    return f'<div style="margin:.3em 0">{escaped(text)}</div>' if text else ""


def html_table(cells: Cells) -> str:
    """A table of texts; "" where there are no rows. The first column is aligned left."""
    header, rows = cells
    lines = [_row("th", header), *(_row("td", row) for row in rows)]
    return f'<table style="margin:.3em 0">{"".join(lines)}</table>' if len(lines) > 1 else ""


def text_table(cells: Cells) -> str:
    """The same table as lines of plain text, columns aligned."""
    header, rows = cells
    shown = [[_plain(cell) for cell in row] for row in (header, *rows)]
    wide = [max(map(len, column)) for column in zip(*shown, strict=True)]
    return "\n".join(
        "  ".join(
            f"{cell:<{width}}" if i == 0 else f"{cell:>{width}}"
            for i, (cell, width) in enumerate(zip(row, wide, strict=True))
        ).rstrip()
        for row in shown
    )


def escaped(text: str) -> str:
    """A text as HTML shows it, letter by letter; control characters and half characters go."""
    return html.escape(_plain(text), quote=True)


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}g}"


def interval(low: float | None, high: float | None) -> str:
    """An interval, a dash where an end of it is not known."""
    return "–" if low is None or high is None else f"{low:.4g} .. {high:.4g}"


def _row(tag: str, cells: Sequence[str]) -> str:
    shown = "".join(
        f'<{tag} style="text-align:{"right" if i else "left"}">{escaped(cell)}</{tag}>'
        for i, cell in enumerate(cells)
    )
    return f"<tr>{shown}</tr>"


def _plain(text: str) -> str:
    shown = "".join(letter if letter.isprintable() else "\ufffd" for letter in text)
    return shown if len(shown) <= _LONGEST_TEXT else f"{shown[: _LONGEST_TEXT - 1]}…"
