"""`pamid score`: Score the models of a run on new recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .fail_if import Condition, exit_code_of, fail_if_option
from .terminal import aside, quoted, staged_progress

HELP_ORDER = 65
EXAMPLE = """
pamid score fitted new-1.csv new-2.csv
pamid score fitted new-1.csv --fail-if "angle_deg > 0.1"
"""


@frame.command("score", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--rig", help="Path of the run's rig file, if it has one (it is run if it is unchanged)."
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="Path of an effect file of the run (it is run if it is unchanged).",
)
@fail_if_option(
    "the mean absolute error of a channel, as 'angle_deg > 0.1', of the run's best model, largest "
    "over the recordings"
)
def command(
    run: Path,
    recordings: tuple[Path, ...],
    rig: str | None,
    effects: tuple[str, ...],
    conditions: tuple[Condition, ...],
) -> frame.Result:
    """Score the models of the run folder RUN on new RECORDINGS: data sheet, refitted, with the
    causes, with the network.

    Prints mean absolute errors, and root mean squares in brackets, per recording and channel. Known
    values of a recording (an inertia, a payload) are used. The errors are those of a replay on the
    recorded command, in the windows of a fit, and, in closed loop, under the controller as well. A
    recording that the run used for fit or score is refused.
    """
    from pamid.api.run_scores import score

    with staged_progress("score"):
        result = score(
            run,
            list(recordings),
            rig=rig,
            effects=effects,
            warn=lambda text: aside(f"Warning: {text}"),
        )
    content = result.to_dict()
    return frame.Result(
        content,
        f"{result.summary()}\nNext: pamid report {quoted(run)}",
        exit_code_of(conditions, _largest_errors(content)),
    )


def _largest_errors(score: dict[str, Any]) -> dict[str, float | None]:
    """Channel -> largest mean absolute error of the most complete model over the recordings; None
    if that model became unstable."""
    largest: dict[str, float | None] = {}
    for row in score["recordings"]:
        model = next(name for name in reversed(score["models"]) if name in row["mae"])
        error, before = row["mae"][model], largest.get(row["channel"], 0.0)
        largest[row["channel"]] = None if error is None or before is None else max(error, before)
    return largest
