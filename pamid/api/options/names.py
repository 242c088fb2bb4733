"""Names of rigs, effects, networks, forms of export and papers, read from the files of the package:
importing these would take seconds."""

from __future__ import annotations

import ast
from functools import lru_cache
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parents[2]
#: scanned folder of the package -> text that only files with an entry contain
BASES = {
    "rigs": "Rig):\n",
    "effects": "",
    "networks": "(Network)",
    "exports/forms": "FORM = ",
    "api/replications/papers": "OPTIONS = ",
    "trial/machines": "MACHINE = ",
}


def _files(folder: str) -> list[Path]:
    """Files of a package folder that contain an entry.

    The text decides, because completion is too slow if it imports them. Shared parts are left out.
    """
    return [
        file
        for file in sorted((PACKAGE / folder).iterdir())  # `glob` is silent without the folder
        if file.suffix == ".py"
        and not file.stem.startswith("_")
        and BASES[folder] in file.read_text(encoding="utf-8")
    ]


def entries(folder: str) -> list[str]:
    return [file.stem.replace("_", "-") for file in _files(folder)]


def rigs_with(attribute: str) -> list[str]:
    """Rigs of the catalogue whose file sets this attribute."""
    return [
        file.stem.replace("_", "-")
        for file in _files("rigs")
        if f"self.{attribute} = " in file.read_text(encoding="utf-8")
    ]


def machines() -> list[str]:
    return entries("trial/machines")


@lru_cache
def export_forms() -> dict[str, tuple[tuple[str, ...], str]]:
    """The forms that `pamid.exports` can write: further names, and a line about each."""
    return _described("exports/forms", "ALSO")


@lru_cache
def papers() -> dict[str, tuple[tuple[str, ...], str]]:
    """The papers that can be reproduced: their special options, and a line about each."""
    return _described("api/replications/papers", "OPTIONS")


def cures() -> tuple[str, ...]:
    """Repairs that `pamid.ingest` has for uneven stamps."""
    return tuple(_literal(PACKAGE / "intake" / "logs" / "mapping.py", "Repair"))


def _described(folder: str, name: str) -> dict[str, tuple[tuple[str, ...], str]]:
    """Values that each file of a folder assigns to a name, and the summary of its docstring."""
    described = {}
    for file in _files(folder):
        head = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        line = head.partition("\n\n")[0].partition(": ")[2].removesuffix(".").replace("\n", " ")
        described[file.stem] = tuple(_literal(file, name)), line
    return described


@lru_cache
def network_sizes() -> dict[str, dict[str, tuple[int, int, str, str]]]:
    """The `size_options` of every kind of network in the package, by kind."""
    return {file.stem: _literal(file, "size_options") for file in _files("networks")}


def _literal(file: Path, name: str) -> Any:
    """Literal that a file, or a class in it, assigns to a name, or the values of a `Literal[...]`;
    {} without values."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.AnnAssign | ast.Assign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(isinstance(target, ast.Name) and target.id == name for target in targets):
                literal = node.value.slice if isinstance(node.value, ast.Subscript) else node.value
                return ast.literal_eval(literal)
    return {}
