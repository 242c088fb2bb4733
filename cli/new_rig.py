"""`pamid new-rig`: Write a first rig file from a recording's columns."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame, names
from .terminal import quoted

HELP_ORDER = 45
EXAMPLE = """
pamid new-rig rec.csv --output my_rig.py
pamid new-rig rec.csv --like two-masses --column position_1_mm=x_mm --output my_rig.py
"""


@frame.command("new-rig", example=EXAMPLE)
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--like",
    "--rig",
    "like",
    type=names.RIG_NAMES,
    help="Rig to start from. [default: the one whose columns fit best]",
)
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="RIG_COLUMN=COLUMN",
    help="Column of the rig and the column of the recording for it, if the name does not match.",
)
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("my_rig.py"),
    show_default=True,
    help="Rig file to write; its name becomes the rig's.",
)
@frame.overwrite_option("Replace the file if it exists.")
def command(
    recording: Path, like: str | None, columns: tuple[str, ...], output: Path, overwrite: bool
) -> frame.Result:
    """Write a rig file for RECORDING: the rig of the catalogue (`pamid rigs`) that its columns fit
    best, with these columns as inputs and outputs, in their units.

    A column is identified by its name, by a word of the name, or by its unit. An unscaled signal,
    such as a level in volts, gets a gain to fit. Comments in the file list the other columns. The
    values are those of the example, with wide priors: replace each value marked GUESS by yours.

    A rig file is code and is run when you name it. This command runs no code.
    """
    from pamid.api.new_rigs import new_rig
    from pamid.base.errors import UsageError

    columns_by_role = {}
    for text in columns:
        wanted, sign, separator = text.partition("=")
        if not sign or not wanted.strip() or not separator.strip():
            raise UsageError(
                f"--column {text!r} is not RIG_COLUMN=COLUMN.", "For example force_n=drive_v."
            )
        columns_by_role[wanted.strip()] = separator.strip()
    written = new_rig(
        recording, like=like, columns=columns_by_role, output=output, overwrite=overwrite
    )
    follow = (
        f"Next: pamid check {quoted(output)}   or   "
        f"pamid check {quoted(recording)} --rig {quoted(output)}   (both run that file)"
    )
    return frame.Result(written.to_dict(), f"{written.summary()}\n{follow}")
