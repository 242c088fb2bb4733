"""`pamid power`: Predict which effects an experiment would show, before any measurement."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .options import (
    figure_option,
    jobs_option,
    noise_factor,
    parse_known,
    require_png,
    rig_words,
    seed_option,
    write_figure,
)
from .terminal import progress_line, quoted

HELP_ORDER = 22
EXAMPLE = """
pamid power --rig one-dof --excitation excitation.csv --figure power.png
"""


@frame.command("power", example=EXAMPLE)
@click.option(
    "--rig",
    help="Rig by name, or the path of a file: a rig file (it is run), a MuJoCo or URDF model, "
    "or an FMU (its binary is run). "
    "[default: the rig that the excitation names, else one-dof]",
)
@click.option(
    "--excitation",
    type=click.Path(path_type=Path),
    required=True,
    help="CSV with time_s and the planned inputs.",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="Path of an effect file to try in addition to the catalogue (it is run).",
)
@click.option(
    "--known",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter that the recording would state as known.",
)
@click.option(
    "--noise",
    default="default",
    show_default=True,
    help="default | FACTOR on the noise of the rig's sensors.",
)
@seed_option("Same seed, same noise.")
@jobs_option()
@figure_option("effects by size")
@frame.overwrite_option("Replace the figure if it exists.")
def command(
    rig: str | None,
    excitation: Path,
    effects: tuple[str, ...],
    known: tuple[str, ...],
    noise: str,
    seed: int,
    jobs: int,
    figure: Path | None,
    overwrite: bool,
) -> frame.Result:
    """Predict, before measuring, which effects this experiment would show: from which size on, by
    which single sensor, and which effects it would confuse.

    The experiment is simulated on the rig of the data sheet with the noise of its sensors. An
    effect is detectable if the error of the refitted model exceeds the noise floor by 10 %. The
    part of the effect that parameters and tolerances can absorb does not count. Real machines have
    further irregularities, which are not simulated: read the smallest sizes as the best case.
    """
    from pamid.api.planning import power

    require_png(figure, overwrite)
    with progress_line("power") as progress:
        result = power(
            excitation,
            rig,
            effects=effects,
            known=parse_known(known),
            noise=noise_factor(noise),
            seed=seed,
            jobs=jobs,
            progress=progress,
        )
    text = result.summary()
    if figure is not None:
        text += f"\n\n{write_figure(figure, result.picture())}"
    follow = f"pamid simulate --excitation {quoted(excitation)} {rig_words(rig or result.rig)}"
    return frame.Result(result.to_dict(), f"{text}\nNext: {follow} --output rec.csv")
