"""`pamid diagnose`: Find where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pamid.api.options.estimating import DiagnosisArguments
from pamid.api.options.record import FilePath, option
from pamid.base.errors import quoted

from . import frame
from .fail_if import Condition, exit_code_of, fail_if_option
from .figures import require_png, write_figure
from .terminal import progress_line

if TYPE_CHECKING:
    from pamid.report.load import RunData

HELP_ORDER = 80
_WIDTH = 98  # characters of a line
_PLAIN = str.maketrans({"\u00a0": " ", "\u2212": "-", "→": "->"})  # for any terminal
_HOLD_HINT = (
    "(TOML next to the recording: [known] fixes a parameter, [free] releases a fixed parameter)"
)
EXAMPLE = """
pamid diagnose rec.csv --rig one-dof --output run --jobs 2
"""


@dataclass(frozen=True, kw_only=True)
class Arguments(DiagnosisArguments):
    __doc__ = DiagnosisArguments.__doc__

    figure: FilePath | None = option(
        None,
        "PNG to draw: the rig as a block diagram, with the shares of the gap and the identified "
        "effects; below it the residual over the contribution of the leading candidates.",
    )
    conditions: Sequence[Condition] = fail_if_option(
        "'remainder > 0.3' (share of the gap that no cause explains, 0 without a structural gap), "
        "'probability > 0.9' (of the leading cause), or the held-out error of a channel with the "
        "causes, as 'angle_deg > 0.1'"
    )
    overwrite: bool = option(False, "Replace an earlier run in that folder, and the figure.")


@frame.command("diagnose", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.diagnosing import diagnose

    figure = arguments.figure
    require_png(figure, arguments.overwrite or arguments.resume)
    with progress_line("diagnose") as progress:
        run = diagnose.of(frame.reporting(arguments, progress))
    content, text = run.to_dict(), diagnosis_text(run.data, run.folder)
    if figure is not None:
        text, line, follow = text.rpartition("\nNext: ")  # what to do next stays the last line
        text += f"\n{write_figure(figure, run.overview_png())}{line}{follow}"
    code = exit_code_of(arguments.conditions, _figures(content), 6 if run.failed_jobs else 0)
    return frame.Result(content, text, code)


def _figures(diagnosis: dict[str, Any]) -> dict[str, float | None]:
    """Figures for --fail-if: the share that remains, the probability of the leading cause, and
    the error of every channel with the causes."""
    causes, rest = diagnosis["causes"], diagnosis["remainder"]
    gap = diagnosis["verdict"] != "no-structural-gap"
    return {
        "remainder": rest["share"] if gap and rest else 0.0,
        "probability": causes[0]["probability"] if causes else 0.0,
        **{channel: reach["mae_with_cause"] for channel, reach in diagnosis["how_far"].items()},
    }


def diagnosis_text(run: RunData, output: Path) -> str:
    """The answers, the ranking and the next command, as text.

    If the recordings do not depend on the model, the text states only that and the errors.
    """
    from pamid.report.answers import answers_of, tables_of
    from pamid.report.channel_errors import errors_of, mae_text

    diagnosis, rows = run.diagnosis, errors_of(run)
    assert diagnosis is not None
    lines = [*_wrapped(diagnosis.sentence), ""]
    if not diagnosis.remark:
        for answer in answers_of(run, rows):
            first, points = len(lines), (f"- {point}" for point in answer.points)
            for text in (answer.lead, *answer.details, *points):
                lines += _wrapped(text, 17 * " ")
            lines[first] = f"{answer.question:17s}{lines[first].strip()}"
        lines += [_HOLD_HINT, "", *tables_of(diagnosis)]
    lines.append(mae_text(rows))
    if not diagnosis.remark:
        notes = (note for note in diagnosis.notes if note != diagnosis.withheld)
        for note in notes:
            lines += _wrapped(note, 10 * " ", "Note      ")
    for failed in diagnosis.failed_jobs or ():
        lines += _wrapped(f"{failed.job}: {failed.why}", 10 * " ", "Failed    ")
    return "\n".join([*lines, f"Next: pamid report {quoted(output)}"]).translate(_PLAIN)


def _wrapped(text: str, indent: str = "", first: str | None = None) -> list[str]:
    """Lines of a sentence, as wide as the tables at most."""
    return textwrap.wrap(
        text.translate(_PLAIN),
        _WIDTH,
        initial_indent=indent if first is None else first,
        subsequent_indent=indent,
        break_on_hyphens=False,
        break_long_words=False,
    )
