"""Beginning a run, and opening one."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pamid.api.given import (
    EffectLike,
    Given,
    PathLike,
    RigLike,
    effects_given,
    rig_given,
)
from pamid.api.results import FitResult, result_of
from pamid.api.workers import RunHome
from pamid.base.errors import UsageError
from pamid.base.files import write_together
from pamid.base.run_folder import Run
from pamid.model.effect import Effect
from pamid.model.registry import code_files, name_of


def open_run(
    folder: PathLike, *, rig: RigLike | None = None, effects: EffectLike | Iterable[EffectLike] = ()
) -> FitResult:
    """The result that a run folder holds, whoever made it: a DiagnosisResult where it holds a
    diagnosis. No code is run.

    rig, effects   what the run was made with, where that is a file (it is run once a simulation
                   needs it, if it is still the same) or was given in Python; only `simulate` needs
                   them
    FileError where the folder is no run, holds no result, or is damaged.
    """
    Run.open(Path(folder))
    return result_of(RunHome(Path(folder)), rig_given(rig), effects_given(effects))


def create_run(
    home: RunHome,
    given: Given,
    effects: tuple[str | type[Effect], ...],
    *,
    command: Sequence[str],
    seed: int,
    options: Mapping[str, Any],
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    resume: bool = False,
) -> Run:
    """The run folder of a fit or a diagnosis, with the recordings that came in no file. FileError
    where it is taken."""
    if overwrite and resume:
        raise UsageError(
            "--resume goes on with the earlier run, --overwrite replaces it.", "Give one of them."
        )
    noted: dict[str, Any] = {
        "rig": name_of(given.rig),
        "effects": [spec if isinstance(spec, str) else spec.name for spec in effects],
        **options,
    }
    if given.kept:
        sha256 = {n: hashlib.sha256(content).hexdigest() for n, content in given.kept.items()}
        noted["recordings"] = [f"{digest} {name}" for name, digest in sha256.items()]
    run = Run.create(
        home.folder,
        command=command,
        seed=seed,
        inputs=[*given.inputs, *code_files(given.rig, effects), *inputs],
        overwrite=overwrite,
        resume=resume,
        options=noted,
    )
    if given.kept:
        paths = run.claim(*given.kept)
        write_together(dict(zip(paths, given.kept.values(), strict=True)))
    return run


def words_of(given: Given, effects: tuple[str | type[Effect], ...]) -> list[str]:
    """The call as a run notes it: recordings, rig and effects."""
    named = [spec if isinstance(spec, str) else spec.name for spec in effects]
    return [
        *(str(recording.path) for recording in given.evidence.recordings),
        f"rig={name_of(given.rig)}",
        *([f"effects={','.join(named)}"] if named else []),
    ]
