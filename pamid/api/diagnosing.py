"""`pamid.diagnose`: where a model departs from its recordings, which effect causes it, how far the
gap shrinks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pamid.api.carried_runs import HowToRun, carry_out
from pamid.api.given import (
    EffectLike,
    RecordingLike,
    Warn,
    effects_given,
    evidence_of,
    warn_in_python,
)
from pamid.api.results import DiagnosisResult, result_of
from pamid.base.errors import FileError, UsageError, nearest
from pamid.base.files import PathLike
from pamid.base.progress import Progress, ShowProgress
from pamid.base.run_folder import Run
from pamid.diagnosis.settings import DEFAULT, Settings, settings_from
from pamid.estimation.memory_needed import memory_warning
from pamid.model.effect import Effect
from pamid.model.registry import RigLike, effects_with
from pamid.parallel.jobs import WorkerPool
from pamid.verdict.diagnosis_run import diagnose_into


def diagnose(
    recordings: RecordingLike | Sequence[RecordingLike],
    rig: RigLike | None = None,
    *,
    held_out: RecordingLike | Sequence[RecordingLike] = (),
    effects: EffectLike | Iterable[EffectLike] = (),
    without: Iterable[str] = (),
    horizon: float | str | None = None,
    settings: Settings | Mapping[str, float] = DEFAULT,
    seed: int = 0,
    jobs: int = 2,
    cluster: str | None = None,
    output: PathLike | Run | None = None,
    overwrite: bool = False,
    resume: bool = False,
    check: bool = True,
    progress: ShowProgress = None,
    warn: Warn = warn_in_python,
    command: Sequence[str] = (),
) -> DiagnosisResult:
    """Find where a model departs from its recordings, which effect causes it, and how far the gap
    shrinks.

    The gap is judged on recordings that were used neither for the parameters nor for the choice of
    the effect. Parameters that are not listed are those of `pamid.fit`.

    Parameters
    ----------
    effects
        Further effects to consider: paths of effect files, which are run, or Effects.
    without
        Names of effects to leave out.
    horizon
        Time over which the model predicts from one estimated state, s, or "whole" for whole
        recordings. Default: as long as the noise of that state allows.
    settings
        Thresholds and bounds of the cost to change, by name: see `pamid.diagnosis.settings`.
    jobs
        Processes of this machine; the result does not depend on it.
    output
        Run folder. With it an interrupted diagnosis keeps its finished jobs, and resume=True goes
        on. Default: a temporary folder, which `save` copies. Or a run to extend.

    Returns
    -------
    DiagnosisResult
        Verdict, causes, remainder and figures, read from the run folder.

    Raises
    ------
    PamidError
        Files, data or arguments are wrong.
    """
    chosen = settings_from(settings, horizon)
    given = evidence_of(recordings, rig, held_out, check=check, warn=warn)
    searched = given.evidence.excerpt(chosen.fitted_most, chosen.held_out_most)
    if large := memory_warning(searched, 1 if cluster else jobs):
        warn(large)
    further, left_out = effects_given(effects), list(without)
    catalogue = catalogue_of(further, left_out)

    def work(run: Run, pool: WorkerPool, show: Progress) -> None:
        diagnose_into(
            run, given.evidence, catalogue, seed=seed, progress=show, pool=pool, settings=chosen
        )

    how = HowToRun(seed, jobs, cluster, output, overwrite, resume, progress, command)
    options = {"without": left_out} | ({"settings": chosen.changed} if chosen.changed else {})
    home = carry_out("diagnose", given, further, how, work, options=options)
    result = result_of(home, given.rig, further)
    if not isinstance(result, DiagnosisResult):
        raise FileError(
            f"{home.folder} holds no diagnosis any more.",
            "Make the run again with --overwrite.",
            code="damaged",
        )
    return result


def catalogue_of(
    further: tuple[str | type[Effect], ...], without: Iterable[str]
) -> dict[str, type[Effect]]:
    """Every effect of the catalogue and further ones, by name, but for those left out; UsageError
    where one of these is none."""
    known, _ = effects_with(further)
    for name in without:
        if name not in known:
            raise UsageError(f"--without {name!r}: no such effect.", nearest(name, list(known)))
        del known[name]
    return known
