"""`pamid reproduce-paper`: The results of the two papers, on calibrated virtual rigs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from . import frame
from .progress_bar import ProgressBar

PLACE = 90
EXAMPLE = """
pamid reproduce-paper --quick --output paper-run
pamid reproduce-paper --paper arm --quick --output arm-run
"""
QUICK_S, QUICK_ITERATIONS = 30.0, 30
_JOINT_ONLY = ("iterations", "starts", "seconds", "jobs", "resume")


@frame.command("reproduce-paper", example=EXAMPLE)
@click.option(
    "--paper",
    type=click.Choice(["joint", "arm"]),
    default="joint",
    show_default=True,
    help="The first paper, of a joint, or the second, of an arm of two links.",
)
@click.option(
    "--iterations",
    type=click.IntRange(1),
    help="Levenberg-Marquardt steps at most, for every start. "
    "(joint) [default: 1000; 30 with --quick]",
)
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=4,
    show_default=True,
    help="Random starts of the network; the best is kept. (joint)",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Of excitation, noise and networks.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(12.0, 3600.0),
    help="Length of the training record. (joint) [default: 200; 30 with --quick]",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=2,
    show_default=True,
    help="Processes for the diagnosis. (joint)",
)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("paper-run"),
    show_default=True,
    help="Run folder to make.",
)
@click.option("--quick", is_flag=True, help="Short records and few iterations, to see it work.")
@click.option(
    "--resume", is_flag=True, help="Go on from where the same command was interrupted. (joint)"
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(paper: str, output: Path, overwrite: bool, **request: Any) -> frame.Result:
    """Print the results tables of the papers on twins of their rigs.

    joint: the first paper's, beside the published one: the analytic model, the refitted model, the
    analytic model with an Elman network, the model with the causes that `diagnose` names; trained
    at 6.4 times the nominal inertia, tested on steps there and at the nominal one. Interrupted, the
    network keeps what it has reached.

    arm: the second paper's validation of an arm of two links: gravity tests without actuation and
    pulses on the valves that no fit has seen, for the data sheet and for models fitted in stages,
    with the analytic force law of the muscles and with an ANFIS trained on a measured force map;
    what is known of the inertial data, and what is not.

    The rigs are virtual twins, not the authors'.
    """
    if paper == "arm":
        _refuse_strangers()
        return _arm(output, overwrite, request["seed"], request["quick"])
    return _joint(output, overwrite, **request)


def _refuse_strangers() -> None:
    from pamid.base.errors import UsageError

    context = click.get_current_context()
    for name in _JOINT_ONLY:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise UsageError(
                f"--{name} says nothing to --paper arm.",
                "It belongs to --paper joint; the arm is done within a minute, from its beginning.",
            )


def _run_replication(
    run: Any, reproduce: Callable[..., dict[str, Any]], plan: Any, **more: Any
) -> dict[str, Any]:
    """What `reproduce` finds; the run is closed with how it ended."""
    from pamid.base.errors import PamidError

    try:
        with ProgressBar("reproduce-paper") as progress:
            found = reproduce(run, plan, progress=lambda text: progress.update(0, text), **more)
    except (PamidError, KeyboardInterrupt) as error:
        run.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    run.finish()
    return found


# ---- the first paper ---------------------------------------------------------------------------


def _joint(
    output: Path,
    overwrite: bool,
    *,
    iterations: int | None,
    starts: int,
    seed: int,
    seconds: float | None,
    jobs: int,
    quick: bool,
    resume: bool,
) -> frame.Result:
    from dataclasses import asdict

    from pamid.base.run_folder import Run
    from pamid.replications.joint_paper import JointPlan, reproduce

    plan = JointPlan(
        seconds or (QUICK_S if quick else JointPlan.seconds),
        iterations or (QUICK_ITERATIONS if quick else JointPlan.iterations),
        starts,
        seed,
        jobs,
        quick,
    )
    if resume:
        run = Run.open(output)
        run.begin_step(command=frame.command_line(), seed=seed, options=asdict(plan))
    else:
        run = Run.create(
            output,
            command=frame.command_line(),
            seed=seed,
            options=asdict(plan),
            overwrite=overwrite,
        )
    found = _run_replication(run, reproduce, plan, resume=resume)
    return frame.Result(found, table_text(found))


def table_text(found: dict[str, Any]) -> str:
    """The table, the training beside the paper's, the causes, and what all of it is not."""
    cases = list(found["rows"][0]["mae"])
    plan, twin = found["plan"], found["twin"]["analytic_mae_without_noise"]
    lines = (
        [
            f"QUICK: {plan['seconds']:g} s and {plan['iterations']} iterations are too few; these "
            "figures only show that it runs.",
            "",
        ]
        if found["quick"]
        else []
    )
    remarks = ("trained at", "never seen")
    lines += [
        f"{'':28s}"
        + "".join(f"{f'{case} ({word})':>39s}" for case, word in zip(cases, remarks, strict=True)),
        f"{'MAE of the steps, deg':28s}"
        + f"{'published':>11s}{'here':>9s}{'after 1 s':>10s}{'lower by':>9s}" * 2
        + f"{'seconds':>9s}",
    ]
    for row in found["rows"]:
        cells = "".join(
            _number(row["published"].get(c), 11)
            + _number(row["mae"][c], 9)
            + _number(row["mae_after_1_s"][c], 10)
            + _percent(row["improvement"][c])
            for c in cases
        )
        seconds = row["seconds"]
        lines.append(
            f"{row['model']:28s}{cells}"
            + (f"{seconds:9.0f}" if seconds is not None else f"{'-':>9s}")
        )
    lines.append(
        f"Published: with its network {100.0 * found['published']['improvement']:.1f} % lower at "
        f"{cases[0]}."
    )
    if any("spring kept" in row["model"] for row in found["rows"]):
        lines.append(
            "Spring kept: as the load behind the spring changes, that spring and the inertia "
            "before it stay; "
            "in the row above, the share of the inertia and the frequency stay as they were found."
        )
    lines += ["", *_training(found), "", f"Diagnosis  {found['diagnosis']['sentence']}"]
    for cause in found["diagnosis"]["causes"]:
        values = ", ".join(
            f"{k} {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
            for k, v in cause["parameters"].items()
        )
        lines.append(f"           {cause['effect']} ({cause['family']}): {values}")
    lines += [
        "",
        "Hidden     "
        + ", ".join(f"{k} {v:.4g}" for k, v in found["twin"].items() if isinstance(v, float)),
        "           without noise the analytic model misses it by "
        + " and ".join(f"{value:.4f} deg at {case}" for case, value in twin.items()),
    ]
    return "\n".join([*lines, *(f"Note       {note}" for note in found["notes"])])


