"""Table of the commands, read from the text of the files: `pamid --help` imports none of them.

A command file is named after its command (`pamid train-residual` is `train_residual.py`). Its
docstring begins "`pamid NAME`:" and continues with its line of `pamid --help`. Its HELP_ORDER is
its position there.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import click

_HEAD = re.compile(
    r'"""`pamid ([a-z0-9-]+)`: (.+?)(?:"""|\n\n).*?^HELP_ORDER = (\d+)$', re.M | re.S
)


def _scanned(folder: Path) -> dict[str, str]:
    """Commands of a folder with their lines of help, in the order of HELP_ORDER."""
    heads = [_HEAD.match(file.read_text(encoding="utf-8")) for file in folder.glob("*.py")]
    entries = sorted((int(head[3]), head[1], " ".join(head[2].split())) for head in heads if head)
    return {name: line for _, name, line in entries}


#: name -> a line of help
COMMANDS: dict[str, str] = _scanned(Path(__file__).parent)

#: second names of commands, after their purpose
ALIASES = {"excite": "generate-aprbs"}


def load_command(name: str) -> click.Command:
    """A command by its name; imports its module."""
    module = importlib.import_module(f".{name.replace('-', '_')}", __package__)
    assert isinstance(module.command, click.Command)
    return module.command


def every_command() -> Iterator[click.Command]:
    """All commands; imports all their modules."""
    return map(load_command, COMMANDS)
