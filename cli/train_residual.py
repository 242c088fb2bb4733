"""`pamid train-residual`: Train a network on what a fitted model leaves over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame, names
from .options import seed_option
from .terminal import aside, progress_line, quoted

HELP_ORDER = 60
EXAMPLE = """
pamid train-residual fitted --network elman --hidden 10 --iterations 100
pamid train-residual fitted --network anfis --inputs angle_loop_deg,velocity_loop_deg_per_s --iterations 20
pamid train-residual fitted --port joint --iterations 20
"""  # noqa: E501


@frame.command("train-residual", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--network",
    default="elman",
    show_default=True,
    help=f"Kind of network: {names.listed(names.network_sizes())}.",
)
@names.size_options
@click.option(
    "--iterations",
    type=click.IntRange(0),
    help="Levenberg-Marquardt steps at most, for every start. [default: 1000, or 5000 with "
    "--preset paper]",
)
@seed_option(
    "Same run and seed, same network on the same kind of processor. Other processors round "
    "differently, so a long training ends at other weights."
)
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=1,
    show_default=True,
    help="Random starts. The worse half is dropped at iterations 10, 20, 40, 80 and 160, and the "
    "best start is kept.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    help="Cores to use; the result does not depend on it. [default: all]",
)
@click.option(
    "--evidence",
    type=click.Choice(["every-sample", "independent-samples"]),
    default="every-sample",
    show_default=True,
    help="Samples that the regularisation counts: all of them, as in the first paper, or the far "
    "smaller effective number of independent samples in a correlated residual.",
)
@click.option(
    "--preset",
    type=click.Choice(["paper"]),
    help="paper: train as in the first paper, with plain Levenberg-Marquardt steps from a random "
    "start (Nguyen-Widrow), no acceleration, no weights solved for, no bound on the context, fixed "
    "factors for mu, 5000 steps. The derivative through time stays exact.",
)
@click.option("--as-in-paper", is_flag=True, hidden=True, help="Earlier name of --preset paper.")
@click.option(
    "--mu", type=float, help="Initial damping. [default: 0.005, as in MATLAB and the paper]"
)
@click.option(
    "--mu-increase",
    type=float,
    help="Factor of mu after a rejected step. [default: 3; 10 with --preset paper]",
)
@click.option(
    "--mu-decrease",
    type=float,
    help="Factor of mu after an accepted step. [default: by the gain of the step; 0.1 with "
    "--preset paper]",
)
@click.option("--mu-largest", type=float, help="Value of mu that ends training. [default: 1e10]")
@click.option(
    "--device",
    help="Device on which torch computes elman or narx networks, all starts together: cpu or cuda. "
    "[default: the compiled kernels, on the processor]",
)
@click.option(
    "--port",
    "--at",
    "at",
    default="output",
    show_default=True,
    metavar="output|PORT",
    help="Place of the correction. output: added to one output of the model; PORT: added to the "
    "value at a port of the rig, as joint or muscle_1 (`pamid rigs RIG` lists them), which "
    "needs the recordings.",
)
@click.option(
    "--on",
    type=click.Choice(["refit", "causes"]),
    default="refit",
    show_default=True,
    help="Model of the residual. refit: the refitted model; causes: the model with the causes of a "
    "diagnosis, replayed on recorded commands.",
)
@click.option(
    "--rig",
    help="With --port PORT, for a run with a rig file: its path (it is run).",
)
@click.option("--resume", is_flag=True, help="Continue the same training where it was interrupted.")
@click.option(
    "--channel", help="Output to correct. [default: angle_deg, else the first of the run]"
)
@click.option(
    "--inputs",
    metavar="A,B,...",
    help="Columns of residual.csv that are inputs of the network. "
    "[default: reference and the model in closed loop; else inputs of the rig and the model's "
    "outputs]",
)
def command(
    run: Path,
    network: str,
    iterations: int | None,
    seed: int,
    starts: int,
    jobs: int | None,
    evidence: str,
    preset: str | None,
    as_in_paper: bool,
    mu: float | None,
    mu_increase: float | None,
    mu_decrease: float | None,
    mu_largest: float | None,
    device: str | None,
    at: str,
    on: str,
    rig: str | None,
    resume: bool,
    channel: str | None,
    inputs: str | None,
    **sizes: int | None,
) -> frame.Result:
    """Train a network on the residual of the model in the run folder RUN, and score it on held-out
    data.

    The residual is measured - model, or with --port PORT the missing input of the equations there.
    --on causes uses the model with the causes of a diagnosis.

    Writes network.json, network.npz and trace.csv, and adds the corrected model to residual.csv. An
    interrupted training keeps its state. --resume with the same options continues it, with the same
    result as without an interruption.
    """
    from pamid.api.training import USUAL_ITERATIONS, train_residual
    from pamid.networks.training_problem import PAPER_ITERATIONS

    as_in_paper = as_in_paper or preset == "paper"
    given = tuple(word.strip() for word in (inputs or "").split(",") if word.strip())
    if iterations is None:
        iterations = PAPER_ITERATIONS if as_in_paper else USUAL_ITERATIONS
    with progress_line("train-residual", iterations) as progress:
        result = train_residual(
            run,
            network=network,
            iterations=iterations,
            seed=seed,
            starts=starts,
            jobs=jobs,
            evidence=evidence,
            as_in_paper=as_in_paper,
            mu=mu,
            mu_increase=mu_increase,
            mu_decrease=mu_decrease,
            mu_largest=mu_largest,
            device=device,
            at=at,
            on=on,
            rig=rig,
            channel=channel,
            inputs=given,
            resume=resume,
            progress=progress,
            command=frame.command_line(),
            **sizes,
        )
    about = result.to_dict()
    text = training_text(about, run)
    if result.interrupted:
        aside(text)
        raise KeyboardInterrupt
    stuck = not result.converged and result.iterations < iterations
    return frame.Result(about, text, 5 if stuck else 0)


def training_text(about: dict[str, Any], run: Path) -> str:
    """Network, end of the training and held-out errors, as text."""
    t, n = about["training"], about["n_weights"]
    lines = [
        f"{network_words(about['kind'], about['sizes'])}, {n} weights: {about['target']}",
        f"inputs    {', '.join(input_['name'] for input_ in about['inputs'])}",
    ]
    lines += [f"note      {note}" for note in about["notes"]]
    way = ", plain steps as in the paper" if t.get("plain") else ""
    lines += [
        f"training  {t['iterations']} iterations{way}, {t['why']}",
        f"          MSE {t['mse']:.4g} (scaled into [-1, 1]), gradient {t['gradient']:.3g}, mu "
        f"{t['mu']:.3g}",
    ]
    if len(t["starts_mse"]) > 1:
        ends = ", ".join("diverged" if mse is None else f"{mse:.3g}" for mse in t["starts_mse"])
        lines.append(f"          MSE of every start: {ends}; number {t['start'] + 1} is kept")
    lines += [
        f"weights   gamma {t['gamma']:.1f} of {n} are used, every one of {t['samples']} samples "
        "counted",
        f"          {t['supported_weights']:.1f} of {n} are supported, counting the "
        f"{t['effective_samples']:.0f} independent samples they are worth",
        "seed      reproduces this network on the same kind of processor; others round differently",
    ]
    return "\n".join([*lines, "", *errors_table(about), f"Next: pamid report {quoted(run)}"])


def errors_table(about: dict[str, Any]) -> list[str]:
    """Held-out errors of the model and of the corrected ones, channel by channel."""
    at = about["enters"]["port"] if isinstance(about["enters"], dict) else "output"
    columns = {
        "refitted": "refitted",
        "with_cause": "with causes",
        "with_output_network": "at output",
        "with_network": f"at {at}",
    }
    before = "with_cause" if about["on"] == "causes" else "refitted"
    for name, absent in (
        ("with_cause", before == "refitted"),
        ("with_output_network", at == "output"),
    ):
        if absent:
            del columns[name]
    lines = []
    for ending, title in (
        ("", "held-out mean absolute error"),
        ("_after_1_s", "... without 1 s of start-up"),
    ):
        rows = {
            channel: [errors.get(f"{name}{ending}") for name in columns]
            for channel, errors in about["mae"].items()
            if f"refitted{ending}" in errors
        }  # windows may be shorter than that
        lines += (
            [f"{title:34s}" + "".join(f" {word:>12s}" for word in columns.values())] if rows else []
        )
        lines += [
            f"{channel:34s}" + "".join(f" {'-' if e is None else f'{e:.4g}':>12s}" for e in row)
            for channel, row in rows.items()
        ]
    if at != "output":
        lines += [
            f"A correction at {at} enters the equations and changes every channel; one at the "
            "output changes only its channel.",
            "Its model has the parameters that were estimated together with the missing input "
            "(network.json).",
        ]
    if all(errors["with_network"] >= errors[before] for errors in about["mae"].values()):
        lines.append("This network does not reduce the held-out error.")
    return lines


def network_words(kind: str, sizes: dict[str, Any]) -> str:
    """Kind and sizes in the usual notation: elman 5-10-1; anfis 5x5 = 25 rules."""
    from pamid.networks.trained_network import network_kinds

    return network_kinds()[kind](**sizes).words()
