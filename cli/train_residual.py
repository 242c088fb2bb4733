"""`pamid train-residual`: a network for what a fitted model leaves over."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .progress import Progress

if TYPE_CHECKING:
    from pamid.networks.training import Step

EXAMPLE = """
pamid train-residual RUN --network elman --hidden 10 --iterations 1000
"""


@frame.command("train-residual", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--network", default="elman", show_default=True, help="Kind of network; this version has elman.")
@click.option("--hidden", type=click.IntRange(1, 200), default=10, show_default=True, help="Hidden units.")
@click.option("--iterations", type=click.IntRange(0), default=1000, show_default=True,
              help="Levenberg-Marquardt steps at most, for every start.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Same run and seed, same network.")
@click.option("--starts", type=click.IntRange(1, 1000), default=1, show_default=True,
              help="Random starts; the best is kept.")
@click.option("--resume", is_flag=True, help="Go on from where the same training was interrupted.")
@click.option("--channel", help="Output to correct. [default: angle_deg, else the first of the run]")
@click.option("--inputs", metavar="A,B,...", help="Columns of residual.csv the network is given. "
              "[default: reference and the model in its own loop; else inputs of the rig and refitted outputs]")
def command(run: Path, network: str, hidden: int, iterations: int, seed: int, starts: int, resume: bool,
            channel: str | None, inputs: str | None) -> frame.Result:
    """Train a recurrent network on measured - refitted model of the run folder RUN, on its fitted part, and judge it
    on the held-out part.

    Writes network.json, network.npz and trace.csv and adds the corrected model to residual.csv. Interrupted, it keeps
    what it has reached; --resume with the same options goes on from there as if nothing had happened.
    """
    from pamid.errors import PamidError
    from pamid.leftover import FIT_FILE, RESIDUAL_FILE, read_leftover
    from pamid.residual_network import CHECKPOINT_FILE, require_network, train_correction, write_correction
    from pamid.run import Run

    require_network(network)
    folder = Run.open(run)
    names = tuple(word.strip() for word in (inputs or "").split(",") if word.strip())
    leftover = read_leftover(run, channel, names)
    folder.begin_step(command=sys.argv, seed=seed, inputs=[run / FIT_FILE, run / RESIDUAL_FILE],
                      options={"network": network, "hidden": hidden, "iterations": iterations, "starts": starts,
                               "resume": resume, "channel": leftover.channel, "inputs": list(leftover.inputs)})

    def told(step: Step, start: int) -> None:
        which = f"start {start + 1} of {starts}, " if starts > 1 else ""
        progress.update(step.iteration, f"{which}MSE {step.mse:.4g}, gamma {step.gamma:.1f}")

    try:
        with Progress("train-residual", iterations) as progress:
            found = train_correction(leftover, kind=network, hidden=hidden, iterations=iterations, seed=seed,
                                     starts=starts, checkpoint=folder.path(CHECKPOINT_FILE), resume=resume,
                                     progress=told)
        about = write_correction(folder, found)
    except (PamidError, KeyboardInterrupt) as error:
        folder.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    folder.finish("interrupted" if found.interrupted else "done")
    if found.interrupted:
        click.echo(training_text(about, run), err=True)
        raise KeyboardInterrupt
    stuck = not about["training"]["converged"] and about["training"]["iterations"] < iterations
    return frame.Result(about, training_text(about, run), 5 if stuck else 0)


def training_text(about: dict[str, Any], run: Path) -> str:
    """Network, end of the training and held-out errors, for people."""
    t, sizes, channel = about["training"], about["sizes"], about["output"]["name"]
    errors = about["mae"][channel]
    lines = [f"{about['kind']} {sizes['inputs']}-{sizes['hidden']}-1, {about['n_weights']} weights: {about['target']}",
             f"inputs    {', '.join(one['name'] for one in about['inputs'])}"]
    lines += [f"note      {note}" for note in about["notes"]]
    lines += [f"training  {t['iterations']} iterations, {t['why']}",
              f"          MSE {t['mse']:.4g} (scaled into [-1, 1]), gradient {t['gradient']:.3g}, mu {t['mu']:.3g}",
              f"          gamma {t['gamma']:.1f} of {about['n_weights']} weights; {t['samples']} samples, "
              f"worth {t['effective_samples']:.0f} independent ones"]
    lines += [f"          {t['remark']}"] if t["remark"] else []
    lines += ["", f"{'held-out MAE of ' + channel:34s} {'model':>12s} {'with network':>12s}"]
    for ending, label in (("", "all of it"), ("_after_1_s", "without 1 s of start-up")):
        if f"refitted{ending}" in errors:
            lines.append(f"{label:34s} {errors['refitted' + ending]:12.4g} {errors['with_network' + ending]:12.4g}")
    if errors["with_network"] >= errors["refitted"]:
        lines.append("On what it was not trained on, this network does not help.")
    lines.append(f"Next: pamid report {run}")
    return "\n".join(lines)
