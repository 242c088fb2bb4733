"""`pamid.fit`: grey-box parameters with intervals, into a run folder."""

from __future__ import annotations

import os
from pathlib import Path

from pamid.api.carried_runs import carry_out
from pamid.api.given import effects_given, evidence_of
from pamid.api.options.estimating import FitArguments
from pamid.api.options.record import verb
from pamid.api.results import FitResult, result_of
from pamid.api.workers import OpenedRun
from pamid.base.errors import UsageError
from pamid.base.files import write_atomically
from pamid.base.json_file import write_json
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress
from pamid.base.run_folder import FIT_FILE, FREE_RUN_FILE, RESIDUAL_FILE, Run
from pamid.engine.simulator_warnings import counted_warnings
from pamid.estimation.fit_files import fit_json, residual_csv
from pamid.estimation.grey_box import fit_model
from pamid.estimation.posterior import read_posterior
from pamid.estimation.whole_runs import OVER_RECORDINGS, free_run_csv, free_runs
from pamid.estimation.window_length import with_linear_windows
from pamid.simulation.virtual_rig import attach_specs


@verb(FitArguments)
def fit(arguments: FitArguments) -> FitResult:
    """Fit the parameters of a rig to recordings, and judge the model on held-out data.

    Returns
    -------
    FitResult
        Parameters with intervals, and errors per channel.

    Raises
    ------
    PamidError
        Files, data or arguments are wrong.
    """
    a = arguments
    given = evidence_of(a.recordings, a.rig, a.held_out, check=a.check, warn=a.warn)
    named = effects_given(arguments.effects)
    specs = attach_specs(given.evidence.rig, named)
    if valued := next((a.label for a, values in specs if values), ""):
        raise UsageError(
            f"effect {valued!r}: a fit estimates the parameters and accepts no values for them.",
            f"Give the effect without values: --effect {valued}.",
        )
    attached = tuple(a for a, _ in specs)
    before = OpenedRun.of(arguments.earlier).folder if arguments.earlier else None
    output = arguments.output
    if (
        before
        and isinstance(output, str | os.PathLike)
        and before.resolve() == Path(output).resolve()
    ):
        raise UsageError(
            f"{output} cannot be both --from and --output.",
            "Give every stage a separate run folder.",
        )
    posterior = read_posterior(before) if before else None

    def work(run: Run, pool: WorkerPool, show: Progress) -> None:
        model = fit_model(
            with_linear_windows(given.evidence),
            attached,
            seed=arguments.seed,
            draws=arguments.bootstrap,
            earlier=posterior,
            pool=pool,
            progress=show,
        )
        a, e, fitted = model.assembly, model.evidence, model.fit
        with counted_warnings() as warned:
            free = {"free_run": free_runs(e, a, fitted.p, fitted.stepping)}
        written = fit_json(model, arguments.seed, notes=warned.sentences(OVER_RECORDINGS))
        write_json(run.path(FIT_FILE), written | {"failed_jobs": pool.failed_jobs})
        write_atomically(run.path(RESIDUAL_FILE), residual_csv(model))
        write_atomically(run.path(FREE_RUN_FILE), free_run_csv(e, free))

    options = {"bootstrap": arguments.bootstrap, **({"from": str(before)} if before else {})}
    inputs = [before / FIT_FILE] if before else []
    home = carry_out("fit", arguments, given, named, work, options=options, inputs=inputs)
    return result_of(home, given.rig, named)
