"""`pamid runs`: List the runs below a folder with their results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pamid.api.options.record import AnyPath, argument
from pamid.base.errors import quoted

from . import frame

if TYPE_CHECKING:
    from pamid.base.schemas.command_files import RunSummary

HELP_ORDER = 115
EXAMPLE = """
pamid runs
pamid runs . --json
"""


@dataclass(frozen=True)
class Arguments:
    """List every run in FOLDER and below it [default: here]: command, recordings and result.

    A damaged run is listed with its fault. No code of a run is executed.
    """

    folder: AnyPath = argument(default=".", metavar="[FOLDER]")


@frame.command("runs", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.schemas.command_files import RunList
    from pamid.report.run_summaries import runs_below

    folder = Path(arguments.folder)
    runs = runs_below(folder)
    lines = [line for run in runs for line in _lines(run)] or [f"There is no run in {folder}."]
    diagnosed = [run for run in runs if run.kind in ("diagnosis", "fit")]
    if len(diagnosed) > 1:
        pair = " ".join(quoted(run.path) for run in diagnosed[:2])
        lines.append(f"Next: pamid report --compare {pair}")
    elif diagnosed:
        lines.append(f"Next: pamid report {quoted(diagnosed[0].path)}")
    return frame.Result(RunList(folder=str(folder), runs=tuple(runs)), "\n".join(lines))


def _lines(run_summary: RunSummary) -> list[str]:
    """Folder, command and time of a run, with its result in the next line."""
    when = run_summary.begun.replace("T", " ")[:16]
    about = [
        run_summary.command or run_summary.kind,
        run_summary.rig,
        ", ".join(run_summary.recordings[:3]),
        when,
    ]
    about += [run_summary.outcome if run_summary.outcome not in ("", "done") else ""]
    about += ["did not end" if run_summary.begun and not run_summary.outcome else ""]
    lines = [f"{run_summary.path}  ({'; '.join(filter(None, about))})"]
    return (
        [*lines, f"    {run_summary.sentence.replace(chr(160), ' ')}"]
        if run_summary.sentence
        else lines
    )