def _training(found: dict[str, Any]) -> list[str]:
    """Table I of the paper, and its network's training here."""
    here, there = found["training"], found["published"]["training"]
    (seconds,) = (row["seconds"] for row in found["rows"] if row["model"].endswith("Elman"))
    head = f"{'Training':11s}{'iterations':>11s}{'seconds':>9s}{'MSE':>10s}{'of range':>10s}{'gradient':>10s}"  # noqa: E501
    lines = [f"{head}{'mu':>10s}{'gamma':>8s}{'weights':>9s}"]
    for name, t, s in (("published", there, there["seconds"]), ("here", here, seconds)):
        lines.append(
            f"{name:11s}{t['iterations']:11d}{s:9.0f}{t['mse']:10.3g}{100.0 * t['rmse_of_range']:8.2f} %"  # noqa: E501
            f"{t['gradient']:10.3g}{t['mu']:10.3g}{t['gamma']:8.1f}{t['n_weights']:9d}"
        )
    return [*lines, f"here, best of {len(here['starts_mse'])} starts: {here['why']}"]


def _number(value: float | None, width: int) -> str:
    return f"{'-':>{width}s}" if value is None else f"{value:{width}.4f}"


def _percent(share: float | None) -> str:
    return f"{'-':>9s}" if share is None else f"{100.0 * share:7.1f} %"


# ---- the second paper --------------------------------------------------------------------------

#: columns of the tables: key, heading
_MODELS = {
    "data_sheet": "data sheet",
    "analytic_alone": "analytic",
    "anfis_alone": "ANFIS",
    "fitted_analytic": "analytic",
    "fitted_anfis": "ANFIS",
    "noise_floor": "noise",
}
_UNLOADED = "without_payload"
_TITLES = {"gravity": "Gravity tests", "pulses": "Valve pulses"}


def _arm(output: Path, overwrite: bool, seed: int, quick: bool) -> frame.Result:
    from dataclasses import asdict

    from pamid.base.run_folder import Run
    from pamid.replications.arm_paper import ArmPlan, reproduce_arm

    plan = ArmPlan.quickly(seed) if quick else ArmPlan(seed=seed)
    run = Run.create(
        output,
        command=frame.command_line(),
        seed=seed,
        overwrite=overwrite,
        options={"paper": "arm", **asdict(plan)},
    )
    found = _run_replication(run, reproduce_arm, plan)
    return frame.Result(
        found, arm_text(found), 0 if all(f["converged"] for f in found["fits"].values()) else 5
    )


