"""`pamid check`: what is wrong with a file, before any fitting."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame

EXAMPLE = """
pamid check rec.csv --rig one-dof
"""
WRONG = 3


@frame.command("check", example=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--rig", help="Rig (name or file) the recording is meant for. [default: the one its TOML names]")
def command(file: Path, rig: str | None) -> frame.Result:
    """Say what is in FILE and everything that is wrong with it: a recording, a rig file or an effect file.

    A recording (.csv): sampling, range, rest and constancy of every column, and what the rig misses. A rig (.py): its
    equations build, every port is used, nothing blows up over the bounds, sensitivities are exact, which effects fit.
    An effect (.py): its data sheet is complete, its null is exact, and it behaves wherever it fits. Exit code 3 if
    anything is wrong.
    """
    from pamid.inspection import inspect, inspection_text

    said = inspect(file, rig)
    return frame.Result(said, inspection_text(said), 0 if said["ok"] else WRONG)
