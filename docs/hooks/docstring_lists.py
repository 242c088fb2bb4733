"""Docstrings list arguments as `name  what it is`, two blanks or more between: in Markdown that
is a list.

An extension of griffe, which reads the docstrings for mkdocstrings (mkdocs.yml names this file).
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

_ITEM = re.compile(r"^([a-z_][\w.]*(?:, [a-z_][\w.]*)*)\s{2,}(\S.*)$")


class DocstringLists(Extension):
    """Rewrites such lines of every docstring."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = listed(obj.docstring.value)


def listed(text: str) -> str:
    """The docstring with its aligned lists as lists of Markdown."""
    lines: list[str] = []
    inside = False
    for line in text.splitlines():
        item = _ITEM.match(line)
        if item:
            lines += ([] if inside else [""]) + [f"- `{item[1]}`: {item[2]}"]
            inside = True
        elif inside and line.startswith(" "):
            lines.append(f"    {line.strip()}")
        else:
            inside = False
            lines.append(line)
    return "\n".join(lines)
