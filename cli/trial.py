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

HELP_ORDER = 100
EXAMPLE = """
pamid trial --output trial --cases 4 --part calibration --jobs 2
"""


@frame.command("trial", example=EXAMPLE)
@run_output_option("trial-run", "Folder of the trial.")
@click.option(
    "--rig",
    default="one-dof",
    show_default=True,
    help="Rig of the virtual machine, by name or by the path of a rig file (it is run). Machines "
    f"with separate equations exist for {names.listed(names.machines())}; for any other rig the "
    "machine is built from the rig.",
)
@click.option(
    "--excitation",
    type=click.Path(path_type=Path),
    help="CSV with the inputs of a machine that is built from the rig. [default: random levels in "
    "the rig's usual range]",
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
    help="Compute share I of COUNT of the cases, without scores.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Continue the trial in the folder; finished cases are reused.",
)
@frame.overwrite_option("Replace an earlier trial in that folder: all cases are computed again.")
@click.option(
    "--only",
    type=click.Choice(["single", "double", "no-gap", "withheld", "nameless"]),
    default=None,
    help="Keep only this stratum of the drawn cases.",
)
@click.option(
    "--world",
    type=click.Choice(["closed", "open"]),
    default="closed",
    show_default=True,
    help="closed: the planted effects are the whole gap. open: one or two further effects act, "
    "maps are rougher than the rig states, and the logger is poor.",
)
@click.option(
    "--bare",
    is_flag=True,
    help="Ignore the tolerances (background) that the rig states for its machine.",
)
@click.option(
    "--calibrate",
    type=click.Path(dir_okay=False, path_type=Path),
    default=None,
    help="Write the calibration from the finished calibration cases to this file, in the format of "
    "pamid/diagnosis/calibration.json.",
)
@click.option(
    "--also",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    multiple=True,
    help="With --calibrate: also use the trial in this folder, of the same or another rig.",
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
    """Test the diagnosis on a virtual machine with other equations than the rig's. A case has one
    effect, two, none, one that was removed from the catalogue, or one that never was in it. The
    diagnosis reads recordings only, and the scorer alone reads the labels.

    On the arm a fault also has a place: one of two joints, one of four muscles, or all of them. On
    a starter rig the place is one of the rig's ports, and the loop is open. The probabilities of
    the diagnosis were calibrated on the calibration parts.

    --world open draws cases like real machines. One or two further effects of other families each
    change the readings by 10 to 60 % as much as the planted one. Map errors exceed the rig's
    tolerance, noise is coloured, the clock jitters, a coarse gauge has a calibration curve, and a
    recording starts in motion. A second recording is held out. An answer is right if it names the
    effect that removes most, reports what remains and where, and claims no more than it removes.

    With --excitation, for a rig file, and for a rig without a separate machine, the machine is
    built from the rig. Its parameters are drawn from their priors. Its ports have a roughness of
    0.5 to 4 %, its readings are noisy and coarse, and planted effects have other forms than in the
    catalogue. This measures how well effects can be separated on your rig, not the influence of
    wrong equations.

    Writes labels.json, one result per case and trial.json. With --resume the same command on the
    same folder continues where it was interrupted, or draws more cases. Use a new folder after a
    change of pamid itself.

    To use many computers without a Dask cluster, let a batch system call the command with --index,
    then score once without:

    \b
      sbatch --array=1-20 --wrap \\
        'pamid trial --output trial --jobs 1 --index $SLURM_ARRAY_TASK_ID/20'
      pamid trial --output trial --resume

    All computers must have access to the folder. A failed share can be repeated, or left to the
    last command, which computes all missing cases.
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
    """Machine built from a rig, or the name of a machine."""
    from pamid.recording.recording import read_recording
    from pamid.trial.own_machine import machine_given

    return machine_given(rig, None if excitation is None else read_recording(excitation))


def _require_calibration(part: str) -> None:
    """Raise UsageError unless the cases are for calibration: test cases must not set thresholds."""
    from pamid.base.errors import UsageError

    if part != "calibration":
        raise UsageError(
            "--calibrate needs the calibration part of the cases.",
            "Add --part calibration.",
        )


def _share_of(index: str) -> tuple[int, int]:
    from pamid.base.errors import UsageError

    first, slash, count = index.partition("/")
    if not (slash and first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count)):
        raise UsageError(
            f"--index {index!r} is not a share.",
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
    """Compute every COUNT-th case from the I-th on; the command without --index writes labels and
    scores."""
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
    """Command that scores the shares: the same trial without --index."""
    words = [
        f"--{name}" if value is True else f"--{name} {quoted(str(value))}"
        for name, value in options.items()
        if value is not None and name != "machine"
    ]
    return " ".join(["pamid trial", *words, f"--output {quoted(output)} --resume"])


def _begun(
    output: Path, fixed: dict[str, Any], options: dict[str, Any], inputs: list[Path], resume: bool
) -> Run:
    """Folder of the trial, new or continued; FileError if it contains another trial or none."""
    from pamid.base.errors import FileError
    from pamid.base.run_folder import Run

    if not (output / "run.json").is_file():
        return _made(output, fixed, options, inputs)
    run = _same(Run.open(output), fixed)
    if not resume:
        raise FileError(
            f"{output} already contains this trial, or a part of it.",
            "Continue it with --resume, replace it with --overwrite, or give another --output.",
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
    """New folder of a trial."""
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
    """Folder of the trial, cleared of an earlier trial; FileError if it contains anything else."""
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
    """Raise UsageError for contradictory options about the folder."""
    from pamid.base.errors import UsageError

    if overwrite and (resume or index is not None):
        raise UsageError(
            f"--overwrite replaces the earlier trial, {'--resume' if resume else '--index'} "
            "continues it.",
            "Give only one of them.",
        )


def _joined(
    output: Path, fixed: dict[str, Any], options: dict[str, Any], inputs: list[Path]
) -> Run:
    """Folder of the trial for one of several commands that start at the same time."""
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
            f"{run.folder} is in use: it contains {what}.",
            "Give another folder with --output.",
            code="run-folder",
        )
    return run
