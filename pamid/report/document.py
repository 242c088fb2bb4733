"""Content of a report without its layout: headings, paragraphs, tables and pictures in order.
web_page.py makes the page of it.

Text in backticks is shown as code; every text may come from files, so whoever shows it escapes it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from markupsafe import Markup

from pamid.report.style import Picture

_LISTED = 3  # lowest level of the headings in the table of contents
_ID_WORDS = 6  # of a heading in its id


@dataclass(frozen=True)
class Heading:
    """A heading of level 2 to 4; question: the question of an answer, shown above it."""

    kind: ClassVar[str] = "heading"
    text: str
    level: int = 2
    question: str = ""


@dataclass(frozen=True)
class Paragraphs:
    """style: "", "note" or "warning"."""

    kind: ClassVar[str] = "paragraphs"
    texts: tuple[str, ...]
    style: str = ""


@dataclass(frozen=True)
class Bullets:
    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]


@dataclass(frozen=True)
class TableCell:
    """style: "", "code" or "strong"; small: a second line in small print; place: of the page, to
    which the text leads."""

    text: str
    style: str = ""
    small: str = ""
    place: str = ""


@dataclass(frozen=True)
class Table:
    """numeric: columns that are aligned right; fixed: column widths that the page's style sets."""

    kind: ClassVar[str] = "table"
    head: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]
    numeric: frozenset[int] = frozenset()
    fixed: bool = False

    def repeats_above(self, row: int, column: int) -> bool:
        """Whether this cell, with all cells to its left, repeats the row above."""
        return (
            row > 0
            and column not in self.numeric
            and self.rows[row][: column + 1] == self.rows[row - 1][: column + 1]
        )


@dataclass(frozen=True)
class FigureBlock:
    kind: ClassVar[str] = "figure"
    picture: Picture


@dataclass(frozen=True)
class Image:
    """A PNG in the run folder."""

    kind: ClassVar[str] = "image"
    name: str
    title: str
    png: bytes
    width_px: int
    height_px: int


@dataclass(frozen=True)
class Equation:
    """An equation in MathML (math), or as plain text (code) if it is too long."""

    kind: ClassVar[str] = "equation"
    title: str
    math: tuple[Markup, ...] = ()
    code: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Details:
    """Content that is folded until the reader opens it; on paper it is open."""

    kind: ClassVar[str] = "details"
    summary: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Interactive:
    """Content that needs scripts; not on paper. title, place: of its heading, for the table of
    contents."""

    kind: ClassVar[str] = "interactive"
    markup: Markup
    title: str = ""
    place: str = ""


@dataclass(frozen=True)
class Section:
    """style: "", "answer" for one of the answers that lead a report, "answers" for them all."""

    kind: ClassVar[str] = "section"
    blocks: tuple[Block, ...]
    style: str = ""


Block = (
    Heading
    | Paragraphs
    | Bullets
    | Table
    | FigureBlock
    | Image
    | Equation
    | Details
    | Interactive
    | Section
)


@dataclass(frozen=True)
class AnswerCard:
    """A short answer at the top of the page. lead: the answer; lines: details; place: linked
    heading; quiet: there is no finding."""

    question: str
    lead: str
    lines: tuple[str, ...] = ()
    place: str = ""
    quiet: bool = False


@dataclass(frozen=True)
class Document:
    """A page. title: of the browser's tab; cards: the short answers; todo: the next step in one
    line; scripts, styles: of pamid, for the interactive blocks."""

    title: str
    subtitle: str
    headline: str
    preface: Paragraphs
    blocks: tuple[Block, ...]
    scripts: tuple[str, ...] = ()
    styles: str = ""
    cards: tuple[AnswerCard, ...] = ()
    todo: str = ""

    @property
    def contents(self) -> tuple[tuple[int, str, str], ...]:
        """(level, text, place) of every heading of level 2 and 3, in their order."""
        return tuple(
            (2, block.title, block.place)
            if isinstance(block, Interactive)
            else (block.level, block.question or block.text, place_of(block))
            for block in _listed(self.blocks)
        )


def place_of(heading: Heading) -> str:
    """Id of a heading: its question or text, in lower case with hyphens."""
    words = re.findall(r"[a-z0-9]+", (heading.question or heading.text).lower())
    return "-".join(words[:_ID_WORDS]) or "section"


def _listed(blocks: Iterable[Block]) -> Iterator[Heading | Interactive]:
    for block in blocks:
        if isinstance(block, Section):
            yield from _listed(block.blocks)
        elif (isinstance(block, Heading) and block.level <= _LISTED) or (
            isinstance(block, Interactive) and block.title
        ):
            yield block


def table(
    head: Iterable[str],
    rows: Iterable[Iterable[str | TableCell]],
    numeric: Iterable[int] = (),
    *,
    fixed: bool = False,
) -> Table:
    """A table whose cells may be given as plain texts."""
    cells = tuple(
        tuple(cell if isinstance(cell, TableCell) else TableCell(cell) for cell in row)
        for row in rows
    )
    return Table(tuple(head), cells, frozenset(numeric), fixed)


def notes(*texts: str) -> Paragraphs:
    """Remarks below a table or a picture."""
    return Paragraphs(texts, "note")


def figures(pictures: dict[str, Picture], names: Sequence[str]) -> tuple[FigureBlock, ...]:
    """The pictures of these names, as far as they were drawn."""
    return tuple(FigureBlock(pictures[name]) for name in names if name in pictures)
