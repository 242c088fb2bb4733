"""`pamid score`: Score the models of a run on new recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pamid.api.options.simulating import ScoreArguments
from pamid.base.errors import quoted

from . import frame
from .fail_if import Condition, exit_code_of, fail_if_option
from .terminal import staged_progress

HELP_ORDER = 65
EXAMPLE = """
pamid score fitted new-1.csv new-2.csv
pamid score fitted new-1.csv --fail-if "angle_deg > 0.1"
"""


@dataclass(frozen=True, kw_only=True)
class Arguments(ScoreArguments):
    __doc__ = ScoreArguments.__doc__

    conditions: Sequence[Condition] = fail_if_option(
        "the mean absolute error of a channel, as 'angle_deg > 0.1', of the run's best model, "
        "largest over the recordings"
    )


@frame.command("score", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.scoring import score

    with staged_progress("score") as progress:
        result = score.of(frame.reporting(arguments, progress))
    content = result.to_dict()
    # of the most complete model over the recordings; None where that model became unstable
    largest: dict[str, float | None] = {}
    for row in content["recordings"]:
        model = next(name for name in reversed(content["models"]) if name in row["mae"])
        error, before = row["mae"][model], largest.get(row["channel"], 0.0)
        largest[row["channel"]] = None if error is None or before is None else max(error, before)
    return frame.Result(
        content,
        f"{result.summary()}\nNext: pamid report {quoted(result.run)}",
        exit_code_of(arguments.conditions, largest),
    )
