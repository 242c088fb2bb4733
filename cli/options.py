"""Options that several commands share: recordings, run folder, NAME=VALUE pairs, noise factors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .frame import PACKAGES
from .terminal import quoted


def parse_known(
    pairs: tuple[str, ...], hint: str = "For example inertia_kg_m2=0.0896."
) -> dict[str, float]:
    """("inertia_kg_m2=0.0896", ...) as a table; hint: example for the error message."""
    from pamid.base.errors import UsageError

    table = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        try:
            table[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise UsageError(f"{pair!r} is not NAME=VALUE with a number.", hint)
    return table


def noise_factor(text: str) -> float:
    """default -> 1, none -> 0, a number as it is."""
    from pamid.base.errors import UsageError

    words = {"default": 1.0, "none": 0.0}
    try:
        factor = words[text] if text in words else float(text)
    except ValueError:
        factor = -1.0
    if factor < 0.0:
        raise UsageError(f"--noise {text!r}: it takes default, none or a factor of at least 0.")
    return factor


def seed_option(what: str, default: int = 0) -> Callable[..., Any]:
    """The --seed option; what: its help."""
    return click.option(
        "--seed", type=click.IntRange(0), default=default, show_default=True, help=what
    )


def jobs_option(what: str = "Processes to use.", default: int = 2) -> Callable[..., Any]:
    """The --jobs option, a number of processes."""
    return click.option(
        "--jobs", type=click.IntRange(1, 256), default=default, show_default=True, help=what
    )


def figure_option(what: str) -> Callable[..., Any]:
    """The --figure option; what: content of the PNG, for the help."""
    return click.option(
        "--figure",
        type=click.Path(dir_okay=False, path_type=Path),
        help=f"PNG to draw: {what}.",
    )


def require_png(figure: Path | None, overwrite: bool) -> None:
    """Check the path of a figure before any work.

    Raises UsageError unless it ends in .png, and FileError if it exists and may not be replaced.
    """
    from pamid.base.files import require_new

    require_png_name(figure)
    require_new([figure] if figure else [], overwrite, "--figure")


def require_png_name(figure: Path | None) -> None:
    """Raise UsageError unless the path of a figure ends in .png."""
    from pamid.base.errors import UsageError

    if figure is not None and figure.suffix.lower() != ".png":
        raise UsageError(
            f"--figure {figure}: the figure is written as PNG.",
            f"Write --figure {quoted(figure.with_suffix('.png'))}.",
        )


def write_figure(figure: Path, png: bytes) -> str:
    """Write a figure and its folder, and return a line about it."""
    from pamid.base.files import make_folder, write_atomically

    make_folder(figure.parent)
    write_atomically(figure, png)
    return f"Figure: {figure}"


def rig_words(rig: str | Path) -> str:
    """--rig and the --package options of this command, for a command line to copy."""
    ctx = click.get_current_context(silent=True)
    pairs = ctx.meta.get(PACKAGES, ()) if ctx else ()
    return " ".join([f"--rig {quoted(rig)}", *(f"--package {quoted(pair)}" for pair in pairs)])


no_check_option = click.option(
    "--no-check",
    is_flag=True,
    help="Fit the recordings even if `pamid check` finds faults for this rig.",
)


def run_output_option(default: str, what: str = "Run folder to create.") -> Callable[..., Any]:
    """The --output option of a command that creates a folder."""
    return click.option(
        "--output",
        type=click.Path(file_okay=False, path_type=Path),
        default=Path(default),
        show_default=True,
        help=what,
    )


def recording_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options for the fitted and held-out recordings and their rig."""
    for option in (
        click.option(
            "--held-out",
            multiple=True,
            type=click.Path(path_type=Path),
            help="Recording to score on, not used for the fit. [default: the last 30 % of every "
            "recording; 30 % in several parts if the recording rests for part of its length]",
        ),
        click.option(
            "--rig",
            help="Rig by name, or the path of a file: a rig file (it is run), a MuJoCo or URDF "
            "model, or an FMU (its binary is run). "
            "[default: the rig that the recordings name, else one-dof]",
        ),
        click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path)),
    ):
        function = option(function)
    return function
