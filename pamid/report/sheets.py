"""Sheets of A4: text, tables and drawings one below the other, broken into pages, written as one
PDF."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, cast

from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font, LoadFlags
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from pamid.report.style import Drawing, colour, label, settings

WIDE_IN, TALL_IN, SIDE_IN, TOP_IN, FOOT_IN = 8.27, 11.69, 0.62, 0.55, 0.7
TEXT_IN = WIDE_IN - 2.0 * SIDE_IN
CREATOR = "pamid"
LINE = 1.38  # line height in font sizes
GAP_IN = 0.14  # between the columns of a table
_PIECES = re.compile(r"[^\s_-]*[_-]+\s*|[^\s_-]+\s*")  # what a line may be broken behind


@dataclass(frozen=True)
class Style:
    """size: points; before, after: in; indent: in, behind `mark`."""

    size: float
    bold: bool = False
    role: str = "ink"
    before: float = 0.0
    after: float = 0.06
    indent: float = 0.0
    mark: str = ""

    def scaled(self, factor: float) -> Style:
        return replace(
            self, size=factor * self.size, before=factor * self.before, after=factor * self.after
        )

    @property
    def line_in(self) -> float:
        return LINE * self.size / 72.0


@dataclass
class Page:
    """What stands where, in from the top left corner."""

    # x, baseline y, text, style, side
    texts: list[tuple[float, float, str, Style, str]] = field(default_factory=list)
    # x, to x, y, role
    rules: list[tuple[float, float, float, str]] = field(default_factory=list)
    drawings: list[tuple[float, float, Drawing]] = field(default_factory=list)  # top, height


class Sheets:
    """Pages that are filled from the top."""

    def __init__(self) -> None:
        self.pages: list[Page] = [Page()]
        self._y = TOP_IN

    @property
    def left_in(self) -> float:
        """What is left of this page."""
        return TALL_IN - FOOT_IN - self._y

    def turn(self) -> None:
        """A new page, unless this one is still empty."""
        if self._y > TOP_IN:
            self.pages.append(Page())
            self._y = TOP_IN

    def need(self, height: float) -> None:
        """A new page if so much does not fit on this one."""
        if height > self.left_in:
            self.turn()

    def text(self, text: str, style: Style) -> None:
        """A paragraph, wrapped; it goes on to the next page where it must."""
        lines = wrapped(text, style, TEXT_IN - style.indent)
        self.need(style.before + min(len(lines), 2) * style.line_in)
        self._y += style.before if self._y > TOP_IN else 0.0
        for k, line in enumerate(lines):
            self.need(style.line_in)
            self._y += style.line_in
            if style.mark and k == 0:
                self._put(SIDE_IN + 0.3 * style.indent, style.mark, style)
            self._put(SIDE_IN + style.indent, line, style)
        self._y += style.after

    def rule(self) -> None:
        """A thin line across."""
        self._y += 0.1
        self.pages[-1].rules.append((SIDE_IN, WIDE_IN - SIDE_IN, self._y, "line"))
        self._y += 0.02

    def draw(self, drawing: Drawing) -> None:
        height = min(drawing.height, TALL_IN - TOP_IN - FOOT_IN)
        self.need(height)
        self.pages[-1].drawings.append((self._y, height, drawing))
        self._y += height + 0.12

    def table(
        self, rows: Sequence[Sequence[str]], numeric: frozenset[int], head: Style, body: Style
    ) -> None:
        """The first row is the head; it stands again on every page that the table reaches."""
        widths = _widths(rows, head, body)
        for k, row in enumerate(rows):
            style = body if k else head
            cells = [
                [line for part in cell.split("\n") for line in wrapped(part, style, width)]
                for cell, width in zip(row, widths, strict=True)
            ]
            height = max(map(len, cells)) * style.line_in + 0.05
            if height > self.left_in:
                self.turn()
                if k:
                    self._row(
                        [
                            wrapped(cell, head, width)
                            for cell, width in zip(rows[0], widths, strict=True)
                        ],
                        widths,
                        numeric,
                        head,
                    )
            self._row(cells, widths, numeric, style)
        self._y += 0.1

    def _row(
        self, cells: list[list[str]], widths: list[float], numeric: frozenset[int], style: Style
    ) -> None:
        top, x = self._y, SIDE_IN
        for column, (lines, width) in enumerate(zip(cells, widths, strict=True)):
            for k, line in enumerate(lines):
                self._y = top + (k + 1) * style.line_in
                at = x + width if column in numeric else x
                self._put(at, line, style, "right" if column in numeric else "left")
            x += width + GAP_IN
        self._y = top + max(map(len, cells)) * style.line_in + 0.05
        self.pages[-1].rules.append(
            (SIDE_IN, SIDE_IN + sum(widths) + GAP_IN * (len(widths) - 1), self._y, "line")
        )

    def _put(self, x: float, text: str, style: Style, side: str = "left") -> None:
        self.pages[-1].texts.append((x, self._y - 0.25 * style.line_in, text, style, side))

    def pdf(self, title: str) -> bytes:
        """All pages with their numbers; the same content gives the same bytes."""
        buffer = io.BytesIO()
        with (
            settings(title),
            PdfPages(
                buffer,
                metadata={
                    "Title": title,
                    "CreationDate": None,
                    "Creator": CREATOR,
                    "Producer": None,
                },
            ) as file,
        ):
            for number, page in enumerate(self.pages, start=1):
                file.savefig(_figure(page, title, f"{number} of {len(self.pages)}"))
        return buffer.getvalue()


def wrapped(text: str, style: Style, width: float) -> list[str]:
    """Lines no wider than `width` [in]; a word that is wider itself is broken."""
    lines, line = [], ""
    for word in _broken(label(text, len(text) + 1), style, width):
        if line and width_of((line + word).rstrip(), style) > width:
            lines.append(line.rstrip())
            line = ""
        line += word
    return [*lines, line.rstrip()]


def _broken(text: str, style: Style, width: float) -> Iterator[str]:
    for word in _PIECES.findall(text):
        while width_of(word.rstrip(), style) > width and len(word) > 1:
            part = next(
                n
                for n in range(len(word) - 1, 0, -1)
                if n == 1 or width_of(word[:n], style) <= width
            )
            yield word[:part]
            word = word[part:]
        yield word


def width_of(text: str, style: Style) -> float:
    """Width of a line [in]."""
    return _points(text, style.bold) * style.size / 72.0


@lru_cache(maxsize=100_000)
def _points(text: str, bold: bool) -> float:
    """Width in font sizes."""
    font = _font(bold)
    font.set_text(text, 0.0, flags=LoadFlags.NO_HINTING)
    return float(font.get_width_height()[0]) / 64.0 / 100.0


@lru_cache(maxsize=2)
def _font(bold: bool) -> Any:
    font = FT2Font(
        findfont(FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal"))
    )
    font.set_size(100.0, 72.0)
    return font


def _widths(rows: Sequence[Sequence[str]], head: Style, body: Style) -> list[float]:
    """Columns as wide as their widest cell where there is room; else the widest give way."""
    natural = [
        max(
            width_of(label(part, len(part) + 1), style)
            for cell, style in _cells(rows, column, head, body)
            for part in cell.split("\n")
        )
        + 0.01
        for column in range(len(rows[0]))
    ]
    room = TEXT_IN - GAP_IN * (len(natural) - 1)
    if sum(natural) <= room:
        return natural
    limit = max(natural)
    for limit in sorted(natural, reverse=True):
        if sum(min(one, limit) for one in natural) <= room:
            break
    narrow = [one for one in natural if one <= limit]
    wide = len(natural) - len(narrow)
    share = (room - sum(narrow)) / wide if wide else room / len(natural)
    return [one if one <= limit and wide else min(one, share) for one in natural]


def _cells(
    rows: Sequence[Sequence[str]], column: int, head: Style, body: Style
) -> Iterator[tuple[str, Style]]:
    for k, row in enumerate(rows):
        yield row[column], body if k else head


def _figure(page: Page, title: str, number: str) -> Figure:
    figure = Figure(figsize=(WIDE_IN, TALL_IN), layout="constrained", facecolor=colour("paper"))
    FigureCanvasPdf(figure)
    if page.drawings:
        heights, y = [], 0.0
        for top, height, _ in page.drawings:
            heights += [top - y, height]
            y = top + height
        places = GridSpec(
            len(heights) + 1,
            3,
            figure=figure,
            height_ratios=[*heights, TALL_IN - y],
            width_ratios=[SIDE_IN, TEXT_IN, SIDE_IN],
        )
        for k, (_, _, drawing) in enumerate(page.drawings):
            drawing.draw(cast(Figure, figure.add_subfigure(places[2 * k + 1, 1])), False)
    for x, y, text, style, side in page.texts:
        figure.text(
            x / WIDE_IN,
            1.0 - y / TALL_IN,
            text,
            fontsize=style.size,
            color=colour(style.role),
            ha=side,
            fontweight="bold" if style.bold else "normal",
            va="baseline",
        )
    for x, to, y, role in page.rules:
        ends = [x / WIDE_IN, to / WIDE_IN], [1.0 - y / TALL_IN] * 2
        figure.add_artist(Line2D(*ends, color=colour(role), linewidth=0.6))
    foot = Style(7.5, role="muted")
    figure.text(
        SIDE_IN / WIDE_IN,
        0.4 / TALL_IN,
        wrapped(title, foot, TEXT_IN - 1.0)[0],
        fontsize=7.5,
        color=colour("muted"),
    )
    figure.text(
        1.0 - SIDE_IN / WIDE_IN,
        0.4 / TALL_IN,
        number,
        fontsize=7.5,
        color=colour("muted"),
        ha="right",
    )
    return figure
