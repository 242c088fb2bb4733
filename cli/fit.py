"""`pamid fit`: grey-box parameters with intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .job import carried_through, cluster_option, failed_text, kept, pool_of, require_one_of
from .options import evidence_from, no_check_option, with_sidecar
from .progress import ProgressBar
from .terminal import quoted

EXAMPLE = """
pamid fit rec.csv --rig one-dof --output fitted
"""


@frame.command("fit", example=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--rig",
    help="Rig by name, or the path of a rig file (it is run). "
    "[default: the one the recordings name, else one-dof]",
)
@click.option(
    "--held-out",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Recording nobody fits. [default: the last 30 % of every recording]",
)
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
    help="Run of an earlier fit of the same rig: what it knew becomes the prior of this one, and "
    "the data "
    "sheet serves only where it knew nothing.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(0, 1000),
    default=0,
    show_default=True,
    help="Intervals from this many refits on resampled windows instead of the Jacobian.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Same inputs and seed, same output.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Processes for the bootstrap.",
)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="Run folder to make.",
)
@no_check_option
@cluster_option
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with the same fit where it was interrupted: draws of the bootstrap "
    "that are finished stay.",
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
    """Fit the parameters of a rig to recordings and judge the model on what was held out.

    Writes fit.json and residual.csv into a run folder. Every parameter gets an interval and a word:
    settled, weak (the prior still speaks) or silent (the recordings say nothing about it).
    Parameters that are known only in combination are named with it.

    Tests can be fitted in stages, each on its own recordings: the first with its --output, the next
    --from that run.
    """
    from pamid.base.errors import UsageError
    from pamid.base.files import write_atomically
    from pamid.base.json_file import write_json
    from pamid.base.run_folder import FIT_FILE, JOBS, RESIDUAL_FILE, Run
    from pamid.estimation.fit_files import fit_json, residual_csv
    from pamid.estimation.grey_box import fit_model
    from pamid.estimation.posterior import read_posterior
    from pamid.model.registry import code_files, rig_of
    from pamid.simulation.virtual_rig import attach_specs

    require_one_of(resume, overwrite)
    evidence = evidence_from(rig, recordings, held_out, check=not no_check)
    attached = tuple(a for a, _ in attach_specs(evidence.rig, effects))
    if earlier and earlier.resolve() == output.resolve():
        raise UsageError(
            f"{output} cannot be both --from and --output.",
            "Give every stage a run folder of its own.",
        )
    before = read_posterior(earlier) if earlier else None
    inputs = [f for p in (*recordings, *held_out) for f in with_sidecar(p)]
    inputs += [*code_files(rig, effects), *([earlier / FIT_FILE] if earlier else [])]
    with pool_of(jobs, cluster, kept=output / JOBS) as pool:
        run = Run.create(
            output,
            command=frame.command_line(),
            seed=seed,
            inputs=inputs,
            overwrite=overwrite,
            resume=resume,
            options={
                "rig": rig or rig_of(evidence.recordings),
                "effects": list(effects),
                "bootstrap": bootstrap,
                **({"from": str(earlier)} if earlier else {}),
            },
        )
        if run.record["outcome"] == "done":  # resumed, and nothing is left to do
            found, text = kept(run.path(FIT_FILE), lambda found: fit_text(found, output))
            return frame.Result(found, text, 0 if found["converged"] else 5)
        with carried_through(run, pool), ProgressBar("fit") as progress:
            model = fit_model(
                evidence,
                attached,
                seed=seed,
                draws=bootstrap,
                earlier=before,
                pool=pool,
                progress=lambda text: progress.update(0, text),
            )
            found = fit_json(model, seed) | {"failed_jobs": pool.failed_jobs}
            write_json(run.path(FIT_FILE), found)
            write_atomically(run.path(RESIDUAL_FILE), residual_csv(model))
    return frame.Result(
        found, fit_text(found, output), 5 if not found["converged"] else 6 if pool.failed else 0
    )


def fit_text(found: dict[str, Any], output: Path) -> str:
    """Parameters, what is known only in combination, and held-out errors as a table."""
    from pamid.correction.residual_data import one_period
    from pamid.estimation.identifiable_combinations import tied_text

    lines = [f"{'parameter':34s} {'value':>12s} {'low':>12s} {'high':>12s}  word"]
    for name, p in found["parameters"].items():
        edge = f", at its {p['at_bound']} bound" if p["at_bound"] else ""
        strain = f", {p['strain']:.1f} prior sd from its data sheet" if p["strain"] > 3.0 else ""
        lines.append(
            f"{name:34s} {p['value']:12.5g} {p['low']:12.5g} {p['high']:12.5g}  "
            f"{p['word']}{edge}{strain}"
        )
    lines += tied_text(found)
    lines += [
        f"From {found['from']['path']}: {remark}"
        for remark in found.get("from", {}).get("remarks", ())
    ]
    lines.append("")
    lines.append(
        f"{'held-out mean absolute error':34s} {'data sheet':>12s} {'refitted':>12s} "
        f"{'noise floor':>12s}"
    )
    lines += [
        f"{c:34s} {m['data_sheet']:12.4g} {m['refitted']:12.4g} {m['noise_floor']:12.4g}"
        for c, m in found["mae"].items()
    ]
    if not found["converged"]:
        lines.append(f"Not converged: {found['why']}.")
    lines += failed_text(found)
    follow = ["pamid train-residual", "pamid report"][
        not one_period(r["period_s"] for r in found["recordings"]) :
    ]
    lines.append("Next: " + "   or   ".join(f"{command} {quoted(output)}" for command in follow))
    return "\n".join(lines)
