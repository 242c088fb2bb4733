"""`pamid.diagnose`: where a model departs from its recordings, which effect causes it, how far the
gap shrinks."""

from __future__ import annotations

from pamid.api.carried_runs import carry_out
from pamid.api.given import effects_given, evidence_of, warn_in_python
from pamid.api.options.estimating import DiagnosisArguments
from pamid.api.options.record import verb
from pamid.api.results import DiagnosisResult, result_of
from pamid.base.errors import FileError, UsageError, nearest
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress
from pamid.base.run_folder import Run
from pamid.diagnosis.settings import DEFAULT, settings_from
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.estimation.memory_needed import memory_warning
from pamid.model.registry import effects_with


@verb(DiagnosisArguments)
def diagnose(arguments: DiagnosisArguments) -> DiagnosisResult:
    """Find where a model departs from its recordings, which effect causes it, and how far the gap
    shrinks.

    The gap is judged on recordings that were used neither for the parameters nor for the choice of
    the effect.

    Returns
    -------
    DiagnosisResult
        Verdict, causes, remainder and figures, read from the run folder.

    Raises
    ------
    PamidError
        Files, data or arguments are wrong.
    """
    chosen = settings_from(arguments.settings or DEFAULT, arguments.horizon)
    a = arguments
    given = evidence_of(a.recordings, a.rig, a.held_out, check=a.check, warn=a.warn)
    searched = given.evidence.excerpt(chosen.fitted_most, chosen.held_out_most)
    if large := memory_warning(searched, 1 if arguments.cluster else arguments.jobs):
        (arguments.warn or warn_in_python)(large)
    further, left_out = effects_given(arguments.effects), list(arguments.without)
    catalogue, _ = effects_with(further)
    for name in left_out:
        if name not in catalogue:
            raise UsageError(f"--without {name!r}: no such effect.", nearest(name, list(catalogue)))
        del catalogue[name]

    def work(run: Run, pool: WorkerPool, show: Progress) -> None:
        diagnose_into(
            run,
            given.evidence,
            catalogue,
            seed=arguments.seed,
            progress=show,
            pool=pool,
            settings=chosen,
        )

    options = {"without": left_out} | ({"settings": chosen.changed} if chosen.changed else {})
    home = carry_out("diagnose", arguments, given, further, work, options=options)
    result = result_of(home, given.rig, further)
    if not isinstance(result, DiagnosisResult):
        raise FileError(
            f"{home.folder} no longer contains a diagnosis.",
            "Repeat the run with --overwrite.",
            code="damaged",
        )
    return result
