"""The commands, found by reading the files of this package: `pamid --help` imports none of them.

A command file is named after its command (`pamid train-residual` is `train_residual.py`) and says
two things at its top: its docstring begins "`pamid NAME`:" and goes on with its line of
`pamid --help`; PLACE is where it stands there, between its neighbours' numbers.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import click

_HEAD = re.compile(r'"""`pamid ([a-z0-9-]+)`: (.+?)(?:"""|\n\n).*?^PLACE = (\d+)$', re.M | re.S)


def _scanned(folder: Path) -> dict[str, str]:
    """Every command of a folder and its line of help, in the order of PLACE."""
    heads = [_HEAD.match(file.read_text(encoding="utf-8")) for file in folder.glob("*.py")]
    entries = sorted((int(head[3]), head[1], " ".join(head[2].split())) for head in heads if head)
    return {name: line for _, name, line in entries}


#: name -> one line of help
COMMANDS: dict[str, str] = _scanned(Path(__file__).parent)

#: second names of commands, for those who look for what they do
ALIASES = {"excite": "generate-aprbs"}


def load_command(name: str) -> click.Command:
    """A command by its name; imports its module."""
    module = importlib.import_module(f".{name.replace('-', '_')}", __package__)
    assert isinstance(module.command, click.Command)
    return module.command


def every_command() -> Iterator[click.Command]:
    """All commands there are; imports all their modules."""
    return map(load_command, COMMANDS)