def arm_text(found: dict[str, Any]) -> str:
    """The errors of all variables, what is known of the inertial data and of the rest, and what all
    of it is not."""
    lines = (
        [
            "QUICK: short swings and two muscles are too little; these figures only show that it "
            "runs.",
            "",
        ]
        if (found["quick"])
        else []
    )
    lines += [
        "The second paper's validation on a virtual arm, not the authors' arm.",
        "Mean absolute errors of recordings that no fit has seen:",
        "",
        f"{'':35s}{'law alone':>22s}{'with corrections':>22s}",
    ]
    for kind, title in _TITLES.items():
        lines += _errors(f"{title}, free runs", found["mae"][kind].items())
    lines.append("Angles again, in windows whose states are set anew, as `pamid fit` judges them")
    for kind, title in _TITLES.items():
        lines += _errors(
            title, [one for one in found["windowed_mae"][kind].items() if one[1]["unit"] == "deg"]
        )
    target, in_the_end = found["target"], found["tied"]["fitted_anfis"]
    still = {name for tie in in_the_end for name in tie["parameters"]}
    unloaded = [tie for tie in found["tied"][_UNLOADED] if still & set(tie["parameters"])]
    lines += [
        f"Target     fitted angles of the gravity tests within {100.0 * target['share']:.0f} % of "
        f"the noise: {'reached' if target['reached'] else 'NOT reached'} (at most "
        f"{target['worst']:.3f} times)",
        f"Force law  {found['force_law']['finding']}",
        "",
        *_combinations(found["combinations"]),
        *_tied("Known only in combination", in_the_end),
        *_tied("Without the payload test", unloaded),
        "",
        *_parameters(found["parameters"]),
        "",
    ]
    lines += [
        f"Not converged: {name}: {one['why']}"
        for name, one in found["fits"].items()
        if not one["converged"]
    ]
    return "\n".join(
        [
            *lines,
            f"Hidden     muscles: {found['twin']['law']}; the rest as in the column truth",
            *(f"Note       {note}" for note in found["notes"]),
        ]
    )


def _errors(title: str, variables: Iterable[tuple[str, dict[str, Any]]]) -> list[str]:
    return [
        f"{title:24s}" + "".join(f"{word:>11s}" for word in _MODELS.values()),
        *(
            f"{name.rsplit('_', 1)[0] if name.endswith(('_deg', '_kpa')) else name:18s}{cells['unit']:6s}"  # noqa: E501
            + "".join(_number(cells.get(key), 11) for key in _MODELS)
            for name, cells in variables
        ),
        "",
    ]


def _combinations(estimates: dict[str, Any]) -> list[str]:
    """What the motion depends on, with and without the test that sets the common factor."""
    return [
        f"{'Inertial data':28s}{'data sheet':>11s}{'truth':>11s}{'without the payload test':>38s}"
        f"{'all gravity tests':>38s}",
        *(
            f"{name:28s}{one['data_sheet']:11.4g}{one['truth']:11.4g}{_told(one[_UNLOADED])}{_told(one['gravity'])}"
            for name, one in estimates.items()
        ),
    ]


def _parameters(estimates: dict[str, Any]) -> list[str]:
    return [
        f"{'Parameter':28s}{'data sheet':>11s}{'truth':>11s}{'fitted, analytic law':>38s}"
        f"{'fitted, ANFIS law':>38s}",
        *(
            f"{name:28s}{one['data_sheet']:11.4g}{one['truth']:11.4g}{_told(one['fitted_analytic'])}"
            f"{_told(one['fitted_anfis'])}"
            for name, one in estimates.items()
        ),
        "* the interval does not hold the truth",
    ]


def _told(one: dict[str, Any]) -> str:
    """Value and 95 % interval."""
    text = f"{one['value']:.4g} ({one['low']:.4g} .. {one['high']:.4g})"
    return f"{text:>37s}{'*' if one['holds'] is False else ' '}"


def _tied(title: str, ties: list[dict[str, Any]]) -> list[str]:
    """Parameters that are known only in combination, and the combinations."""
    return [
        f"{title}: {', '.join(tie['parameters'])} through "
        + ", ".join(f"{name} = {value:.4g}" for name, value in tie["known"].items())
        for tie in ties
    ]
