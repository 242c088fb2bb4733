"""`pamid score`: Judge the models of a run on recordings it has not seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .fail_if import Condition, exit_code_of, fail_if_option
from .terminal import aside, quoted, told_progress

PLACE = 65
EXAMPLE = """
pamid score fitted new-1.csv new-2.csv
pamid score fitted new-1.csv --fail-if "angle_deg > 0.1"
"""


@frame.command("score", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--rig", help="Where the run was made with a rig file: its path (it is run, if it is the same)."
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="Path of an effect file that the run was made with (it is run, if it is the same).",
)
@fail_if_option(
    "the mean absolute error of a channel, as 'angle_deg > 0.1', by the run's best model in the "
    "recording where it is largest"
)
def command(
    run: Path,
    recordings: tuple[Path, ...],
    rig: str | None,
    effects: tuple[str, ...],
    conditions: tuple[Condition, ...],
) -> frame.Result:
    """Judge the models of the run folder RUN on RECORDINGS that it has not seen: data sheet,
    refitted, with the causes, with the network.

    Mean absolute errors, and root mean squares in brackets, per recording and channel, with what
    the recording states as known (an inertia, a payload): in replay, on the recorded command in
    windows as a fit has them, and under the controller where one ran. A recording that the run was
    fitted to or judged by is refused.
    """
    from pamid.api.run_scores import score

    with told_progress("score"):
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
    """Channel -> largest mean absolute error over the recordings, of the most complete model that
    the recording has; None where that became unstable."""
    largest: dict[str, float | None] = {}
    for row in score["recordings"]:
        model = next(name for name in reversed(score["models"]) if name in row["mae"])
        error, before = row["mae"][model], largest.get(row["channel"], 0.0)
        largest[row["channel"]] = None if error is None or before is None else max(error, before)
    return largest
