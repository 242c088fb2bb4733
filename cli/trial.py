"""`pamid trial`: the blind trial of the diagnosis."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .progress import Progress

if TYPE_CHECKING:
    from pamid.run import Run

EXAMPLE = """
pamid trial --output trial --cases 4 --part calibration --jobs 2
"""


@frame.command("trial", example=EXAMPLE)
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), required=True,
              help="Folder of the trial; one that was begun goes on.")
@click.option("--rig", type=click.Choice(["one-dof", "two-link"]), default="one-dof", show_default=True,
              help="The machine to try it on: one joint, or an arm of two links.")
@click.option("--cases", type=click.IntRange(1, 100_000), default=200, show_default=True, help="Cases to draw.")
@click.option("--part", type=click.Choice(["test", "calibration"]), default="test", show_default=True,
              help="Thresholds may be set on calibration cases, never on test cases.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Same seed, same cases.")
@click.option("--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes to use.")
@click.option("--only", type=click.Choice(["single", "double", "no-gap", "withheld", "nameless"]), default=None,
              help="Of the cases drawn only this stratum.")
@click.option("--calibrate", type=click.Path(dir_okay=False, path_type=Path), default=None,
              help="Write what the finished calibration cases of the one-dof teach (pamid/diagnosis/calibration.json) "
                   "to this file.")
def command(output: Path, rig: str, cases: int, part: str, seed: int, jobs: int, only: str | None,
            calibrate: Path | None) -> frame.Result:
    """Try the diagnosis on a virtual machine built on other equations than its own: one effect, two, none, one taken
    out of the catalogue, one that never was in it. It sees recordings only; the scorer alone opens the labels.

    On the arm a fault also has a place: one of two joints, one of four muscles, or all of them. What the diagnosis
    says of probabilities was learned on the one-dof.

    Writes labels.json, a result per case and trial.json. The same command on the same folder goes on where it was
    interrupted; after a change of pamid itself take a new folder.
    """
    from pamid.errors import UsageError
    from pamid.run import write_json
    from pamid.trial.calibrate import calibrated_from
    from pamid.trial.table import trial_text
    from pamid.trial.work import run_trial

    if calibrate is not None and part != "calibration":
        raise UsageError("--calibrate: only the calibration part may teach the judgement", "add --part calibration")
    if calibrate is not None and rig != "one-dof":
        raise UsageError(f"--calibrate: the judgement is taught by the one-dof, not by {rig}", "leave out --rig")
    fixed = {"part": part, "seed": seed} if rig == "one-dof" else {"rig": rig, "part": part, "seed": seed}
    run = _begun(output, fixed, {"cases": cases, "only": only})
    try:
        with Progress("trial") as progress:
            found = run_trial(output, part, cases, seed, rig=rig, only=only or "", jobs=jobs,
                              done=lambda i, n: progress.update(i, f"{i} of {n} cases"))
    except BaseException as error:
        run.finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
        raise
    if calibrate is not None:
        write_json(calibrate, calibrated_from(output))
    failed = bool(found["failures"])
    run.finish("partial" if failed else "done")
    return frame.Result(found, trial_text(found), 6 if failed else 0)


def _begun(output: Path, fixed: dict[str, Any], options: dict[str, Any]) -> Run:
    """The trial's folder, new or gone on with; FileError if it holds another trial or no trial at all."""
    from pamid.errors import FileError
    from pamid.run import Run

    if not (output / "run.json").is_file():
        return Run.create(output, command=sys.argv, seed=fixed["seed"], options={"trial": fixed, **options})
    run = Run.open(output)
    held = run.record["options"].get("trial")
    if held != fixed:
        what = "no trial" if held is None else (
            f"the trial of {held.get('rig', 'one-dof')}, part {held['part']}, seed {held['seed']}")
        raise FileError(f"{output} is taken: it holds {what}", "give --output another folder", code="run-folder")
    run.begin_step(command=sys.argv, seed=fixed["seed"], options=options)
    return run
