"""`pamid fit`: Fit the parameters of a rig to recordings, with intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .job import cluster_option, failed_text, finished_result
from .options import jobs_option, no_check_option, recording_options, run_output_option, seed_option
from .terminal import progress_line, quoted, warning

HELP_ORDER = 50
EXAMPLE = """
pamid fit rec.csv --rig one-dof --output fitted
"""


@frame.command("fit", example=EXAMPLE)
@recording_options
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="Effect to fit with: NAME or NAME@PORT, or the path of an effect file (it is run).",
)
@click.option(
    "--from",
    "earlier",
    type=click.Path(file_okay=False, path_type=Path),
    help="Run of an earlier fit of the same rig. Its estimates become the priors of this fit; "
    "parameters that it did not determine keep the prior of the data sheet.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(0, 1000),
    default=0,
    show_default=True,
    help="Intervals from this many refits on resampled windows instead of the Jacobian.",
)
@seed_option("Same inputs and seed, same output.")
@jobs_option("Processes for the bootstrap.", default=1)
@run_output_option("fit-run")
@no_check_option
@cluster_option
@click.option(
    "--resume",
    is_flag=True,
    help="Continue the same fit where it was interrupted. Finished draws of the bootstrap are "
    "reused.",
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    recordings: tuple[Path, ...],
    rig: str | None,
    held_out: tuple[Path, ...],
    effects: tuple[str, ...],
    earlier: Path | None,
    bootstrap: int,
    seed: int,
    jobs: int,
    output: Path,
    no_check: bool,
    cluster: str | None,
    resume: bool,
    overwrite: bool,
) -> frame.Result:
    """Fit the parameters of a rig to recordings and score the model on held-out data.

    Writes fit.json and residual.csv into a run folder. Every parameter gets an interval and a word:
    settled (the recordings determine it), weak (the prior contributes) or silent (the recordings
    do not depend on it). Parameters that only a combination determines are listed with that
    combination.

    Experiments can be fitted in stages, each on other recordings: give the run folder of one fit
    to the next one with --from.
    """
    from pamid.api.fitting import fit
    from pamid.base.run_folder import FIT_FILE
    from pamid.base.work_stages import WORK_STAGES

    stages = WORK_STAGES["fit --bootstrap" if bootstrap else "fit"]
    with progress_line("fit", stages=stages) as progress:
        model = fit(
            list(recordings),
            rig,
            held_out=list(held_out),
            effects=effects,
            earlier=earlier,
            bootstrap=bootstrap,
            seed=seed,
            jobs=jobs,
            cluster=cluster,
            output=output,
            overwrite=overwrite,
            resume=resume,
            check=not no_check,
            progress=progress,
            warn=warning,
            command=frame.command_line(),
        )
    content, text = finished_result(output / FIT_FILE, lambda content: fit_text(content, output))
    return frame.Result(content, text, 5 if not model.converged else 6 if model.failed_jobs else 0)


def fit_text(fit: dict[str, Any], output: Path) -> str:
    """Parameters, identifiable combinations and held-out errors as a table."""
    from pamid.correction.residual_data import one_period
    from pamid.estimation.identifiable_combinations import tied_text

    lines = [f"{'parameter':34s} {'value':>12s} {'low':>12s} {'high':>12s}  word"]
    for name, p in fit["parameters"].items():
        edge = f"at its {p['at_bound']} bound" if p["at_bound"] else ""
        word = "" if edge and p["word"] == "settled" else p["word"]
        null = p.get("null")
        within = null is not None and p["low"] <= null <= p["high"]
        nothing = f", may be {null:g}, at which the effect vanishes" if within else ""
        strain = f", {p['strain']:.1f} prior sd from its data sheet" if p["strain"] > 3.0 else ""
        lines.append(
            f"{name:34s} {p['value']:12.5g} {p['low']:12.5g} {p['high']:12.5g}  "
            f"{', '.join(filter(None, (word, edge)))}{strain}{nothing}"
        )
    if not fit["parameters"]:
        lines = ["The rig has no parameters to fit; the errors are those of the unchanged model."]
    lines += tied_text(fit)
    lines += [
        f"From {fit['from']['path']}: {remark}" for remark in fit.get("from", {}).get("remarks", ())
    ]
    lines.append("")
    lines.append(
        f"{'held-out mean absolute error':34s} {'data sheet':>12s} {'refitted':>12s} "
        f"{'noise floor':>12s}"
    )
    lines += [
        f"{c:34s} {m['data_sheet']:12.4g} {m['refitted']:12.4g} {m['noise_floor']:12.4g}"
        for c, m in fit["mae"].items()
    ]
    if not fit["converged"]:
        lines.append(f"Not converged: {fit['why']}.")
    lines += [f"Note      {note}" for note in fit.get("notes") or ()]
    lines += failed_text(fit)
    follow = ["pamid train-residual", "pamid report"][
        not one_period(r["period_s"] for r in fit["recordings"]) :
    ]
    lines.append("Next: " + "   or   ".join(f"{command} {quoted(output)}" for command in follow))
    return "\n".join(lines)
