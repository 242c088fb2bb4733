"""Names of rigs, effects and networks as values of options: completion in a shell, and the nearest
name to a wrong one."""

from __future__ import annotations

import ast
import difflib
import importlib.util
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem


class Catalogued(click.ParamType):
    """A text for which shells complete the names of a package folder, and Python files."""

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
        items = [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
        return items or [CompletionItem(incomplete, type="file")]

    def _names(self) -> list[str]:
        return _entries(self.folder)


#: scanned folder of the package -> text that only files with an entry contain
BASES = {
    "rigs": "Rig):\n",
    "effects": "",
    "networks": "(Network)",
    "export/forms": "FORM = ",
    "replications/papers": "OPTIONS = ",
    "trial/machines": "MACHINE = ",
}


def _package() -> Path:
    spec = importlib.util.find_spec("pamid")
    assert spec is not None and spec.submodule_search_locations
    return Path(spec.submodule_search_locations[0])


def _files(folder: str) -> list[Path]:
    """Files of a package folder that contain an entry.

    The text decides, because completion is too slow if it imports them. Shared parts are left out.
    """
    return [
        file
        for file in sorted((_package() / folder).glob("*.py"))
        if not file.stem.startswith("_") and BASES[folder] in file.read_text(encoding="utf-8")
    ]


def listed(names: Iterable[str]) -> str:
    """a, b or c"""
    *first, last = names
    return " or ".join([*([", ".join(first)] if first else []), last])


def _entries(folder: str) -> list[str]:
    return [file.stem.replace("_", "-") for file in _files(folder)]


def rigs_with(attribute: str) -> list[str]:
    """Rigs of the catalogue whose file sets this attribute."""
    return [
        file.stem.replace("_", "-")
        for file in _files("rigs")
        if f"self.{attribute} = " in file.read_text(encoding="utf-8")
    ]


def machines() -> list[str]:
    """Rigs for which the blind trial has a machine."""
    return _entries("trial/machines")


@lru_cache
def export_forms() -> dict[str, tuple[tuple[str, ...], str]]:
    """The forms that `pamid.export` can write: further names, and a line about each."""
    files = _files("export/forms")
    return {file.stem: (tuple(_literal(file, "ALSO")), _line_of(file)) for file in files}


@lru_cache
def papers() -> dict[str, tuple[tuple[str, ...], str]]:
    """The papers that can be reproduced: their special options, and a line about each."""
    files = _files("replications/papers")
    return {file.stem: (tuple(_literal(file, "OPTIONS")), _line_of(file)) for file in files}


def cures() -> tuple[str, ...]:
    """Repairs that `pamid.ingest` has for uneven stamps."""
    return tuple(_literal(_package() / "ingest" / "mapping.py", "Repair"))


def _line_of(file: Path) -> str:
    """Summary line of a file's docstring."""
    head = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return head.partition("\n\n")[0].partition(": ")[2].removesuffix(".").replace("\n", " ")


@lru_cache
def network_sizes() -> dict[str, dict[str, tuple[int, int, str, str]]]:
    """The `size_options` of every kind of network in the package, by kind."""
    return {file.stem: _literal(file, "size_options") for file in _files("networks")}


def _literal(file: Path, name: str) -> Any:
    """Literal that a file, or a class in it, assigns to a name, or the values of a `Literal[...]`;
    {} without one."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.AnnAssign | ast.Assign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(isinstance(target, ast.Name) and target.id == name for target in targets):
                literal = node.value.slice if isinstance(node.value, ast.Subscript) else node.value
                return ast.literal_eval(literal)
    return {}


def size_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for every size of the kinds of networks."""
    known_sizes = network_sizes()
    for name in sorted({name for sizes in known_sizes.values() for name in sizes}, reverse=True):
        owners = [kind for kind, sizes in known_sizes.items() if name in sizes]
        least, most, what, otherwise = known_sizes[owners[0]][name]
        function = click.option(
            f"--{name.replace('_', '-')}",
            name,
            type=click.IntRange(least, most),
            help=f"{what} of {listed(owners)}. [default: {otherwise}]",
        )(function)
    return function


RIG_NAMES = Catalogued("rigs")
EFFECT_NAMES = Catalogued("effects")
NETWORK_NAMES = Catalogued("networks")
#: options whose value is such a name in every command
OPTIONS = {
    "rig": RIG_NAMES,
    "rigs": RIG_NAMES,
    "effects": EFFECT_NAMES,
    "without": EFFECT_NAMES,
    "network": NETWORK_NAMES,
}


def suggest(name: str, names: Iterable[str]) -> str:
    """A sentence that proposes the nearest of the names, or nothing."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return f"Did you mean {close[0]!r}?" if close else ""
