"""The page of a run as a PDF: the three answers in words first, then their pictures, then the
evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pamid.report.blocks import Block, blocks_of
from pamid.report.sheets import Sheets, Style
from pamid.report.style import Drawing
from pamid.report.words import clean

STYLES = {
    "rig": Style(9.0, role="muted", after=0.03),
    "h1": Style(16.0, bold=True, after=0.16),
    "question": Style(7.5, bold=True, role="muted", before=0.1, after=0.02),
    "h2": Style(12.0, bold=True, before=0.06, after=0.07),
    "h3": Style(10.5, bold=True, before=0.2, after=0.06),
    "h4": Style(9.5, bold=True, before=0.12, after=0.05),
    "summary": Style(9.0, bold=True, before=0.1, after=0.05),
    "p": Style(8.8),
    "li": Style(8.8, indent=0.2, mark="•", after=0.03),
    "note": Style(8.2, role="muted"),
    "warning": Style(9.2, bold=True, role="with_cause"),
    "figcaption": Style(9.5, bold=True, before=0.12, after=0.04),
    "equation": Style(9.0, indent=0.2),
    "pre": Style(8.4, indent=0.2),
}
HEAD, BODY = Style(7.2, bold=True, role="muted"), Style(7.2)
_SMALL_HEAD, _SMALL_BODY = Style(6.2, bold=True, role="muted"), Style(6.2)
_SCALES = (1.0, 0.94, 0.88, 0.82)
_MANY = 9  # columns from which a table is set smaller
_SEEN = ("picture", "figcaption", "equation", "pre", "note")


def pdf_of(page: str, drawings: Sequence[Drawing]) -> bytes:
    """The PDF of a page (HTML text) with the drawings that it shows; the same page gives the same
    bytes."""
    title = next((one.text for one in blocks_of(page) if one.kind == "h1"), "Report")
    return sheets_of(page, drawings).pdf(clean(title))


def sheets_of(page: str, drawings: Sequence[Drawing]) -> Sheets:
    """The page set on paper."""
    blocks = blocks_of(page)
    known = {drawing.name: drawing for drawing in drawings}
    answers = [one for one in blocks if one.answer]
    leads = answers and not any(
        one.kind in ("table", "picture") for one in blocks[: blocks.index(answers[0])]
    )
    if not leads:  # a trial or a paper: as on the page
        sheets = Sheets()
        _set(sheets, blocks, known)
        return sheets
    first, last = blocks.index(answers[0]), blocks.index(answers[-1])
    sheets = _first_page([*blocks[:first], *(one for one in answers if one.kind not in _SEEN)])
    sheets.turn()
    _set(
        sheets,
        [
            *(one for one in answers if one.kind in _SEEN or one.kind == "question"),
            *blocks[last + 1 :],
        ],
        known,
    )
    return sheets


def _first_page(blocks: Sequence[Block]) -> Sheets:
    """The answers in words, set smaller where they would not fit on one page."""
    for scale in _SCALES:
        sheets = Sheets()
        _set(sheets, blocks, {}, scale)
        if len(sheets.pages) == 1:
            break
    return sheets


def _set(
    sheets: Sheets, blocks: Sequence[Block], known: Mapping[str, Drawing], scale: float = 1.0
) -> None:
    """One below the other; a picture stands under its caption, a heading never at the foot of a
    page."""
    for one, follows in zip(blocks, [*blocks[1:], Block("")], strict=True):
        if one.kind == "picture" and one.text in known:
            sheets.need(known[one.text].height + 0.5)
            if follows.kind == "figcaption":
                sheets.text(follows.text, STYLES["figcaption"])
            sheets.draw(known[one.text])
        elif one.kind == "table":
            small = len(one.rows[0]) >= _MANY
            sheets.need(0.8)
            sheets.table(
                one.rows,
                one.numeric,
                _SMALL_HEAD if small else HEAD,
                _SMALL_BODY if small else BODY,
            )
        elif one.kind == "question" and follows.answer and follows.kind != "question":
            sheets.need(known[follows.text].height + 1.0 if follows.text in known else 1.4)
            sheets.rule()
            sheets.text(one.text.upper(), STYLES["question"].scaled(scale))
        elif one.kind in STYLES and one.kind != "question" and not one.below:
            heads = one.kind in ("h2", "h3", "h4", "summary")
            sheets.need(0.0 if not heads else 1.6 if follows.kind == "table" else 0.8)
            sheets.text(one.text, STYLES[one.kind].scaled(scale))
