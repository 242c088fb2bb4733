"""A page as a list of sections: a heading, often with its finding, and below it sentences, tables
and pictures. It loads nothing and runs only pamid's scripts, which a Content-Security-Policy
enforces.

Text in backticks is shown as code; every text may come from files and is escaped.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pamid.report.answers import Card
from pamid.report.markup import Part, breakable, joined, paragraphs, printable, prose, tag
from pamid.report.style import COLOURS, Picture

#: how every page begins: by this a page of ours is known from somebody's file
MARK = "<!doctype html>\n<!-- pamid.report/1 -->\n"
#: drawings carry their styles themselves, hence the attributes; style elements and scripts are
#: allowed by their hashes
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; style-src-attr 'unsafe-inline'"
)
_LISTED = 3  # lowest level of the headings in the table of contents
_ID_WORDS = 6  # of a heading in its id


@dataclass(frozen=True)
class Section:
    """A heading of level 2 to 4 and its content. question: of an answer, shown above the heading;
    style: a class of the page's style sheet."""

    title: str
    content: tuple[Markup | Section, ...]
    level: int = 2
    question: str = ""
    style: str = ""

    @property
    def place(self) -> str:
        """Id of the heading: its question or text, in lower case with hyphens."""
        words = re.findall(r"[a-z0-9]+", (self.question or self.title).lower())
        return "-".join(words[:_ID_WORDS]) or "section"

    @property
    def contents(self) -> list[tuple[int, str, str]]:
        """(level, text, place) of the headings for the table of contents."""
        listed = self.title and self.level <= _LISTED
        first = [(self.level, self.question or self.title, self.place)] if listed else []
        inner = [part.contents for part in self.content if isinstance(part, Section)]
        return sum(inner, first)

    @property
    def html(self) -> Markup:
        """The section as an element."""
        question = tag("span", self.question, class_="question") if self.question else ""
        heading = tag(f"h{self.level}", question, prose(self.title), id=self.place)
        content = [part.html if isinstance(part, Section) else part for part in self.content]
        return tag("section", heading if self.title else "", content, class_=self.style)


@dataclass(frozen=True)
class Page:
    """title: of the browser's tab, the headline by default; preface: below the headline; cards: the
    short answers; todo: the next step in a line; scripts, styles: of pamid, for the interactive
    sections."""

    headline: str
    subtitle: str
    sections: tuple[Section, ...]
    preface: Markup = Markup("")
    title: str = ""
    cards: tuple[Card, ...] = ()
    todo: str = ""
    scripts: tuple[str, ...] = ()
    styles: str = ""


def html_of(page: Page) -> str:
    """The whole page as text; the same page gives the same text."""
    scripts, styles = (asset("page.js"), *page.scripts), f"{_style_sheet()}{page.styles}"
    return rendered(
        "page.html",
        mark=MARK,
        policy=f"{_POLICY}; style-src-elem {_hash(styles)}; "
        f"script-src {' '.join(map(_hash, scripts))}",
        styles=styles,
        scripts=scripts,
        page=page,
        contents=sum((section.contents for section in page.sections), []),
    )


def rendered(template: str, **content: object) -> Markup:
    """A template with its content, which is escaped unless it is markup."""
    environment = Environment(
        loader=PackageLoader("pamid.report", "templates"),
        autoescape=True,
        finalize=printable,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["prose"] = prose
    return Markup(environment.get_template(template).render(**content))


# ---- content of sections -------------------------------------------------------------------------


def text(*sentences: str) -> Markup:
    """A paragraph per text."""
    return paragraphs(sentences)


def note(*sentences: str) -> Markup:
    """Remarks below a table or a picture."""
    return paragraphs(sentences, "note")


def bullets(items: Iterable[str]) -> Markup:
    """A list."""
    return tag("ul", [tag("li", prose(item)) for item in items])


def code(name: str, small: str = "", place: str = "") -> Markup:
    """A name in a cell. small: a second, small line; place: of the page, to which it leads."""
    shown = tag("code", breakable(name))
    shown = tag("a", shown, href=f"#{place}") if place else shown
    return joined([shown, tag("small", small)]) if small else shown


def strong(words: str) -> Markup:
    """An entry to be noticed."""
    return tag("strong", words)


def table(
    head: Iterable[str],
    rows: Iterable[Iterable[str]],
    numeric: Iterable[int] = (),
    style: str = "",
) -> Markup:
    """A table of texts or markup. numeric: columns that are aligned right; style: "steps" for
    column widths that the page's style sets."""
    head, right, above = tuple(head), frozenset(numeric), tuple[str, ...]()
    lines = []
    for row in map(tuple, rows):
        cells = []
        for column, cell in enumerate(row):
            # a cell that, with all cells to its left, repeats the row above
            again = row[: column + 1] == above[: column + 1] and column not in right
            cells.append(tag("td", cell, class_="n" * (column in right) or "again" * again))
        lines.append(tag("tr", cells))
        above = row
    heads = [
        tag("th", words, scope="col", class_="n" * (column in right))
        for column, words in enumerate(head)
    ]
    return tag(
        "div",
        tag("table", tag("thead", tag("tr", heads)), tag("tbody", lines)),
        class_=f"scroll {style}".rstrip(),
        tabindex="0",
        role="region",
        aria_label=f"table: {', '.join(filter(None, head))}",
    )


def figures(pictures: Mapping[str, Picture], *names: str) -> list[Markup]:
    """The pictures of these names, as far as they were drawn."""
    shown = []
    for picture in (pictures[name] for name in names if name in pictures):
        look = {"role": "group" if picture.linked else "img", "aria_label": picture.title}
        wide = tag("div", Markup(picture.wide), class_="wide", **look)
        narrow = tag("div", Markup(picture.narrow), class_="narrow", **look)
        caption = tag("figcaption", prose(picture.title))
        shown.append(tag("figure", caption, wide, narrow, id=f"figure-{picture.name}"))
    return shown


def image(name: str, title: str, png: bytes, width_px: int, height_px: int) -> Markup:
    """A PNG of the run folder."""
    picture = Markup('<img src="data:image/png;base64,{}" alt="{}" width="{}" height="{}">').format(
        base64.b64encode(png).decode(), title, width_px, height_px
    )
    return tag("figure", picture, id=f"figure-still-{name}")


def details(summary: str, *content: Part) -> Markup:
    """Content that is folded until the reader opens it; on paper it is open."""
    return tag("details", tag("summary", summary), *content)


# ---- scripts and styles --------------------------------------------------------------------------


def asset(name: str) -> str:
    """A script, style sheet or licence for pages."""
    return resources.files("pamid.report").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"


def _style_sheet() -> str:
    """Light or dark theme by the system's setting or the reader's choice; prints are light."""
    light, dark = (
        "".join(f"--{role.replace('_', '-')}:{pair[k]};" for role, pair in COLOURS.items())
        for k in (0, 1)
    )
    font = (
        "--font:system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,'DejaVu "
        "Sans',sans-serif;"
    )
    return (
        f":root{{color-scheme:light dark;{font}{light}}}\n"
        ":root[data-colours=light]{color-scheme:light}\n"
        f"@media screen{{:root[data-colours=dark]{{color-scheme:dark;{dark}}}}}\n"
        "@media screen and (prefers-color-scheme:dark)"
        f"{{:root:not([data-colours=light]){{{dark}}}}}\n{asset('page.css')}"
    )
