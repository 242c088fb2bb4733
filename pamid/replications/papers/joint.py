"""`pamid reproduce-paper --paper joint`: the first paper's results next to the published results:
the analytic model, the refitted model, the analytic model with an Elman network, the model with the
causes that `diagnose` names; trained at 6.4 times the nominal inertia, tested on steps there and at
the nominal inertia. Interrupted, the network keeps what it has reached.
"""

from __future__ import annotations

from typing import Any

from pamid.replications.joint_paper import JointPlan, reproduce
from pamid.replications.reproducing import number_cell

__all__ = ["OPTIONS", "plan", "reproduce", "text", "converged"]

OPTIONS = ("iterations", "starts", "seconds", "jobs", "resume")
QUICK_S, QUICK_ITERATIONS = 30.0, 30


def plan(
    *,
    seed: int,
    quick: bool,
    iterations: int | None = None,
    starts: int = JointPlan.starts,
    seconds: float | None = None,
    jobs: int = JointPlan.jobs,
) -> JointPlan:
    """seconds: of the training record; iterations, starts: of the network; jobs: processes for the
    diagnosis."""
    return JointPlan(
        seconds or (QUICK_S if quick else JointPlan.seconds),
        iterations or (QUICK_ITERATIONS if quick else JointPlan.iterations),
        starts,
        seed,
        jobs,
        quick,
    )


def converged(paper: dict[str, Any]) -> bool:
    """A network that ends at the most iterations is a result, too."""
    return True


def text(paper: dict[str, Any]) -> str:
    """The table, the training next to the paper's, the causes, and what all of it is not."""
    cases = list(paper["rows"][0]["mae"])
    plan, twin = paper["plan"], paper["twin"]["analytic_mae_without_noise"]
    lines = (
        [
            f"QUICK: {plan['seconds']:g} s and {plan['iterations']} iterations are too few; these "
            "figures only show that it runs.",
            "",
        ]
        if paper["quick"]
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
    for row in paper["rows"]:
        cells = "".join(
            number_cell(row["published"].get(c), 11)
            + number_cell(row["mae"][c], 9)
            + number_cell(row["mae_after_1_s"][c], 10)
            + _percent(row["improvement"][c])
            for c in cases
        )
        seconds = row["seconds"]
        lines.append(
            f"{row['model']:28s}{cells}"
            + (f"{seconds:9.0f}" if seconds is not None else f"{'-':>9s}")
        )
    lines.append(
        f"Published: with its network {100.0 * paper['published']['improvement']:.1f} % lower at "
        f"{cases[0]}."
    )
    if any("spring kept" in row["model"] for row in paper["rows"]):
        lines.append(
            "Spring kept: as the load behind the spring changes, that spring and the inertia "
            "before it stay; "
            "in the row above, the share of the inertia and the frequency stay as they were found."
        )
    lines += ["", *_training(paper), "", f"Diagnosis  {paper['diagnosis']['sentence']}"]
    for cause in paper["diagnosis"]["causes"]:
        values = ", ".join(
            f"{k} {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
            for k, v in cause["parameters"].items()
        )
        lines.append(f"           {cause['effect']} ({cause['family']}): {values}")
    lines += [
        "",
        "Hidden     "
        + ", ".join(f"{k} {v:.4g}" for k, v in paper["twin"].items() if isinstance(v, float)),
        "           without noise the analytic model misses it by "
        + " and ".join(f"{value:.4f} deg at {case}" for case, value in twin.items()),
    ]
    return "\n".join([*lines, *(f"Note       {note}" for note in paper["notes"])])


def _training(paper: dict[str, Any]) -> list[str]:
    """Table I of the paper, and its network's training here."""
    here, there = paper["training"], paper["published"]["training"]
    (seconds,) = (row["seconds"] for row in paper["rows"] if row["model"].endswith("Elman"))
    head = f"{'Training':11s}{'iterations':>11s}{'seconds':>9s}{'MSE':>10s}{'of range':>10s}{'gradient':>10s}"  # noqa: E501
    lines = [f"{head}{'mu':>10s}{'gamma':>8s}{'weights':>9s}"]
    for name, t, s in (("published", there, there["seconds"]), ("here", here, seconds)):
        lines.append(
            f"{name:11s}{t['iterations']:11d}{s:9.0f}{t['mse']:10.3g}{100.0 * t['rmse_of_range']:8.2f} %"  # noqa: E501
            f"{t['gradient']:10.3g}{t['mu']:10.3g}{t['gamma']:8.1f}{t['n_weights']:9d}"
        )
    return [*lines, f"here, best of {len(here['starts_mse'])} starts: {here['why']}"]


def _percent(share: float | None) -> str:
    return f"{'-':>9s}" if share is None else f"{100.0 * share:7.1f} %"
