"""`pamid trial`: The blind trial of the diagnosis: drawn cases with hidden labels, scored."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from pamid.api.options.names import machines
from pamid.api.options.record import (
    AnyPath,
    FilePath,
    FolderPath,
    RigName,
    cluster_option,
    jobs_option,
    option,
    seed_option,
)
from pamid.base.errors import FileError, UsageError, join_words, quoted

from . import frame
from .terminal import failed_text, progress_line

if TYPE_CHECKING:
    from pamid.api.trial_cases import CaseSelection
    from pamid.base.parallel.jobs import WorkerPool
    from pamid.base.run_folder import Run

HELP_ORDER = 100
EXAMPLE = """
pamid trial --output trial --cases 4 --part calibration --jobs 2
"""


@dataclass(frozen=True)
class Arguments:
    """Test the diagnosis on a virtual machine with other equations than the rig's. A case has a
    single effect, two, none, an effect that was removed from the catalogue, or an effect that never
    was in it. The diagnosis reads recordings only, and the scorer alone reads the labels.

    On the arm a fault also has a place: either joint, any of four muscles, or all of them. On
    a starter rig the place is a port of the rig, and the loop is open. The probabilities of
    the diagnosis were calibrated on the calibration parts.

    --world open draws cases like real machines. Up to two further effects of other families each
    change the readings by 10 to 60 % as much as the planted effect. Map errors exceed the rig's
    tolerance, noise is coloured, the clock jitters, a coarse gauge has a calibration curve, and a
    recording starts in motion. A second recording is held out. An answer is right if it names the
    effect that removes most, reports what remains and where, and claims no more than it removes.

    With --excitation, for a rig file, and for a rig without a separate machine, the machine is
    built from the rig. Its parameters are drawn from their priors. Its ports have a roughness of
    0.5 to 4 %, its readings are noisy and coarse, and planted effects have other forms than in the
    catalogue. This measures how well effects can be separated on your rig, not the influence of
    wrong equations.

    Writes labels.json, a result per case and trial.json. With --resume the same command on the
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

    output: FolderPath = option("trial-run", "Folder of the trial.")
    rig: RigName = option(
        "one-dof",
        "Rig of the virtual machine, by name or by the path of a rig file (it is run). Machines "
        f"with separate equations exist for {join_words(machines(), 'or')}; for any other rig the "
        "machine is built from the rig.",
    )
    excitation: AnyPath | None = option(
        None,
        "CSV with the inputs of a machine that is built from the rig. [default: random levels in "
        "the rig's usual range]",
    )
    cases: int = option(200, "Cases to draw.", least=1, most=100_000)
    part: Literal["test", "calibration"] = option(
        "test", "Thresholds may be set on calibration cases, never on test cases."
    )
    seed: int = seed_option("The same seed gives the same cases.")
    jobs: int = jobs_option()
    cluster: str | None = cluster_option()
    index: str | None = option(
        None,
        "Compute share I of COUNT of the cases, without scores.",
        metavar="I/COUNT",
    )
    resume: bool = option(False, "Continue the trial in the folder; finished cases are reused.")
    overwrite: bool = option(
        False, "Replace an earlier trial in that folder: all cases are computed again."
    )
    only: Literal["single", "double", "no-gap", "withheld", "nameless"] | None = option(
        None, "Keep only this stratum of the drawn cases."
    )
    world: Literal["closed", "open"] = option(
        "closed",
        "closed: the planted effects are the whole gap. open: up to two further effects act, maps "
        "are rougher than the rig states, and the logger is poor.",
    )
    bare: bool = option(
        False, "Ignore the tolerances (background) that the rig states for its machine."
    )
    calibrate: FilePath | None = option(
        None,
        "Write the calibration from the finished calibration cases to this file, in the format of "
        "pamid/diagnosis/calibration.json.",
    )
    also: Sequence[FolderPath] = option(
        (),
        "With --calibrate: also use the trial in this folder, of the same or another rig.",
        click={"type": click.Path(exists=True, file_okay=False, path_type=Path)},
    )


