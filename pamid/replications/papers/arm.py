"""`pamid reproduce-paper --paper arm`: the second paper's validation of an arm of two links:
gravity tests without actuation and pulses on the valves that no fit has seen, for the data sheet
and for models fitted in stages, with the analytic force law of the muscles and with an ANFIS
trained on a measured force map; what is known of the inertial data, and what is not.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pamid.replications.arm_paper import ArmPlan
from pamid.replications.arm_paper import reproduce_arm as reproduce
from pamid.replications.reproducing import number_cell

__all__ = ["OPTIONS", "plan", "reproduce", "text", "converged"]

OPTIONS = ()
#: columns of the tables: key, heading
_MODELS = {
    "data_sheet": "data sheet",
    "without_dry_friction": "no dry fr.",
    "analytic_alone": "analytic",
    "anfis_alone": "ANFIS",
    "fitted_analytic": "analytic",
    "fitted_anfis": "ANFIS",
    "noise_floor": "noise",
}
_UNLOADED = "without_payload"
_TITLES = {"gravity": "Gravity tests", "pulses": "Valve pulses"}


def plan(*, seed: int, quick: bool) -> ArmPlan:
    """quick: short swings and two muscles, coarsely sampled."""
    return ArmPlan.quickly(seed) if quick else ArmPlan(seed=seed)


def converged(paper: dict[str, Any]) -> bool:
    """Did every fit?"""
    return all(fit["converged"] for fit in paper["fits"].values())


def text(paper: dict[str, Any]) -> str:
    """The errors of all variables, what is known of the inertial data and of the rest, and what all
    of it is not."""
    lines = (
        [
            "QUICK: short swings and two muscles are too little; these figures only show that it "
            "runs.",
            "",
        ]
        if paper["quick"]
        else []
    )
    lines += [
        "The second paper's validation on a virtual arm, not the authors' arm.",
        "Mean absolute errors of recordings that no fit has seen:",
        "",
        f"{'':46s}{'law alone':>22s}{'with corrections':>22s}",
    ]
    for kind, title in _TITLES.items():
        lines += _errors(f"{title}, free runs", paper["mae"][kind].items())
    lines.append("Angles again, in windows whose states are set anew, as `pamid fit` judges them")
    for kind, title in _TITLES.items():
        lines += _errors(
            title,
            [item for item in paper["windowed_mae"][kind].items() if item[1]["unit"] == "deg"],
        )
    lines += _coupling(paper["coupling"])
    target, in_the_end = paper["target"], paper["tied"]["fitted_anfis"]
    still = {name for tie in in_the_end for name in tie["parameters"]}
    unloaded = [tie for tie in paper["tied"][_UNLOADED] if still & set(tie["parameters"])]
    lines += [
        f"Target     fitted angles of the gravity tests within {100.0 * target['share']:.0f} % of "
        f"the noise: {'reached' if target['reached'] else 'NOT reached'} (at most "
        f"{target['worst']:.3f} times)",
        f"Force law  {paper['force_law']['finding']}",
        "",
        *_combinations(paper["combinations"]),
        *_tied("Known only in combination", in_the_end),
        *_tied("Without the payload test", unloaded),
        "",
        *_parameters(paper["parameters"]),
        "",
    ]
    lines += [
        f"Not converged: {name}: {fit['why']}"
        for name, fit in paper["fits"].items()
        if not fit["converged"]
    ]
    return "\n".join(
        [
            *lines,
            f"Hidden     muscles: {paper['twin']['law']}; the rest as in the column truth",
            *(f"Note       {note}" for note in paper["notes"]),
        ]
    )


def _errors(title: str, variables: Iterable[tuple[str, dict[str, Any]]]) -> list[str]:
    return [
        f"{title:24s}" + "".join(f"{word:>11s}" for word in _MODELS.values()),
        *(
            f"{name.rsplit('_', 1)[0] if name.endswith(('_deg', '_kpa')) else name:18s}{cells['unit']:6s}"  # noqa: E501
            + "".join(number_cell(cells.get(key), 11) for key in _MODELS)
            for name, cells in variables
        ),
        "",
    ]


def _coupling(each: list[dict[str, Any]]) -> list[str]:
    """Motion of a joint under pulses on the other."""
    head = ("joint", "moves by", "data sheet", "uncoupled", "fitted", "noise")
    names = ("data_sheet", "without_coupling", "fitted", "noise_floor")
    return [
        "Coupling: the angle of a joint while only the other joint's valves are pulsed, deg",
        f"{head[0]:24s}" + "".join(f"{word:>11s}" for word in head[1:]),
        *(
            f"{estimate['moved'].rsplit('_', 1)[0]:24s}{estimate['swing_deg']:11.3f}"
            + "".join(number_cell(estimate["mae"].get(name), 11) for name in names)
            for estimate in each
        ),
        "",
    ]


def _combinations(estimates: dict[str, Any]) -> list[str]:
    """Parameter combinations that the motion depends on, with and without the test that sets the
    common factor."""
    return [
        f"{'Inertial data':28s}{'data sheet':>11s}{'truth':>11s}{'without the payload test':>38s}"
        f"{'all gravity tests':>38s}",
        *(
            f"{name:28s}{estimate['data_sheet']:11.4g}{estimate['truth']:11.4g}{_estimate_cell(estimate[_UNLOADED])}{_estimate_cell(estimate['gravity'])}"
            for name, estimate in estimates.items()
        ),
    ]


def _parameters(estimates: dict[str, Any]) -> list[str]:
    return [
        f"{'Parameter':28s}{'data sheet':>11s}{'truth':>11s}{'fitted, analytic law':>38s}"
        f"{'fitted, ANFIS law':>38s}",
        *(
            f"{name:28s}{estimate['data_sheet']:11.4g}{estimate['truth']:11.4g}{_estimate_cell(estimate['fitted_analytic'])}"
            f"{_estimate_cell(estimate['fitted_anfis'])}"
            for name, estimate in estimates.items()
        ),
        "* the interval does not hold the truth",
    ]


def _estimate_cell(table: dict[str, Any]) -> str:
    """Value and 95 % interval."""
    text = f"{table['value']:.4g} ({table['low']:.4g} .. {table['high']:.4g})"
    return f"{text:>37s}{'*' if table['holds'] is False else ' '}"


def _tied(title: str, ties: list[dict[str, Any]]) -> list[str]:
    """Parameters that are known only in combination, and the combinations."""
    return [
        f"{title}: {', '.join(tie['parameters'])} through "
        + ", ".join(f"{name} = {value:.4g}" for name, value in tie["known"].items())
        for tie in ties
    ]
