"""`pamid check`: Say what is wrong with a recording, rig or effect, before any fitting."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .options import figure_option, require_png, write_figure

PLACE = 40
EXAMPLE = """
pamid check rec.csv --rig one-dof --figure card.png
"""
WRONG = 3


@frame.command("check", example=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--rig", help="Rig (name or file) the recording is meant for. [default: the one its TOML names]"
)
@figure_option(
    "every channel of a recording, with the places of each finding; a rig as a block diagram of "
    "its ports"
)
@frame.overwrite_option("Replace the figure if it exists.", formerly_force=True)
def command(file: Path, rig: str | None, figure: Path | None, overwrite: bool) -> frame.Result:
    """Say what is in FILE and everything that is wrong with it: a recording, a rig file, an effect
    file or a MuJoCo or URDF model.

    A recording (.csv): sampling, range, rest, noise and step of every column; what is clipped,
    frozen, lost, bridged, spiked, coarse or hardly excited; with a rig, columns exchanged, of the
    opposite sign, in another unit or late, inputs beyond their range, and whether each input is
    held or linear between samples. A rig (.py): its equations build, every port is used, nothing
    blows up over the bounds, sensitivities are exact; for every port what passes, its sign, which
    effects can act there and which others each further signal would let act. A model (.xml, .urdf):
    the same, after how it goes and what of it is left out, by element and line. An effect (.py):
    its data sheet is complete, its null is exact, and it behaves wherever it fits. Exit code 3 if
    anything is wrong; notes leave it at 0.
    """
    from pamid.api.checking import check
    from pamid.base.errors import UsageError

    require_png(figure, overwrite)
    found = check(file, rig)
    said, text = found.to_dict(), found.summary()
    if figure is not None and found.kind not in ("recording", "rig"):
        raise UsageError(
            "--figure draws recordings and rigs.", f"Leave it out: {file} holds neither."
        )
    if figure is not None and found.drawable:
        text = f"{text}\n{write_figure(figure, found.plot_png())}"
        said = {**said, "figure": str(figure)}
    return frame.Result(said, text, 0 if found.ok else WRONG)