@frame.command("trial", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.trial_cases import run_trial
    from pamid.api.workers import worker_pool
    from pamid.base.json_file import write_json
    from pamid.trial.calibration import calibration_json, learnt_text, lesson_of
    from pamid.trial.figure_table import trial_text

    a = arguments
    if a.calibrate is not None and a.part != "calibration":  # test cases must not set thresholds
        raise UsageError(
            "--calibrate needs the calibration part of the cases.", "Add --part calibration."
        )
    if a.overwrite and (a.resume or a.index is not None):
        raise UsageError(
            f"--overwrite replaces the earlier trial, {'--resume' if a.resume else '--index'} "
            "continues it.",
            "Give either of them, not both.",
        )
    trial = _Trial.of(a)
    with worker_pool(a.jobs, a.cluster) as pool:
        if a.index is not None:
            index, slash, shares = a.index.partition("/")
            numbers = slash and index.isdecimal() and shares.isdecimal()
            if not (numbers and 1 <= int(index) <= int(shares)):
                raise UsageError(
                    f"--index {a.index!r} is not a share.",
                    "Give --index I/COUNT, I from 1 to COUNT: --index 3/20.",
                )
            return _share(trial, (int(index), int(shares)), pool)
        run = trial.replaced() if a.overwrite else trial.begun(a.resume)
        try:
            with progress_line("trial", a.cases) as progress:
                scores = run_trial(
                    trial.output,
                    trial.selection,
                    pool,
                    done=lambda i, n: progress.update(i, "cases", n),
                )
        except BaseException as error:
            run.finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
            raise
    lines = [trial_text(scores)]
    if a.calibrate is not None:
        lessons = [lesson_of(Path(folder)) for folder in (trial.output, *a.also)]
        write_json(Path(a.calibrate), calibration_json(lessons))
        lines.append(learnt_text(lessons))
    failed = bool(scores["failed_jobs"])
    run.finish("partial" if failed else "done")
    return frame.Result(scores, "\n".join(lines), 6 if failed else 0)


@dataclass(frozen=True)
class _Trial:
    """A trial and its run folder.

    fixed: options that all commands on the folder share; options: those that may change
    """

    output: Path
    selection: CaseSelection
    fixed: dict[str, Any]
    options: dict[str, Any]
    inputs: list[Path]

    @classmethod
    def of(cls, a: Arguments) -> _Trial:
        from pamid.api.trial_cases import CaseSelection
        from pamid.model.registry import code_files
        from pamid.recording.recording import read_recording
        from pamid.trial.own_machine import machine_given

        excitation = None if a.excitation is None else Path(a.excitation)
        sent = None if excitation is None else read_recording(excitation)
        machine = machine_given(a.rig, sent)
        fixed: dict[str, Any] = {"part": a.part, "seed": a.seed}
        fixed |= {"bare": True} if a.bare else {}
        fixed |= {"world": a.world} if a.world != "closed" else {}
        if not isinstance(machine, str):
            fixed = {"rig": a.rig, "machine": machine.sha256, **fixed}
        elif a.rig != "one-dof":
            fixed = {"rig": a.rig, **fixed}
        options: dict[str, Any] = {"cases": a.cases, "only": a.only}
        options |= {"excitation": str(excitation)} if excitation else {}
        return cls(
            Path(a.output),
            CaseSelection(a.part, a.cases, a.seed, machine, a.only or "", a.bare, a.world),
            fixed,
            options,
            [*code_files(a.rig, ()), *([excitation] if excitation else [])],
        )

    def begun(self, resume: bool) -> Run:
        """Folder of the trial, new or continued; FileError if it contains another trial or none."""
        if not (self.output / "run.json").is_file():
            return self.created()
        run = self.same()
        if not resume:
            raise FileError(
                f"{self.output} already contains this trial, or a part of it.",
                "Continue it with --resume, replace it with --overwrite, or give another --output.",
                code="run-folder",
            )
        run.begin_step(command=frame.command_line(), seed=self.fixed["seed"], options=self.options)
        return run

    def created(self, *, overwrite: bool = False) -> Run:
        """New folder of the trial."""
        from pamid.base.run_folder import Run

        return Run.create(
            self.output,
            command=frame.command_line(),
            seed=self.fixed["seed"],
            inputs=self.inputs,
            options={"trial": self.fixed, **self.options},
            overwrite=overwrite,
        )

    def replaced(self) -> Run:
        """Folder without the earlier trial; FileError if it contains anything else."""
        from pamid.api.trial_cases import forget_cases
        from pamid.base.run_folder import Run

        if (self.output / "run.json").is_file():
            earlier = Run.open(self.output).record["options"].get("trial")
            if not isinstance(earlier, dict):
                self.same()
        run = self.created(overwrite=True)
        forget_cases(self.output)
        return run

    def joined(self) -> None:
        """Create the folder, or join the other commands that start at the same time."""
        for _ in range(50):
            if (self.output / "run.json").is_file():
                break
            try:
                self.created().finish("shared")
                return
            except FileError:  # another process may be about to write run.json
                time.sleep(0.1)
        self.same()

    def same(self) -> Run:
        """The run in the folder; FileError if it is another trial, or none."""
        from pamid.base.run_folder import Run

        run = Run.open(self.output)
        held = run.record["options"].get("trial")
        if held != self.fixed:
            content = (
                f"the trial of {held.get('rig', 'one-dof')}, part {held.get('part')}, seed "
                f"{held.get('seed')}"
                if isinstance(held, dict)
                else "no trial"
            )
            raise FileError(
                f"{run.folder} is in use: it contains {content}.",
                "Give another folder with --output.",
                code="run-folder",
            )
        return run

    def scoring_command(self) -> str:
        """Command that scores the shares: the same trial without --index."""
        words = [
            f"--{name}" if value is True else f"--{name} {quoted(str(value))}"
            for name, value in (self.fixed | self.options).items()
            if value is not None and name != "machine"
        ]
        return " ".join(["pamid trial", *words, f"--output {quoted(self.output)} --resume"])


def _share(trial: _Trial, share: tuple[int, int], pool: WorkerPool) -> frame.Result:
    """Compute every COUNT-th case from the I-th on, without labels and scores."""
    from pamid.api.trial_cases import run_cases
    from pamid.base.schemas.trial_case_files import TrialShare
    from pamid.trial.scoring import failed_jobs

    trial.joined()
    number, count = share
    every_case = trial.selection.draw()
    cases = every_case[number - 1 :: count]
    with progress_line("trial", len(cases)) as progress:
        results = run_cases(
            cases, trial.output, pool, done=lambda i, n: progress.update(i, "cases", n)
        )
    failed = failed_jobs(results)
    content = TrialShare(
        index=number, of=count, cases=tuple(c.number for c in cases), failed_jobs=failed
    ).as_json()
    text = [
        f"{len(cases)} of {len(every_case)} cases (share {number} of {count}).",
        *failed_text(content),
        f"When all shares are finished: {trial.scoring_command()}",
    ]
    return frame.Result(content, "\n".join(text), 6 if failed else 0)
