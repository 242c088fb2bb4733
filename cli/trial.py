"""`pamid trial`: The blind trial of the diagnosis: drawn cases with hidden labels, scored."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame, names
from .job import cluster_option, failed_text
from .options import jobs_option, run_output_option, seed_option
from .terminal import progress_line, quoted

if TYPE_CHECKING:
    from pamid.base.run_folder import Run
    from pamid.parallel.jobs import WorkerPool
    from pamid.trial.own_machine import OwnMachine

PLACE = 100
EXAMPLE = """
pamid trial --output trial --cases 4 --part calibration --jobs 2
"""


@frame.command("trial", example=EXAMPLE)
@run_output_option("trial-run", "Folder of the trial.")
@click.option(
    "--rig",
    default="one-dof",
    show_default=True,
    help="The rig whose machine it is tried on, or the path of a rig file (it is run). Machines "
    f"with equations of their own stand for {names.listed(names.machines())}; of any other rig one "
    "is made.",
)
@click.option(
    "--excitation",
    type=click.Path(path_type=Path),
    help="CSV with what is sent to a machine that is made of the rig. [default: random levels over "
    "what the rig calls usual]",
)
@click.option(
    "--cases",
    type=click.IntRange(1, 100_000),
    default=200,
    show_default=True,
    help="Cases to draw.",
)
@click.option(
    "--part",
    type=click.Choice(["test", "calibration"]),
    default="test",
    show_default=True,
    help="Thresholds may be set on calibration cases, never on test cases.",
)
@seed_option("Same seed, same cases.")
@jobs_option()
@cluster_option
@click.option(
    "--index",
    metavar="I/COUNT",
    help="Work through share I of COUNT of the cases, and score nothing.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with the trial in the folder: cases that are finished stay.",
)
@frame.overwrite_option("Replace an earlier trial in that folder: all cases are run anew.")
@click.option(
    "--only",
    type=click.Choice(["single", "double", "no-gap", "withheld", "nameless"]),
    default=None,
    help="Of the cases drawn only this stratum.",
)
@click.option(
    "--world",
    type=click.Choice(["closed", "open"]),
    default="closed",
    show_default=True,
    help="closed: what is planted is the whole gap. open: one or two further effects act as well, "
    "maps are rougher than the rig states and the logger is a poor one.",
)
@click.option(
    "--bare",
    is_flag=True,
    help="Take away what the rig states of its machine's tolerances (background).",
)
@click.option(
    "--calibrate",
    type=click.Path(dir_okay=False, path_type=Path),
    default=None,
    help="Write what the finished calibration cases teach "
    "(pamid/diagnosis/calibration.json) to this file.",
)
@click.option(
    "--also",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    multiple=True,
    help="With --calibrate: learn from the trial in this folder, too, of the same or another rig.",
)
def command(
    output: Path,
    rig: str,
    excitation: Path | None,
    cases: int,
    part: str,
    seed: int,
    jobs: int,
    cluster: str | None,
    index: str | None,
    resume: bool,
    overwrite: bool,
    only: str | None,
    world: str,
    bare: bool,
    calibrate: Path | None,
    also: tuple[Path, ...],
) -> frame.Result:
    """Try the diagnosis on a virtual machine built on other equations than its own: one effect,
    two, none, one taken out of the catalogue, one that never was in it. It sees recordings only;
    the scorer alone opens the labels.

    On the arm a fault also has a place: one of two joints, one of four muscles, or all of them;
    behind a starter rig it is one of the rig's ports, and the loop is open. What the diagnosis says
    of probabilities was learned from the calibration parts.

    --world open draws cases like real machines: besides the planted effect one or two further ones
    of other families, each changing the readings by 10 to 60 % as much, map errors beyond the
    rig's tolerance, coloured noise, a jittering clock, a coarse gauge behind a calibration curve,
    and a recording that starts in motion. A second recording is held out. An answer is right if it
    names what removes most, reports what remains and where, and claims no more than it removes.

    For a rig file, and for a rig without a machine of its own, or with --excitation, machines are
    made of the rig itself: its parameters drawn from their priors, a roughness of 0.5 to 4 % at its
    ports, noise and coarse readings, and what is planted in other forms than the catalogue's. That
    tells how well effects are told apart on your rig, not what becomes of wrong equations.

    Writes labels.json, a result per case and trial.json. With --resume the same command on the same
    folder goes on where it was interrupted, or draws more cases; after a change of pamid itself
    take a new folder.

    Many machines without a Dask cluster: let a batch system call it with --index, then score once
    without:

    \b
      sbatch --array=1-20 --wrap \\
        'pamid trial --output trial --jobs 1 --index $SLURM_ARRAY_TASK_ID/20'
      pamid trial --output trial --resume

    The folder has to be one that all of them see. A share that failed is sent again, or left to the
    last command, which works through whatever is missing.
    """
    from pamid.api.trial_cases import CaseSelection, run_trial
    from pamid.api.workers import worker_pool
    from pamid.base.json_file import write_json
    from pamid.model.registry import code_files
    from pamid.trial.calibration import calibration_json, learnt_text, lesson_of
    from pamid.trial.figure_table import trial_text

    if calibrate is not None:
        _require_calibration(part)
    _require_one_way(resume, overwrite, index)
    tried = _tried(rig, excitation)
    fixed: dict[str, Any] = {"part": part, "seed": seed, **({"bare": True} if bare else {})}
    if world != "closed":
        fixed["world"] = world
    if not isinstance(tried, str):
        fixed = {"rig": rig, "machine": tried.sha256, **fixed}
    elif rig != "one-dof":
        fixed = {"rig": rig, **fixed}
    options: dict[str, Any] = {"cases": cases, "only": only}
    if excitation is not None:
        options["excitation"] = str(excitation)
    inputs = [*code_files(rig, ()), *([] if excitation is None else [excitation])]
    with worker_pool(jobs, cluster) as pool:
        if index is not None:
            return _share(output, tried, fixed, options, inputs, _share_of(index), pool)
        run = (
            _replaced(output, fixed, options, inputs)
            if overwrite
            else _begun(output, fixed, options, inputs, resume)
        )
        try:
            with progress_line("trial", cases) as progress:
                scores = run_trial(
                    output,
                    CaseSelection(part, cases, seed, tried, only or "", bare, world),
                    pool,
                    done=lambda i, n: progress.update(i, "cases", n),
                )
        except BaseException as error:
            run.finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
            raise
    lines = [trial_text(scores)]
    if calibrate is not None:
        lessons = [lesson_of(folder) for folder in (output, *also)]
        write_json(calibrate, calibration_json(lessons))
        lines.append(learnt_text(lessons))
    failed = bool(scores["failed_jobs"])
    run.finish("partial" if failed else "done")
    return frame.Result(scores, "\n".join(lines), 6 if failed else 0)


def _tried(rig: str, excitation: Path | None) -> str | OwnMachine:
    """The machine, or its name."""
    from pamid.recording.recording import read_recording
    from pamid.trial.own_machine import machine_given

    return machine_given(rig, None if excitation is None else read_recording(excitation))


def _require_calibration(part: str) -> None:
    """UsageError for cases of another part: they would judge themselves."""
    from pamid.base.errors import UsageError

    if part != "calibration":
        raise UsageError(
            "--calibrate: only the calibration part may teach the judgement",
            "add --part calibration",
        )


def _share_of(index: str) -> tuple[int, int]:
    from pamid.base.errors import UsageError

    first, slash, count = index.partition("/")
    if not (slash and first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count)):
        raise UsageError(
            f"--index {index!r} is no share",
            "Give --index I/COUNT, I from 1 to COUNT: --index 3/20.",
        )
    return int(first), int(count)


def _share(
    output: Path,
    tried: str | OwnMachine,
    fixed: dict[str, Any],
    options: dict[str, Any],
    inputs: list[Path],
    share: tuple[int, int],
    pool: WorkerPool,
) -> frame.Result:
    """Work through every COUNT-th case from the I-th on; labels and score are left to the command
    without --index."""
    from pamid.api.trial_cases import CaseSelection, run_cases
    from pamid.schemas.trial_case_files import TrialShare
    from pamid.trial.scoring import failed_jobs

    _joined(output, fixed, options, inputs)
    number, count = share
    every_case = CaseSelection(
        fixed["part"],
        options["cases"],
        fixed["seed"],
        tried,
        options["only"] or "",
        fixed.get("bare", False),
        fixed.get("world", "closed"),
    ).draw()
    cases = every_case[number - 1 :: count]
    with progress_line("trial", len(cases)) as progress:
        results = run_cases(cases, output, pool, done=lambda i, n: progress.update(i, "cases", n))
    failed = failed_jobs(results)
    content = TrialShare(
        index=number, of=count, cases=tuple(c.number for c in cases), failed_jobs=failed
    ).as_json()
    text = [
        f"{len(cases)} of {len(every_case)} cases (share {number} of {count}).",
        *failed_text(content),
        f"When all shares are finished: {_scoring(output, fixed | options)}",
    ]
    return frame.Result(content, "\n".join(text), 6 if failed else 0)


def _scoring(output: Path, options: dict[str, Any]) -> str:
    """The line that scores what the shares have worked through: the same trial without --index."""
    words = [
        f"--{name}" if value is True else f"--{name} {quoted(str(value))}"
        for name, value in options.items()
        if value is not None and name != "machine"
    ]
    return " ".join(["pamid trial", *words, f"--output {quoted(output)} --resume"])


def _begun(
    output: Path, fixed: dict[str, Any], options: dict[str, Any], inputs: list[Path], resume: bool
) -> Run:
    """The trial's folder, new or gone on with; FileError if it holds another trial or no trial at
    all."""
    from pamid.base.errors import FileError
    from pamid.base.run_folder import Run

    if not (output / "run.json").is_file():
        return _made(output, fixed, options, inputs)
    run = _same(Run.open(output), fixed)
    if not resume:
        raise FileError(
            f"{output} is taken: it already holds this trial, or a part of it.",
            "Go on with it by --resume, replace it by --overwrite, or give another --output.",
            code="run-folder",
        )
    run.begin_step(command=frame.command_line(), seed=fixed["seed"], options=options)
    return run


def _made(
    output: Path,
    fixed: dict[str, Any],
    options: dict[str, Any],
    inputs: list[Path],
    *,
    overwrite: bool = False,
) -> Run:
    """A new folder of a trial."""
    from pamid.base.run_folder import Run

    return Run.create(
        output,
        command=frame.command_line(),
        seed=fixed["seed"],
        inputs=inputs,
        options={"trial": fixed, **options},
        overwrite=overwrite,
    )


def _replaced(
    output: Path, fixed: dict[str, Any], options: dict[str, Any], inputs: list[Path]
) -> Run:
    """The trial's folder, without what an earlier trial has left in it; FileError if it holds
    anything else."""
    from pamid.api.trial_cases import forget_cases
    from pamid.base.run_folder import Run

    if (output / "run.json").is_file():
        earlier = Run.open(output)
        held = earlier.record["options"].get("trial")
        _same(earlier, held if isinstance(held, dict) else fixed)
    run = _made(output, fixed, options, inputs, overwrite=True)
    forget_cases(output)
    return run


def _require_one_way(resume: bool, overwrite: bool, index: str | None) -> None:
    """UsageError for two words about one folder."""
    from pamid.base.errors import UsageError

    if overwrite and (resume or index is not None):
        raise UsageError(
            f"--overwrite replaces the earlier trial, {'--resume' if resume else '--index'} goes "
            "on with it.",
            "Give one of them.",
        )


def _joined(
    output: Path, fixed: dict[str, Any], options: dict[str, Any], inputs: list[Path]
) -> Run:
    """The trial's folder for one of several that begin it at the same time."""
    from pamid.base.errors import FileError
    from pamid.base.run_folder import Run

    for _ in range(50):
        if (output / "run.json").is_file():
            break
        try:
            run = _made(output, fixed, options, inputs)
            run.finish("shared")
            return run
        except FileError:  # another one may be about to write run.json
            time.sleep(0.1)
    return _same(Run.open(output), fixed)


def _same(run: Run, fixed: dict[str, Any]) -> Run:
    from pamid.base.errors import FileError

    held = run.record["options"].get("trial")
    if held != fixed:
        what = (
            "no trial"
            if not isinstance(held, dict)
            else (
                f"the trial of {held.get('rig', 'one-dof')}, part {held.get('part')}, seed "
                f"{held.get('seed')}"
            )
        )
        raise FileError(
            f"{run.folder} is taken: it holds {what}",
            "give --output another folder",
            code="run-folder",
        )
    return run
