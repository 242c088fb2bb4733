"""A page taken apart again into what can be set on paper: headings, sentences, tables, pictures, in
their order.

The HTML of a page is the one place where a report is composed; whatever else shows it reads it from
there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser

#: elements that become a block of their kind, by name or by class
_TEXTS = ("h1", "h2", "h3", "h4", "p", "li", "figcaption", "pre", "summary")
_CLASSES = ("rig", "note", "warning", "question")
_SILENT = ("script", "style", "title", "noscript", "svg", "button", "math")
_UNSEEN = ("scripted", "samples", "motion", "narrow")
_VOID = ("meta", "br", "hr", "img")


@dataclass(frozen=True)
class Block:
    """kind: an element's name, or one of rig, note, warning, question, table, picture, equation;
    text: of it, or the picture's name; answer: does it stand in an answer; rows: cells of a table,
    head first; numeric: columns set right; below: is it the caption of the picture before it."""

    kind: str
    text: str = ""
    answer: bool = False
    rows: tuple[tuple[str, ...], ...] = ()
    numeric: frozenset[int] = field(default=frozenset())
    below: bool = False


def blocks_of(page: str) -> list[Block]:
    """The blocks of a page that this package made."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    return reader.blocks


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.blocks: list[Block] = []
        self._open: list[tuple[str, str]] = []  # name, class
        self._text = ""
        self._kind = ""
        self._silent = self._answer = 0  # depth at which it began, 0: it has not
        self._rows: list[list[str]] = []
        self._numeric: set[int] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        about = {name: value or "" for name, value in attrs}
        classes = about.get("class", "")
        if tag in _VOID:
            return
        self._open.append((tag, classes))
        if self._silent:
            return
        if tag in _SILENT or set(_UNSEEN) & set(classes.split()):
            self._silent = len(self._open)
            if tag == "math" and about.get("alttext"):
                self._add("equation", about["alttext"])
            return
        if tag == "section" and "answer" in classes.split() and not self._answer:
            self._answer = len(self._open)
        if tag == "figure" and about.get("id", "").startswith("figure-"):
            self._add("picture", about["id"].removeprefix("figure-"))
        elif tag in _TEXTS or classes in _CLASSES:
            self._flush()
            self._kind = classes if classes in _CLASSES else tag
        elif tag == "table":
            self._rows, self._numeric = [], set()
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("th", "td"):
            self._text = ""
            self._numeric |= {len(self._rows[-1])} if classes == "n" else set()
        elif tag == "small":
            self._text += "\n"

    def handle_endtag(self, tag: str) -> None:
        if tag in _VOID:
            return
        depth = len(self._open)
        self._open.pop()
        if self._silent:
            self._silent = 0 if depth == self._silent else self._silent
            return
        if depth == self._answer:
            self._answer = 0
        if tag in ("th", "td"):
            self._rows[-1].append(self._text.strip())
            self._text = ""
        elif tag == "table":
            width = max((len(row) for row in self._rows), default=0)
            rows = tuple(tuple(row + [""] * (width - len(row))) for row in self._rows)
            self.blocks.append(
                Block("table", "", bool(self._answer), rows, frozenset(self._numeric))
            )
        elif self._kind and (tag in _TEXTS or self._kind == "question"):
            self._flush()
            self._kind = tag if tag != "span" else self._open[-1][0]

    def handle_data(self, data: str) -> None:
        if not self._silent and (self._kind or self._rows):
            self._text += data

    def _flush(self) -> None:
        text = " ".join(self._text.split())
        if text and self._kind:
            self._add(self._kind, text)
        self._text = ""

    def _add(self, kind: str, text: str) -> None:
        below = kind == "figcaption" and bool(self.blocks) and self.blocks[-1].kind == "picture"
        self.blocks.append(Block(kind, text, bool(self._answer), below=below))
