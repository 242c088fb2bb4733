"""`pamid reproduce-paper`: the first paper's results table, on a calibrated twin of its rig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from . import frame
from .progress import Progress

EXAMPLE = """
pamid reproduce-paper --quick --output paper-run
"""
QUICK_S, QUICK_ITERATIONS = 30.0, 30


@frame.command("reproduce-paper", example=EXAMPLE)
@click.option("--iterations", type=click.IntRange(1), help="Levenberg-Marquardt steps at most, for every start. "
              "[default: 1000; 30 with --quick]")
@click.option("--starts", type=click.IntRange(1, 1000), default=4, show_default=True,
              help="Random starts of the network; the best is kept.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True,
              help="Of the excitation, the noise and the network.")
@click.option("--seconds", type=click.FloatRange(12.0, 3600.0), help="Length of the training record. "
              "[default: 200; 30 with --quick]")
@click.option("--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes for the diagnosis.")
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default=Path("paper-run"),
              show_default=True, help="Run folder to make.")
@click.option("--quick", is_flag=True, help="A short record and few iterations, to see it work.")
@click.option("--resume", is_flag=True, help="Go on from where the same command was interrupted.")
@click.option("--overwrite", is_flag=True, help="Replace an earlier run in that folder.")
def command(iterations: int | None, starts: int, seed: int, seconds: float | None, jobs: int, output: Path, quick: bool,
            resume: bool, overwrite: bool) -> frame.Result:
    """Print the first paper's results table beside the published one: the analytic model, the refitted model, the
    analytic model with an Elman network, the model with the causes that `diagnose` names; trained at 6.4 times the
    nominal inertia, tested on steps there and at the nominal one.

    The rig is a calibrated twin, not the authors'. Interrupted, the network keeps what it has reached.
    """
    from dataclasses import asdict

    from pamid.errors import PamidError
    from pamid.paper import Plan, reproduce
    from pamid.run import Run

    plan = Plan(seconds or (QUICK_S if quick else Plan.seconds),
                iterations or (QUICK_ITERATIONS if quick else Plan.iterations), starts, seed, jobs, quick)
    if resume:
        run = Run.open(output)
        run.begin_step(command=sys.argv, seed=seed, options=asdict(plan))
    else:
        run = Run.create(output, command=sys.argv, seed=seed, options=asdict(plan), overwrite=overwrite)
    try:
        with Progress("reproduce-paper") as progress:
            found = reproduce(run, plan, resume=resume, told=lambda text: progress.update(0, text))
    except (PamidError, KeyboardInterrupt) as error:
        run.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    run.finish()
    return frame.Result(found, table_text(found))


def table_text(found: dict[str, Any]) -> str:
    """The table, the training beside the paper's, the causes, and what all of it is not."""
    cases = list(found["rows"][0]["mae"])
    plan, twin = found["plan"], found["twin"]["analytic_mae_without_noise"]
    lines = [f"QUICK: {plan['seconds']:g} s and {plan['iterations']} iterations are too few; these figures only show "
             "that it runs.", ""] if found["quick"] else []
    told = ("trained at", "never seen")
    lines += [f"{'':28s}" + "".join(f"{f'{case} ({word})':>39s}" for case, word in zip(cases, told, strict=True)),
              f"{'MAE of the steps, deg':28s}" + f"{'published':>11s}{'here':>9s}{'after 1 s':>10s}{'lower by':>9s}" * 2
              + f"{'seconds':>9s}"]
    for row in found["rows"]:
        cells = "".join(_number(row["published"].get(c), 11) + _number(row["mae"][c], 9)
                        + _number(row["mae_after_1_s"][c], 10) + _percent(row["improvement"][c]) for c in cases)
        seconds = row["seconds"]
        lines.append(f"{row['model']:28s}{cells}" + (f"{seconds:9.0f}" if seconds is not None else f"{'-':>9s}"))
    lines.append(f"Published: with its network {100.0 * found['published']['improvement']:.1f} % lower at {cases[0]}.")
    if any("spring kept" in row["model"] for row in found["rows"]):
        lines.append("Spring kept: as the load behind the spring changes, that spring and the inertia before it stay; "
                     "in the row above, the share of the inertia and the frequency stay as they were found.")
    lines += ["", *_training(found), "", f"Diagnosis  {found['diagnosis']['sentence']}"]
    for cause in found["diagnosis"]["causes"]:
        values = ", ".join(f"{k} {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
                           for k, v in cause["parameters"].items())
        lines.append(f"           {cause['effect']} ({cause['family']}): {values}")
    lines += ["", "Hidden     " + ", ".join(f"{k} {v:.4g}" for k, v in found["twin"].items() if isinstance(v, float)),
              "           without noise the analytic model misses it by "
              + " and ".join(f"{value:.4f} deg at {case}" for case, value in twin.items())]
    return "\n".join([*lines, *(f"Note       {note}" for note in found["notes"])])


def _training(found: dict[str, Any]) -> list[str]:
    """Table I of the paper, and its network's training here."""
    here, there = found["training"], found["published"]["training"]
    (seconds,) = (row["seconds"] for row in found["rows"] if row["model"].endswith("Elman"))
    head = f"{'Training':11s}{'iterations':>11s}{'seconds':>9s}{'MSE':>10s}{'of range':>10s}{'gradient':>10s}"
    lines = [f"{head}{'mu':>10s}{'gamma':>8s}{'weights':>9s}"]
    for name, t, s in (("published", there, there["seconds"]), ("here", here, seconds)):
        lines.append(f"{name:11s}{t['iterations']:11d}{s:9.0f}{t['mse']:10.3g}{100.0 * t['rmse_of_range']:8.2f} %"
                     f"{t['gradient']:10.3g}{t['mu']:10.3g}{t['gamma']:8.1f}{t['n_weights']:9d}")
    return [*lines, f"here, best of {len(here['starts_mse'])} starts: {here['why']}"]


def _number(value: float | None, width: int) -> str:
    return f"{'-':>{width}s}" if value is None else f"{value:{width}.4f}"


def _percent(share: float | None) -> str:
    return f"{'-':>9s}" if share is None else f"{100.0 * share:7.1f} %"
