"""Start tags of an XML text with their places, and changes to their attributes.

Every other character stays: comments, order, blanks.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from xml.parsers import expat

from pamid.base.errors import FileError


@dataclass(frozen=True)
class Tag:
    """A start tag: name, attributes, line, and places of its first byte and behind its last byte.

    It has the number of the enclosing tag, too (-1: none).

    closing   place of the end tag; that of the start tag if there is none ("<joint/>")
    after     place behind the whole element
    """

    name: str
    attributes: Mapping[str, str]
    line: int
    begin: int
    end: int
    parent: int
    closing: int = 0
    after: int = 0


def tags_of(text: bytes) -> list[Tag]:
    """Every start tag in the order of the text.

    FileError for a text that is not XML, or that defines entities.
    """
    tags: list[Tag] = []
    open_tags: list[int] = []
    parser = expat.ParserCreate()

    def begin(name: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        parent = open_tags[-1] if open_tags else -1
        line = parser.CurrentLineNumber
        tags.append(Tag(name, attributes, line, at, _end(text, at), parent))
        open_tags.append(len(tags) - 1)

    def refuse(*_: object) -> None:
        raise FileError("The file defines entities.", "Write them out.", code="model")

    def end(_: str) -> None:
        number, at = open_tags.pop(), parser.CurrentByteIndex
        tag = tags[number]
        alone = text[tag.end - 2 : tag.end] == b"/>"
        closing, after = (tag.begin, tag.end) if alone else (at, _end(text, at))
        tags[number] = replace(tag, closing=closing, after=after)

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise FileError(f"The file is not XML: {error}.", code="model") from error
    return tags


def _end(text: bytes, begin: int) -> int:
    """Place behind the ">" that closes the tag; a ">" in quotes does not."""
    match = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""").match(text, begin)
    assert match is not None, "the parser has seen the end of this tag"
    return match.end()


class Edits:
    """Changes to a text, applied together at the end."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self._attributes: dict[int, dict[str, str | None]] = {}
        self._names: dict[int, str] = {}
        self._added: dict[int, list[str]] = {}  # place -> lines
        self._removed: list[Tag] = []

    def set(self, tag: Tag, attribute: str, value: str | None) -> None:
        """Set a tag's attribute; None removes it."""
        self._attributes.setdefault(tag.begin, {})[attribute] = value

    def rename(self, tag: Tag, name: str) -> None:
        self._names[tag.begin] = name

    def remove(self, tag: Tag) -> None:
        """Remove an element with its content."""
        self._removed.append(tag)

    def add_inside(self, tag: Tag, text: str) -> None:
        """Insert an element as the first child of another, on a separate line."""
        self._added.setdefault(tag.end, []).append(f"\n{self._indent(tag)}  {text}")

    def add_after(self, tag: Tag, text: str) -> None:
        """Insert an element behind another element, on a separate line."""
        self._added.setdefault(tag.after, []).append(f"\n{self._indent(tag)}{text}")

    def add_last(self, tag: Tag, text: str) -> None:
        """Insert an element as the last child of another, on a separate line."""
        indent = self._indent(tag)
        before = self.text[: tag.closing].rstrip(b" \t\r\n")
        self._added.setdefault(len(before), []).append(f"\n{indent}  {text}")

    def made(self, tags: list[Tag]) -> bytes:
        """Text with all changes."""
        changes = [(tag.begin, tag.after, "") for tag in self._removed]
        gone = {tag.begin for tag in self._removed}
        for tag in tags:
            if tag.begin in gone:
                continue
            values, name = self._attributes.get(tag.begin, {}), self._names.get(tag.begin, "")
            if values or name:
                new = _changed(self.text[tag.begin : tag.end].decode(), values)
                new = f"<{name}{new[1 + len(tag.name) :]}" if name else new
                changes.append((tag.begin, tag.end, new))
            if name and tag.closing > tag.begin:
                changes.append((tag.closing, tag.after, f"</{name}>"))
        changes += [(at, at, "".join(lines)) for at, lines in self._added.items()]
        pieces, at = [], 0
        for begin, end, new in sorted(changes, key=lambda change: change[:2]):
            pieces += [self.text[at:begin], new.encode()]
            at = end
        return b"".join([*pieces, self.text[at:]])

    def _indent(self, tag: Tag) -> str:
        line = self.text[self.text.rfind(b"\n", 0, tag.begin) + 1 : tag.begin]
        return line.decode() if not line.strip() else ""


def _changed(tag: str, values: Mapping[str, str | None]) -> str:
    for name, value in values.items():
        there = re.search(rf"""(\s){re.escape(name)}(\s*=\s*)("[^"]*"|'[^']*')""", tag)
        if value is None:
            tag = tag if there is None else tag[: there.start()] + tag[there.end() :]
        elif there is not None:
            begin, end = there.span(3)
            tag = f'{tag[:begin]}"{value}"{tag[end:]}'
        else:
            close = re.search(r"\s*/?>$", tag)
            assert close is not None
            tag = f'{tag[: close.start()]} {name}="{value}"{tag[close.start() :]}'
    return tag
