"""Names: of rigs and effects as values of options, completed by the shell; and the nearest one to a
wrong one."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem


class Catalogued(click.ParamType):
    """A text; shells complete the names of one folder of the package, `rigs` or `effects`, and
    Python files."""

    name = "text"

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
        return found or [CompletionItem(incomplete, type="file")]

    def _names(self) -> list[str]:
        """By their files, so that nothing is loaded while somebody types; parts that rigs share are
        left out."""
        spec = importlib.util.find_spec("pamid")
        places = list(spec.submodule_search_locations or []) if spec else []
        files = [
            file for place in places for file in sorted((Path(place) / self.folder).glob("*.py"))
        ]
        return [file.stem.replace("_", "-") for file in files if _is_entry(file, self.folder)]


def _is_entry(file: Path, folder: str) -> bool:
    return not file.stem.startswith("_") and (
        folder == "effects" or "(Rig)" in file.read_text(encoding="utf-8")
    )


RIG = Catalogued("rigs")
EFFECT = Catalogued("effects")
#: options that take such a name wherever they occur
OPTIONS = {"rig": RIG, "rigs": RIG, "effects": EFFECT, "without": EFFECT}


def suggest(name: str, names: Iterable[str]) -> str:
    """A sentence that proposes the nearest of the names, or nothing."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return f"Did you mean {close[0]!r}?" if close else ""
