"""A page of a report as a browser would take it: outline, words, scripts."""

import base64
import hashlib
import html
import re
from html.parser import HTMLParser
from pathlib import Path

from pamid.report import formatting
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.report.page import html_of
from pamid.report.run_page import run_page
from pamid.report.style import Drawing, Picture

VERDICTS = (
    "explained",
    "partly-explained",
    "ambiguous",
    "unknown-effect",
    "no-structural-gap",
    "cannot-tell",
)


class Outline(HTMLParser):
    """What a browser would make of a page: elements, attributes, visible text; complains about
    crossed elements."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(page.replace("<wbr>", ""))  # where a name may be broken, and need not be
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in ("meta", "br", "hr", "img"):
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] not in ("style", "script"):
            self.text += data + " "


def blank(drawing: Drawing) -> Picture:
    """In place of a picture, which takes the time."""
    return Picture(drawing.name, drawing.title, "<svg/>", "<svg/>", b"\x89PNG")


def outline_of(page: Path) -> Outline:
    return Outline(page.read_text(encoding="utf-8"))


def flat(text: str) -> str:
    return " ".join(text.replace(formatting.SPACE, " ").split())


def text_of(folder: Path) -> str:
    """What the page says, without its figures (they take the time)."""
    run = load_run(folder)
    return flat(Outline(html_of(run_page(run, errors_of(run), {}))).text)


def scripts_of(page: str) -> list[str]:
    """What runs on a page: all of it allowed by the policy in its head, all else that scripts hold
    is base64 text."""
    found = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    blocks = [text for about, text in found if ' type="text/plain"' in about]
    assert all(re.fullmatch(r"[A-Za-z0-9+/=]*", text) for text in blocks)
    running = [text for about, text in found if not about]
    assert len(running) + len(blocks) == len(found) == page.count("<script")
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1])  # type: ignore[index]
    allowed = policy.partition("; script-src ")[2].split("; ")[0].split()
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in running]
    assert allowed == [f"'sha256-{one}'" for one in hashes]
    return running
