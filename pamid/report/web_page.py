"""A document as one HTML page (Jinja2, autoescaped). It loads nothing and runs only pamid's
scripts, which a Content-Security-Policy enforces."""

from __future__ import annotations

import base64
import hashlib
from functools import lru_cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined

from pamid.report.document import Document, place_of
from pamid.report.markup import breakable, printable, prose
from pamid.report.style import COLOURS

#: how every page begins: by this a page of ours is known from somebody's file
MARK = "<!doctype html>\n<!-- pamid.report/1 -->\n"
#: drawings carry their styles themselves, hence the attributes; style elements and scripts are
#: allowed by their hashes
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; style-src-attr 'unsafe-inline'"
)


def html_of(document: Document) -> str:
    """The whole page as text; the same document gives the same text."""
    scripts, styles = (page_script(), *document.scripts), f"{_style_sheet()}{document.styles}"
    policy = (
        f"{_POLICY}; style-src-elem {_hash(styles)}; script-src {' '.join(map(_hash, scripts))}"
    )
    return (
        _environment()
        .get_template("page.html")
        .render(mark=MARK, policy=policy, styles=styles, scripts=scripts, document=document)
    )


@lru_cache(maxsize=1)
def _environment() -> Environment:
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
    environment.filters["breakable"] = breakable
    environment.globals["place_of"] = place_of
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    return environment


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def page_script() -> str:
    """Script of every page: colour scheme, tables that can be copied."""
    return asset("page.js")


def asset(name: str) -> str:
    """A script, style sheet or licence for pages."""
    return resources.files("pamid.report").joinpath(f"assets/{name}").read_text(encoding="utf-8")


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
