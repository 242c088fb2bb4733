"""Carrying out a run, and opening one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from pamid.api.given import EffectLike, Given, effects_given
from pamid.api.results import FitResult, result_of
from pamid.api.workers import RunHome, closing, worker_pool
from pamid.base.errors import UsageError
from pamid.base.files import PathLike, write_together
from pamid.base.progress import Progress, ShowProgress, progress_steps
from pamid.base.run_folder import Run
from pamid.model.effect import Effect
from pamid.model.registry import RigLike, code_files, name_of, resolved_rig
from pamid.parallel.jobs import WorkerPool


def open_run(
    folder: PathLike, *, rig: RigLike | None = None, effects: EffectLike | Iterable[EffectLike] = ()
) -> FitResult:
    """Result of a run folder: a DiagnosisResult where it holds a diagnosis. No code is run.

    Parameters
    ----------
    rig, effects
        Rig and effects of the run, where these are files or Python objects. Only `simulate` needs
        them; files are run then, if they are unchanged.

    Raises
    ------
    FileError
        The folder is not a run, holds no result, or is damaged.
    """
    Run.open(Path(folder))
    return result_of(RunHome(Path(folder)), resolved_rig(rig), effects_given(effects))


@dataclass(frozen=True)
class HowToRun:
    """Settings that a fit and a diagnosis share, apart from the recordings; see `pamid.fit`."""

    seed: int
    jobs: int
    cluster: str | None
    output: PathLike | Run | None
    overwrite: bool
    resume: bool
    progress: ShowProgress
    command: Sequence[str]


def carry_out(
    verb: str,
    given: Given,
    effects: tuple[str | type[Effect], ...],
    how: HowToRun,
    work: Callable[[Run, WorkerPool, Progress], object],
    *,
    options: Mapping[str, Any],
    inputs: Sequence[Path] = (),
) -> RunHome:
    """Make the run folder of a fit or a diagnosis, do its work there, and close it with how it
    ended. What is resumed and has come to its end is left as it is. FileError where the folder is
    taken; whatever the work raises."""
    further = how.output if isinstance(how.output, Run) else None
    folder = further.folder if further else None if how.output is None else Path(how.output)  # type: ignore[arg-type]
    home = RunHome(folder)
    with worker_pool(how.jobs, how.cluster, run_folder=folder) as pool:
        run = _begun(home, further, given, effects, how, f"pamid.{verb}", options, inputs)
        if further or run.record["outcome"] != "done":
            steps = progress_steps(how.progress, verb)
            # the matrices are small: further BLAS threads would only spin
            with (
                closing(run, pool, further=bool(further)),
                steps as (show, _),
                threadpool_limits(limits=1, user_api="blas"),
            ):
                work(run, pool, show)
    return home


def _begun(
    home: RunHome,
    further: Run | None,
    given: Given,
    effects: tuple[str | type[Effect], ...],
    how: HowToRun,
    call: str,
    options: Mapping[str, Any],
    inputs: Sequence[Path],
) -> Run:
    """The run, made or as a further step of one, with the recordings that came in no file."""
    if how.overwrite and how.resume:
        raise UsageError(
            "--resume goes on with the earlier run, --overwrite replaces it.", "Give one of them."
        )
    rig, named = name_of(given.rig), [e if isinstance(e, str) else e.name for e in effects]
    noted: dict[str, Any] = {"rig": rig, "effects": named, **options}
    if given.kept:
        sha256 = {n: hashlib.sha256(content).hexdigest() for n, content in given.kept.items()}
        noted["recordings"] = [f"{digest} {name}" for name, digest in sha256.items()]
    words = [
        call,
        *(str(recording.path) for recording in given.evidence.recordings),
        f"rig={rig}",
        *([f"effects={','.join(named)}"] if named else []),
    ]
    command = how.command or words
    read = [*given.inputs, *code_files(given.rig, effects), *inputs]
    if further:
        run = further
        run.begin_step(command=command, seed=how.seed, inputs=read, options=noted)
    else:
        run = Run.create(
            home.folder,
            command=command,
            seed=how.seed,
            inputs=read,
            overwrite=how.overwrite,
            resume=how.resume,
            options=noted,
        )
    if given.kept:
        paths = run.claim(*given.kept)
        write_together(dict(zip(paths, given.kept.values(), strict=True)))
    return run
