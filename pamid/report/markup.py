"""HTML made of escaped parts: text from files can never become markup, because only `Html` passes
unescaped."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable

_CODE = re.compile(r"`([^`]+)`")
_FORBIDDEN = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
_KEPT = re.compile(r"\b(held-out|Bouc-Wen)\b")
_VOID = ("meta", "br", "hr", "img")


class Html(str):
    """Markup that is safe as it stands."""

    __slots__ = ()


Part = str | Html | Iterable["Part"]


def escape(text: str) -> Html:
    """Text as markup that shows it literally; control characters and direction marks become a
    replacement sign."""
    return (
        text
        if isinstance(text, Html)
        else Html(html.escape(_FORBIDDEN.sub("\ufffd", text), quote=True))
    )


def tag(name: str, /, *parts: Part, **attributes: str) -> Html:
    """One element. `class_` is written class, other underscores become hyphens."""
    inside = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
    )
    if name in _VOID:
        return Html(f"<{name}{inside}>")
    return Html(f"<{name}{inside}>{joined(parts)}</{name}>")


def joined(parts: Iterable[Part]) -> Html:
    """Parts one after the other; texts are escaped, nested lists are flattened."""
    return Html("".join(escape(part) if isinstance(part, str) else joined(part) for part in parts))


def prose(text: str) -> Html:
    """A sentence; what stands in backticks is set as code, and words of few letters are kept on one
    line."""
    return Html(
        _KEPT.sub(r'<span class="k">\1</span>', _CODE.sub(r"<code>\1</code>", escape(text)))
    )


def paragraphs(sentences: Iterable[str], class_: str = "") -> Html:
    """One <p> per text; empty ones are left out."""
    extra = {"class_": class_} if class_ else {}
    return joined(tag("p", prose(text), **extra) for text in sentences if text)
