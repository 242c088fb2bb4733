"""Diagnosis into a run folder: the figures, the verdict, and the description of an unknown
effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pamid.base.files import write_atomically
from pamid.base.json_file import write_json
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress, Settled, silent
from pamid.base.run_folder import (
    ADDED_VARIABLES_FILE,
    DIAGNOSIS_FILE,
    FIT_FILE,
    FREE_RUN_FILE,
    MISSING_FILE,
    RESIDUAL_FILE,
    Run,
)
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.diagnosis.answer import probability
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.planning.next_experiment import Proposal, Proposing
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.verdict.added_variables import added_variables
from pamid.diagnosis.verdict.remainder import Missing, find_missing, missing_csv
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file, with_experiment
from pamid.engine.simulator_warnings import counted_warnings
from pamid.estimation.fit_files import fit_json, model_json, residual_csv
from pamid.estimation.grey_box import GreyBox
from pamid.estimation.posterior import posterior_of
from pamid.estimation.whole_runs import OVER_RECORDINGS, free_run_csv, free_runs
from pamid.model.effect import Effect
from pamid.simulation.data_split import DataSplit


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """A diagnosis with its description. missing: the term that no cause explains; draft: the result
    but for the next experiment."""

    diagnosis: Diagnosis
    missing: Missing | None
    draft: DiagnosisFile


def diagnosed(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    pool: WorkerPool,
    seed: int = 0,
    progress: Progress = silent,
    settings: Settings = DEFAULT,
) -> Diagnosed:
    """Diagnosis from data to verdict, used by the command, the Python API and the trial."""
    diagnosis = diagnose(
        evidence, catalogue, seed=seed, progress=progress, pool=pool, settings=settings
    )
    missing = None
    if diagnosis.left_over:
        progress("describing the missing term")
        missing = find_missing(diagnosis, pool=pool)
    return Diagnosed(diagnosis, missing, diagnosis_file(diagnosis, missing))


def diagnose_into(
    run: Run,
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    seed: int = 0,
    progress: Progress = silent,
    pool: WorkerPool | None = None,
    settings: Settings = DEFAULT,
) -> dict[str, Any]:
    """Diagnose and write fit.json, residual.csv, free-run.csv, added-variables.json (where
    candidates were refitted), missing.csv (the points of an unknown effect), next-experiment.csv
    (where there is something left to measure, with its TOML; a further file per further setting)
    and diagnosis.json; returns the last. pool: who does the jobs (default: this process);
    those that failed are named in `failed_jobs`. settings: as in
    `pamid.diagnosis.pipeline.diagnose`."""
    pool = pool or WorkerPool(1)
    result = diagnosed(
        evidence, catalogue, pool=pool, seed=seed, progress=progress, settings=settings
    )
    diagnosis, draft = result.diagnosis, result.draft
    progress(Settled(f"verdict: {draft.remark or draft.sentence}"))
    progress("looking for the next experiment")
    proposal = pool.one(Proposing(), diagnosis)
    with counted_warnings() as warned:
        free = free_runs_of(diagnosis)
    warnings = warned.sentences(OVER_RECORDINGS)
    draft = draft.model_copy(update={"notes": (*warnings, *(draft.notes or ()))})
    content = with_experiment(draft, proposal).as_json() | {"failed_jobs": pool.failed_jobs}
    write_json(run.path(FIT_FILE), models_json(diagnosis, warnings))
    residual = residual_csv(diagnosis.budget.model, with_causes(diagnosis))
    write_atomically(run.path(RESIDUAL_FILE), residual)
    write_atomically(run.path(FREE_RUN_FILE), free)
    if diagnosis.ranking:
        write_json(run.path(ADDED_VARIABLES_FILE), added_variables(diagnosis).as_json())
    if result.missing is not None:
        write_atomically(run.path(MISSING_FILE), missing_csv(result.missing))
    if isinstance(proposal, Proposal):
        proposal.write(run.claim)
    write_json(run.path(DIAGNOSIS_FILE), content)
    return content


def free_runs_of(d: Diagnosis) -> bytes:
    """free-run.csv of the refitted model and, where there is a cause, the model that has it."""
    models = {"free_run": d.budget.baseline} | ({"cause_free_run": d.cause} if d.cause else {})
    evidence = d.budget.model.evidence
    return free_run_csv(
        evidence,
        {
            kind: free_runs(evidence, c.assembly, c.fit.p, c.fit.stepping)
            for kind, c in models.items()
        },
    )


def models_json(d: Diagnosis, notes: Sequence[str] = ()) -> dict[str, Any]:
    """fit.json of the refitted model and, where there is a cause, the model that has it; of causes
    that cannot be separated a model each. notes: sentences."""
    model = d.budget.model
    if d.cause is None:
        return fit_json(model, d.seed, notes=notes)
    models: dict[str, Any] = {"cause": _saved(d.cause)}
    if d.answer is not None and d.verdict == "ambiguous":
        models["rivals"] = {
            c.effect.label: {
                "probability": probability(c.figures),
                "model": _saved(c.model),
            }
            for c in d.answer.causes
        }
    return fit_json(model, d.seed, with_causes(d), notes) | models


def with_causes(d: Diagnosis) -> GreyBox | None:
    """The model with the causes that the verdict names, with its held-out replays."""
    if d.cause is None:
        return None
    c = d.cause
    return replace(d.budget.model, assembly=c.assembly, fit=c.fit, held_out=c.replays)


def _saved(c: CandidateModel) -> dict[str, Any]:
    """Entry of fit.json for a model with causes."""
    return model_json(c.assembly, c.fit) | {"posterior": posterior_of(c.fit).as_json()}
