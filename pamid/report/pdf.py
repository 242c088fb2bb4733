"""A document as a PDF (fpdf2) on A4: the answers in words on the first page, then their pictures,
then the evidence."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from fpdf import FPDF, FontFace
from fpdf.enums import Align, TableBordersLayout, VAlign, WrapMode, XPos, YPos
from fpdf.fonts import TTFFont
from matplotlib.font_manager import FontProperties, findfont

from pamid.report.document import (
    Block,
    Bullets,
    Details,
    Document,
    Equation,
    FigureBlock,
    Heading,
    Image,
    Interactive,
    Paragraphs,
    Section,
    Table,
    TableCell,
)
from pamid.report.formatting import clean
from pamid.report.style import colour, label

CREATOR = "pamid"
_FONT = "DejaVu Sans"  # the figures are drawn in it, and it has Greek, superscripts and signs
SIDE_MM, TOP_MM, FOOT_MM = 16.0, 15.0, 18.0
TEXT_MM = 210.0 - 2.0 * SIDE_MM
_PICTURE_DPI = 160.0
_LINE_HEIGHT = 1.38  # line height in font sizes
_MM = 25.4 / 72.0  # one point
_CELL_MM = (0.7, 2.6)  # padding of cells, above and at the side
#: fpdf2 writes this moment as it is given, and stamps no other for it: the same document gives the
#: same bytes
_NO_MOMENT = datetime(1970, 1, 1, tzinfo=UTC)
_BREAKABLE = re.compile(r"(?<=[_/-])(?=\w)")  # a line may be broken behind these
_FONT_SIZE = re.compile(r"(font(?:-size)?:[^;\"]*?[\d.]+)px")
_SCALES = (1.0, 0.94, 0.88, 0.82)
_MANY = 9  # columns from which a table is set smaller


@dataclass(frozen=True)
class TextStyle:
    """size: points; before, after, indent: mm."""

    size: float
    bold: bool = False
    role: str = "ink"
    before: float = 0.0
    after: float = 1.5
    indent: float = 0.0


SUBTITLE = TextStyle(9.0, role="muted", after=0.8)
HEADLINE = TextStyle(16.0, bold=True, after=4.0)
QUESTION = TextStyle(7.5, bold=True, role="muted", before=2.5, after=0.5)
HEADINGS = {
    2: TextStyle(12.0, bold=True, before=1.5, after=1.8),
    3: TextStyle(10.5, bold=True, before=5.0, after=1.5),
    4: TextStyle(9.5, bold=True, before=3.0, after=1.3),
}
PARAGRAPHS = {
    "": TextStyle(8.8),
    "note": TextStyle(8.2, role="muted"),
    "warning": TextStyle(9.2, bold=True, role="with_cause"),
}
BULLET = TextStyle(8.8, indent=5.0, after=0.8)
CAPTION = TextStyle(9.5, bold=True, before=3.0, after=1.0)
SUMMARY = TextStyle(9.0, bold=True, before=2.5, after=1.3)
EQUATION = TextStyle(9.0, indent=5.0)


def pdf_of(document: Document) -> bytes:
    """The PDF of a document; the same document gives the same bytes. Where the document leads with
    answers, the first page holds them in words, set smaller if they would not fit."""
    for scale in _SCALES:
        pages = Pages(clean(document.headline), scale)
        try:
            if pages.lay_out(document) or scale == _SCALES[-1]:
                return bytes(pages.output())
        finally:
            pages.close_fonts()
    raise AssertionError("the last scale is always taken")


def _is_shown(block: Block) -> bool:
    return isinstance(block, FigureBlock | Image | Equation)


class Pages(FPDF):
    """Pages of A4 that are filled from the top. scale: of the text's sizes."""

    def __init__(self, title: str, scale: float = 1.0) -> None:
        super().__init__(unit="mm", format="A4")
        self.scale, self._footer = scale, title
        self.set_title(label(title, 400))
        self.set_creator(CREATOR)
        self.set_creation_date(_NO_MOMENT)
        for style, weight in (("", "normal"), ("B", "bold")):
            self.add_font(_FONT, style, findfont(FontProperties(family=_FONT, weight=weight)))
        self.set_font(_FONT)
        self.c_margin = 0.0  # of cells, beyond their padding
        self.set_margins(SIDE_MM, TOP_MM, SIDE_MM)
        self.set_auto_page_break(True, FOOT_MM)
        self.set_draw_color(colour("line"))
        self.set_line_width(0.2)
        self.add_page()

    def footer(self) -> None:
        """Page number and headline, on every page."""
        self.set_y(-11.0)
        self._font(TextStyle(7.5, role="muted"))
        self.cell(24.0, 4.0, f"{self.page_no()} of {{nb}}")
        headline = label(self._footer, 110)
        self.cell(TEXT_MM - 24.0, 4.0, headline, align=Align.R)

    def close_fonts(self) -> None:
        """fpdf2 leaves the files of its fonts open."""
        for font in self.fonts.values():
            if isinstance(font, TTFFont):
                font.close()

    def lay_out(self, document: Document) -> bool:
        """Set the document; False if the answers that lead it need more than the first page."""
        self.opening(document)
        blocks = [
            inner
            for one in document.blocks
            for inner in (
                one.blocks if isinstance(one, Section) and one.style == "answers" else (one,)
            )
        ]
        answers = [one for one in blocks if isinstance(one, Section) and one.style == "answer"]
        if blocks[:1] != answers[:1]:  # the report of a trial or a paper
            self.add_all(blocks)
            return True
        for one in answers:
            self.add_all(block for block in one.blocks if not _is_shown(block))
        fits = self.page == 1
        self.scale = 1.0
        self.add_page()
        for one in answers:
            shown = [block for block in one.blocks if _is_shown(block)]
            if shown:
                self.question(
                    next(block.question for block in one.blocks if isinstance(block, Heading)),
                    shown[0],
                )
                self.add_all(shown)
        self.add_all(one for one in blocks if one not in answers)
        return fits

    def opening(self, document: Document) -> None:
        """Subtitle, headline and what is said before the first section."""
        self.text_block(document.subtitle, SUBTITLE)
        self.text_block(document.headline, HEADLINE)
        self.add(document.preface)
        if document.todo:
            self.text_block(f"Do this next: {document.todo}", PARAGRAPHS[""])

    def add_all(self, blocks: Iterable[Block]) -> None:
        """Blocks one below the other; a heading never stands alone at the foot of a page."""
        listed = list(blocks)
        for block, following in zip(listed, [*listed[1:], None], strict=True):
            if isinstance(block, Heading):
                self.heading(block, following)
            else:
                self.add(block)

    def add(self, block: Block) -> None:
        """One block that is no heading; what only a page with scripts can show is left out."""
        match block:
            case Paragraphs():
                for text in filter(None, block.texts):
                    self.text_block(text, PARAGRAPHS[block.style])
            case Bullets():
                for text in block.items:
                    self.text_block(text, BULLET, mark="•")
            case Table():
                self.table_block(block)
            case FigureBlock():
                self.figure_block(block)
            case Image():
                self.image_block(block)
            case Equation():
                self._need(14.0)
                self.text_block(block.title, CAPTION)
                for text in (*block.plain, *filter(None, [block.code])):
                    self.text_block(text, EQUATION)
                self.add(Paragraphs(block.notes, "note"))
            case Details():
                self._need(20.0)
                self.text_block(block.summary, SUMMARY)
                self.add_all(block.blocks)
            case Section():
                self.add_all(block.blocks)
            case Heading():
                self.heading(block, None)
            case Interactive():
                pass

    def heading(self, block: Heading, following: Block | None) -> None:
        if block.question:
            self.question(block.question, following)
        self._need(_least_height(following) + 10.0)
        self.text_block(block.text, HEADINGS[block.level])

    def question(self, text: str, following: Block | None) -> None:
        """What an answer answers, below a line across the page."""
        self._need(_least_height(following) + 16.0)
        self.set_y(self.get_y() + 2.5)
        self.line(SIDE_MM, self.get_y(), SIDE_MM + TEXT_MM, self.get_y())
        self.text_block(text.upper(), QUESTION)

    def text_block(self, text: str, style: TextStyle, mark: str = "") -> None:
        """A paragraph; it goes on to the next page where it must."""
        self._font(style)
        line = self.scale * style.size * _MM * _LINE_HEIGHT
        if self.get_y() > TOP_MM:
            self.set_y(self.get_y() + self.scale * style.before)
        self._need(line)
        if mark:
            self.set_x(SIDE_MM + 0.3 * style.indent)
            self.cell(0.7 * style.indent, line, mark)
        self.set_x(SIDE_MM + style.indent)
        self.multi_cell(
            TEXT_MM - style.indent,
            line,
            self._wrappable(text.replace("`", ""), TEXT_MM - style.indent),
            align=Align.L,
            padding=0,
            new_x=XPos.LMARGIN,
            new_y=YPos.NEXT,
        )
        self.set_y(self.get_y() + self.scale * style.after)

    def figure_block(self, block: FigureBlock) -> None:
        """The caption and below it the drawing as vectors."""
        # one unit of a drawing of matplotlib's is a point, which fpdf2 reads from `pt`
        svg = _FONT_SIZE.sub(r"\1pt", block.picture.svg)
        width, height = map(float, re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)[0])
        tall = TEXT_MM * height / width
        self._need(tall + 12.0)
        self.text_block(block.picture.title, CAPTION)
        self.image(io.BytesIO(svg.encode()), SIDE_MM, self.get_y(), TEXT_MM, tall)
        self.set_y(self.get_y() + tall + 3.0)

    def image_block(self, block: Image) -> None:
        """The pixels as they are, no wider than the text and no taller than a page."""
        most = self.h - TOP_MM - FOOT_MM
        ratio = block.width_px / block.height_px
        width = min(TEXT_MM, 25.4 * block.width_px / _PICTURE_DPI, most * ratio)
        tall = width / ratio
        self._need(tall)
        self.image(io.BytesIO(block.png), SIDE_MM, self.get_y(), width, tall)
        self.set_y(self.get_y() + tall + 3.0)

    def table_block(self, block: Table) -> None:
        """Its head stands again on every page that the table reaches."""
        size = 6.2 if len(block.head) >= _MANY else 7.2
        rows = [block.head, *(_lines(row) for row in block.rows)]
        self._need(20.0)
        widths = self._column_widths(rows, size)
        self._font(TextStyle(size))
        with self.table(
            width=sum(widths),
            col_widths=widths,
            align=Align.L,
            text_align=[Align.R if k in block.numeric else Align.L for k in range(len(widths))],
            v_align=VAlign.T,
            line_height=size * _MM * _LINE_HEIGHT,
            padding=(_CELL_MM[0], _CELL_MM[1], _CELL_MM[0], 0.0),
            borders_layout=TableBordersLayout.HORIZONTAL_LINES,
            headings_style=FontFace(emphasis="B", color=colour("muted")),
            wrapmode=WrapMode.WORD,
        ) as table:
            for row in rows:
                cells = zip(row, widths, strict=True)
                table.row([self._wrappable(text, width - _CELL_MM[1]) for text, width in cells])
        self.set_y(self.get_y() + 2.5)

    def _column_widths(self, rows: Sequence[Sequence[str]], size: float) -> list[float]:
        """Columns as wide as their widest cell where there is room; else the widest give way."""
        self._font(TextStyle(size, bold=True))  # no narrower than regular
        natural = [
            max(self.get_string_width(line) for row in rows for line in row[column].split("\n"))
            + _CELL_MM[1]
            + 0.3  # rounding must not break the widest line
            for column in range(len(rows[0]))
        ]
        limit, excess = max(natural), sum(natural) - TEXT_MM
        while excess > 1e-6:
            widest = [one for one in natural if one >= limit - 1e-9]
            below = max((one for one in natural if one < limit - 1e-9), default=0.0)
            limit -= min(limit - below, excess / len(widest))
            natural = [min(one, limit) for one in natural]
            excess = sum(natural) - TEXT_MM
        return natural

    def _wrappable(self, text: str, width: float) -> str:
        """Text in letters that the font has; names wider than this may be broken inside."""
        words = re.split(
            r"([ \n])", "\n".join(label(one, len(one) + 1) for one in text.split("\n"))
        )
        return "".join(
            _BREAKABLE.sub("\u200b", word) if self.get_string_width(word) > width else word
            for word in words
        )

    def _need(self, height: float) -> None:
        """A new page if so much does not fit on this one."""
        if self.will_page_break(height) and self.get_y() > TOP_MM:
            self.add_page()

    def _font(self, style: TextStyle) -> None:
        self.set_font(_FONT, "B" if style.bold else "", self.scale * style.size)
        self.set_text_color(colour(style.role))


def _least_height(block: Block | None) -> float:
    """How much of a block must stand under its heading [mm]."""
    if isinstance(block, FigureBlock):
        return 90.0
    return 25.0 if isinstance(block, Table | Details) else 8.0


def _lines(row: Iterable[TableCell]) -> tuple[str, ...]:
    return tuple(f"{one.text}\n{one.small}" if one.small else one.text for one in row)
