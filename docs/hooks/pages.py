"""Pages of the site that are not written by hand: made, at every build, of the catalogue, of the
commands' help, of the schemas and of the pages that lie elsewhere in the repository.

mkdocs calls `on_files` and `on_page_markdown` (`hooks` in mkdocs.yml).
"""

from __future__ import annotations

import os
import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE))

import reference  # noqa: E402  # next to this file

#: page of the repository -> page of the site
INCLUDED = {
    "README.md": "index.md",
    "SKILL.md": "project/skill.md",
    "data/README.md": "reference/recordings.md",
    "data/rigs/README.md": "reference/rig-files.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "CHANGELOG.md": "project/changelog.md",
}
PICTURES = "notebooks/pictures"
#: entries of the navigation that are filled in here
FILLED = ("reference/effects/", "reference/rigs/", "reference/commands/")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made and what lies elsewhere."""
    for source, place in INCLUDED.items():
        if place != "index.md":
            text = (ROOT / source).read_text(encoding="utf-8")
            files.append(File.generated(config, place, content=text))
    for picture in sorted((ROOT / PICTURES).glob("*.png")):
        place = f"pictures/{picture.name}"
        files.append(File.generated(config, place, abs_src_path=str(picture)))
    made = dict(reference.written_pages())
    # without pictures where a test only asks whether the site builds
    if os.environ.get("PAMID_DOCS_PICTURES") != "0":
        made |= reference.pictured(made)
    for place, content in made.items():
        files.append(File.generated(config, place, content=content))
    config.nav = _filled(config.nav, reference.navigation())
    return files


def _filled(entries: Any, made: dict[str, list[Any]]) -> Any:
    """The navigation with the lists of generated pages in their places."""
    if isinstance(entries, list):
        return [_filled(entry, made) for entry in entries]
    if isinstance(entries, dict):
        return {title: _filled(entry, made) for title, entry in entries.items()}
    return made.get(entries, entries)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links that lead out of docs/ in the repository lead to the same page of the site."""
    place = page.file.src_uri
    source = next((s for s, p in INCLUDED.items() if p == place and s != "README.md"), "")
    base = posixpath.dirname(source or f"docs/{place}")

    def led(link: re.Match[str]) -> str:
        target, _, anchor = link[1].partition("#")
        if "://" in target or not target:
            return link[0]
        inside = posixpath.normpath(posixpath.join(base, target))
        if inside.startswith(PICTURES + "/"):
            there = f"pictures/{posixpath.basename(inside)}"
        elif inside in INCLUDED:
            there = INCLUDED[inside]
        elif inside.startswith("docs/"):
            there = inside.removeprefix("docs/")
        else:
            return link[0]
        way = posixpath.relpath(there, posixpath.dirname(place) or ".")
        return f"]({way}{'#' + anchor if anchor else ''})"

    return _LINK.sub(led, markdown)
