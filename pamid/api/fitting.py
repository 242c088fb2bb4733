"""`pamid.fit`: grey-box parameters with intervals, into a run folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from pamid.api.carried_runs import HowToRun, carry_out
from pamid.api.given import (
    EffectLike,
    RecordingLike,
    Warn,
    effects_given,
    evidence_of,
    warn_in_python,
)
from pamid.api.results import FitResult, result_of
from pamid.base.errors import UsageError
from pamid.base.files import PathLike, write_atomically
from pamid.base.json_file import write_json
from pamid.base.progress import Progress, ShowProgress
from pamid.base.run_folder import FIT_FILE, FREE_RUN_FILE, RESIDUAL_FILE, Run
from pamid.engine.simulator_warnings import counted_warnings
from pamid.estimation.fit_files import fit_json, residual_csv
from pamid.estimation.grey_box import fit_model
from pamid.estimation.posterior import read_posterior
from pamid.estimation.whole_runs import OVER_RECORDINGS, free_run_csv, free_runs
from pamid.estimation.window_length import with_linear_windows
from pamid.model.registry import RigLike
from pamid.parallel.jobs import WorkerPool
from pamid.simulation.virtual_rig import attach_specs


def fit(
    recordings: RecordingLike | Sequence[RecordingLike],
    rig: RigLike | None = None,
    *,
    held_out: RecordingLike | Sequence[RecordingLike] = (),
    effects: EffectLike | Iterable[EffectLike] = (),
    earlier: FitResult | PathLike | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    jobs: int = 1,
    cluster: str | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    resume: bool = False,
    check: bool = True,
    progress: ShowProgress = None,
    warn: Warn = warn_in_python,
    command: Sequence[str] = (),
) -> FitResult:
    """Fit the parameters of a rig to recordings, and judge the model on held-out data.

    Parameters
    ----------
    recordings
        Recordings to fit. Without `held_out` the last 30 % of each is held out; of one that rests
        for a part of its length, three tenths spread over it.
    rig
        Name, path of a rig file (it is run), or a Rig. Default: the one that the recordings name,
        else one-dof.
    held_out
        Recordings that only judge.
    effects
        Effects in the model: NAME or NAME@PORT, paths of effect files (they are run), or Effects.
    earlier
        Fit of the same rig, or its run folder, whose result is the prior.
    bootstrap
        Number of refits on resampled windows, for intervals. 0: intervals from the Jacobian.
    seed, jobs
        Seed and processes of the bootstrap; the result does not depend on `jobs`.
    cluster
        Scheduler of a Dask cluster that does the jobs instead.
    output
        Run folder. overwrite: replace an earlier run; resume: go on with an interrupted one.
        Default: a temporary folder, which `save` copies.
    check
        Refuse recordings with which a fit of this rig is meaningless.
    progress
        None: a line that updates itself; False: silent; or a function of a line of text.
    warn
        Function that takes warnings. Default: warnings.warn.
    command
        Command that the run notes. Default: this call.

    Returns
    -------
    FitResult
        Parameters with intervals, and errors per channel.

    Raises
    ------
    PamidError
        Files, data or arguments are wrong.
    """
    given = evidence_of(recordings, rig, held_out, check=check, warn=warn)
    named = effects_given(effects)
    specs = attach_specs(given.evidence.rig, named)
    if valued := next((a.label for a, values in specs if values), ""):
        raise UsageError(
            f"effect {valued!r}: a fit estimates its parameters and takes no values for them.",
            f"Name it alone: --effect {valued}.",
        )
    attached = tuple(a for a, _ in specs)
    before = _earlier_run(earlier, output)
    posterior = read_posterior(before) if before else None

    def work(run: Run, pool: WorkerPool, show: Progress) -> None:
        model = fit_model(
            with_linear_windows(given.evidence),
            attached,
            seed=seed,
            draws=bootstrap,
            earlier=posterior,
            pool=pool,
            progress=show,
        )
        a, e, fitted = model.assembly, model.evidence, model.fit
        with counted_warnings() as warned:
            free = {"free_run": free_runs(e, a, fitted.p, fitted.stepping)}
        found = fit_json(model, seed, notes=warned.sentences(OVER_RECORDINGS))
        write_json(run.path(FIT_FILE), found | {"failed_jobs": pool.failed_jobs})
        write_atomically(run.path(RESIDUAL_FILE), residual_csv(model))
        write_atomically(run.path(FREE_RUN_FILE), free_run_csv(e, free))

    how = HowToRun(seed, jobs, cluster, output, overwrite, resume, progress, command)
    options = {"bootstrap": bootstrap, **({"from": str(before)} if before else {})}
    inputs = [before / FIT_FILE] if before else []
    home = carry_out("fit", given, named, how, work, options=options, inputs=inputs)
    return result_of(home, given.rig, named)


def _earlier_run(earlier: FitResult | PathLike | None, output: PathLike | None) -> Path | None:
    """The run folder of the fit to begin from; UsageError where it is to be written to as well."""
    before = (
        Path(earlier.folder if isinstance(earlier, FitResult) else earlier) if earlier else None
    )
    if before and output is not None and before.resolve() == Path(output).resolve():
        raise UsageError(
            f"{output} cannot be both --from and --output.",
            "Give every stage a run folder of its own.",
        )
    return before
