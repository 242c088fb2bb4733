"""Fragments of HTML, MathML and SVG made of escaped parts: text from files can never become markup,
because only `Markup` passes unescaped. Pages are made of them in page.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import markupsafe
from markupsafe import Markup

_CODE_SPAN = re.compile(r"`([^`]+)`")
_FORBIDDEN = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
_UNBROKEN = re.compile(r"\b(held-out|Bouc-Wen)\b")

Part = str | Markup | Iterable["Part"]


def printable(value: object) -> str:
    """Text with a replacement sign for control characters and direction marks; markup as it is."""
    return value if isinstance(value, Markup) else _FORBIDDEN.sub("\ufffd", str(value))


def escape(text: str) -> Markup:
    """Text as markup that shows it literally."""
    return markupsafe.escape(printable(text))


def tag(name: str, /, *parts: Part, **attributes: str) -> Markup:
    """An element. `class_` is written class, other underscores become hyphens; empty attributes
    are left out."""
    inside = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
        if value
    )
    return Markup(f"<{name}{inside}>{joined(parts)}</{name}>")


def joined(parts: Iterable[Part]) -> Markup:
    """Parts in sequence; texts are escaped, nested lists are flattened."""
    return Markup(
        "".join(escape(part) if isinstance(part, str) else joined(part) for part in parts)
    )


def prose(text: str) -> Markup:
    """A sentence as HTML: text in backticks is code, some compounds stay on a line."""
    shown = _CODE_SPAN.sub(lambda span: f"<code>{breakable(Markup(span[1]))}</code>", escape(text))
    return Markup(_UNBROKEN.sub(r'<span class="k">\1</span>', shown))


def breakable(text: str) -> Markup:
    """A name that may be broken behind its underscores, before it is broken anywhere."""
    return Markup(str(escape(text)).replace("_", "_<wbr>"))


def paragraphs(sentences: Iterable[str], class_: str = "") -> Markup:
    """A <p> per text; empty ones are left out."""
    return joined(tag("p", prose(text), class_=class_) for text in sentences if text)
