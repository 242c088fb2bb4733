"""Carrying out a run, and opening a run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from pamid.api.given import EffectLike, Given, effects_given
from pamid.api.options.estimating import RunArguments
from pamid.api.results import FitResult, result_of
from pamid.api.workers import RunHome, closing, worker_pool
from pamid.base.errors import UsageError
from pamid.base.files import PathLike, write_together
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress, progress_steps
from pamid.base.run_folder import Run
from pamid.model.effect import Effect
from pamid.model.registry import RigLike, code_files, name_of, resolved_rig


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


def carry_out(
    call: str,
    arguments: RunArguments,
    given: Given,
    effects: tuple[str | type[Effect], ...],
    work: Callable[[Run, WorkerPool, Progress], object],
    *,
    options: Mapping[str, Any],
    inputs: Sequence[Path] = (),
) -> RunHome:
    """Create or continue the run folder of a fit or a diagnosis, work there, and record the
    outcome.

    A resumed run that is complete is left as it is. FileError where the folder is in use; errors of
    the work pass through.
    """
    if arguments.overwrite and arguments.resume:
        raise UsageError(
            "--resume goes on with the earlier run, --overwrite replaces it.",
            "Give either of them.",
        )
    output = arguments.output
    further = output if isinstance(output, Run) else None
    if isinstance(output, Run):
        folder: Path | None = output.folder
    else:
        folder = None if output is None else Path(output)
    home = RunHome(folder)
    rig, named = name_of(given.rig), [e if isinstance(e, str) else e.name for e in effects]
    noted: dict[str, Any] = {"rig": rig, "effects": named, **options}
    if given.kept:
        sha256 = {n: hashlib.sha256(content).hexdigest() for n, content in given.kept.items()}
        noted["recordings"] = [f"{digest} {name}" for name, digest in sha256.items()]
    words = [
        f"pamid.{call}",
        *(str(recording.path) for recording in given.evidence.recordings),
        f"rig={rig}",
        *([f"effects={','.join(named)}"] if named else []),
    ]
    about: dict[str, Any] = {
        "command": arguments.command or words,
        "seed": arguments.seed,
        "inputs": [*given.inputs, *code_files(given.rig, effects), *inputs],
        "options": noted,
    }
    with worker_pool(arguments.jobs, arguments.cluster, run_folder=folder) as pool:
        if further:
            run = further
            run.begin_step(**about)
        else:
            run = Run.create(
                home.folder, **about, overwrite=arguments.overwrite, resume=arguments.resume
            )
        if given.kept:
            paths = run.claim(*given.kept)
            write_together(dict(zip(paths, given.kept.values(), strict=True)))
        if further or run.record["outcome"] != "done":
            steps = progress_steps(arguments.progress, call)
            # the matrices are small: further BLAS threads would only spin
            with (
                closing(run, pool, further=bool(further)),
                steps as (show, _),
                threadpool_limits(limits=1, user_api="blas"),
            ):
                work(run, pool, show)
    return home
