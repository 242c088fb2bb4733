"""trial.json as tables: every figure with its interval and its target."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pamid.trial.cases import OPEN
from pamid.trial.machine import ONE_DOF, TWO_LINK


@dataclass(frozen=True)
class FigureRow:
    """A figure of trial.json. target: in the unit shown; upward: whether more is better."""

    section: str
    key: str
    title: str
    target: float | None = None
    upward: bool = True
    unit: str = "%"

    @property
    def factor(self) -> float:
        """A figure in the unit shown = factor x the figure in trial.json."""
        return 100.0 if self.unit in ("%", "pp") else 1.0


JOINT_ROWS = (
    FigureRow("rates", "family_first", "family named first", 90.0),
    FigureRow("rates", "family_first_slight", "... where the gap adds 10 to 30 %", 60.0),
    FigureRow("rates", "family_first_two", "family among the first two", 97.0),
    FigureRow("rates", "exact_first", "effect, or a measured look-alike, named first", 80.0),
    FigureRow(
        "rates", "family_first_of_ranking", "family first in the ranking, whatever the verdict"
    ),
    FigureRow("rates", "port", "port of the gap right", 95.0),
    FigureRow("rates", "ambiguous_holds", '"cannot tell A from B": the truth is among them'),
    FigureRow("rates", "wrong_abstention", "known effect called unknown", 10.0, upward=False),
    FigureRow("rates", "missed", "visible effect called no gap"),
    FigureRow("rates", "left_open", "visible effect left open: cannot tell"),
    FigureRow("rates", "extra_causes", "a single effect explained by two or more"),
    FigureRow("rates", "both_of_two", "both of two effects found, their common gap visible"),
    FigureRow("rates", "both_seen", "... each of them visible in addition to the other", 65.0),
    FigureRow("rates", "one_of_two", "either or both of two effects found", 95.0),
    FigureRow(
        "rates",
        "wrong_beside_right",
        "a wrong cause with P > 0.5 in addition to a right cause",
        3.0,
        upward=False,
    ),
    FigureRow("rates", "false_alarm", "alarm where nothing is planted", 3.0, upward=False),
    FigureRow("rates", "named_in_vain", "... a cause named", 2.0, upward=False),
    FigureRow("rates", "left_open_in_vain", "... left open: cannot tell"),
    FigureRow("rates", "false_alarm_clean", "... without background"),
    FigureRow("rates", "false_alarm_background", "... with background"),
    FigureRow("rates", "abstains", "effect outside the catalogue called unknown"),
    FigureRow("rates", "abstains_plain", "... where its gap is twice the rest"),
    FigureRow("rates", "abstains_withheld", "... withheld from the catalogue"),
    FigureRow("rates", "abstains_nameless", "... never in any catalogue"),
    FigureRow(
        "rates",
        "leaves_nameless",
        "... or real, with no cause named or over half of the gap remaining",
        88.0,
    ),
    FigureRow("rates", "unknown_port", "port of an effect outside the catalogue right", 85.0),
    FigureRow("figures", "ece", "expected calibration error, 10 bins", 0.05, upward=False, unit=""),
    FigureRow("figures", "brier", "Brier score", unit=""),
    FigureRow("figures", "brier_skill", "Brier skill", unit=""),
    FigureRow("figures", "aurc", "risk over coverage, area", upward=False, unit=""),
    FigureRow(
        "figures",
        "shrinkage_error",
        "predicted shrinkage off by (median)",
        4.0,
        upward=False,
        unit="pp",
    ),
    FigureRow("figures", "shrinkage_bias", "... too high by (median)", unit="pp"),
    FigureRow("rates", "shrinkage_covered", "achieved shrinkage inside the 95 % interval", 90.0),
    FigureRow("figures", "seconds", "CPU seconds of a diagnosis (median)", unit="s"),
    FigureRow("figures", "seconds_worst", "... of the slowest", unit="s"),
    FigureRow("baselines", "most_common_family", "always the most common family"),
    FigureRow("baselines", "shuffled_labels", "random labels"),
)
_OPEN_ROWS = (
    FigureRow("rates", "open_right", "leader named, remainder reported, claims hold", 88.0),
    FigureRow("rates", "open_leader", "... leader named first, or in a set of two"),
    FigureRow("rates", "open_lesser", "a lesser effect named instead"),
    FigureRow("rates", "open_wrong", "none of the named effects acts", 5.0, upward=False),
    FigureRow("rates", "open_left_open", "nothing named"),
    FigureRow("rates", "open_remainder", "size and place of the remainder reported"),
    FigureRow("rates", "open_claims", "removed share at least as large as reported"),
)
# rates that mean something only where an effect, or two, are the whole gap
_CLOSED_ONLY = (
    "extra_causes",
    "both_of_two",
    "both_seen",
    "one_of_two",
    "wrong_beside_right",
    "false_alarm_clean",
    "false_alarm_background",
    "abstains_withheld",
)
_OPEN_TARGETS = {"false_alarm": 3.0, "leaves_nameless": 88.0, "ece": 0.08}
_ARM_TARGETS = {"family_first": 88.0, "port_exact": 85.0, "ece": 0.08}
_ARM_ROWS = [replace(row, target=_ARM_TARGETS.get(row.key)) for row in JOINT_ROWS]
_ARM_ROWS.insert(
    next(i for i, row in enumerate(_ARM_ROWS) if row.key == "port") + 1,
    FigureRow(
        "rates",
        "port_exact",
        "... by the first of the ranking, with the number of joint or muscle",
        _ARM_TARGETS["port_exact"],
    ),
)
_ROWS_OF = {ONE_DOF: JOINT_ROWS, TWO_LINK: tuple(_ARM_ROWS)}
_STARTER_TARGETS = {"family_first": 85.0, "port": 92.0, "false_alarm": 3.0}
_STARTER_ROWS = tuple(replace(row, target=_STARTER_TARGETS.get(row.key)) for row in JOINT_ROWS)
TABLE_HEAD = ("", "measured", "95 %", "of", "target")
TITLES = {
    "family_first": "family first",
    "exact_first": "exact first",
    "detected": "detected",
    "false_alarm": "false alarm",
}


def rows_of(scores: Mapping[str, Any]) -> tuple[FigureRow, ...]:
    """The rows of the trial of this rig; a trial.json without a rig is of the joint."""
    rows = _ROWS_OF.get(scores.get("rig", ONE_DOF), _STARTER_ROWS)
    if scores.get("world") != OPEN:
        return rows
    shared = (row for row in rows if row.key not in _CLOSED_ONLY)
    return (*_OPEN_ROWS, *(replace(row, target=_OPEN_TARGETS.get(row.key)) for row in shared))


def trial_text(scores: dict[str, Any]) -> str:
    """Everything in trial.json for a terminal."""
    lines = [summary(scores), ""]
    rows = [TABLE_HEAD, *(cells(scores, row) for row in rows_of(scores))]
    width = max(len(row[0]) for row in rows)
    lines += [f"{r[0]:{width}s} {r[1]:>9s} {r[2]:>17s} {r[3]:>4s} {r[4]:>11s}" for r in rows]
    for dimension, table in strata(scores).items():
        lines += ["", f"{dimension:24s}" + "".join(f"{t:>18s}" for t in TITLES.values())]
        lines += [f"{name:24s}" + "".join(f"{cell:>18s}" for cell in row) for name, row in table]
    if scores["reliability"]:
        lines += ["", f"{'stated probability':24s}{'mean':>18s}{'right':>18s}"]
        lines += [
            f"{b['low']:.1f} to {b['high']:.1f}".ljust(24)
            + f"{b['said']:18.2f}{_share(b['right']):>18s}"
            for b in scores["reliability"]
        ]
    if scores["confusion"]:
        lines += ["", "planted -> named first (visible single effects)"]
    lines += [
        f"{family:24s} " + ", ".join(f"{answer} {n}" for answer, n in answers.items())
        for family, answers in scores["confusion"].items()
    ]
    lines += [f"failed: case {number}: {why}" for number, why in scores["failures"].items()]
    return "\n".join(lines)


def summary(scores: dict[str, Any]) -> str:
    """How many cases there are, and how many of them count."""
    failed, unseen = scores["rates"]["failed"]["hits"], scores["rates"]["unseen"]
    hidden, planted = unseen["hits"], unseen["of"]
    visibility = "all planted gaps show" if planted else "nothing was planted"
    if hidden:
        visibility = f"{hidden} of {planted} planted gaps do not show and count for detection only"
    rig = "" if scores.get("rig", ONE_DOF) == ONE_DOF else f" of rig {scores['rig']}"
    world = " in an open world" if scores.get("world") == OPEN else ""
    return (
        f"Blind trial{rig}{world}, part {scores['part']}, seed {scores['seed']}: "
        f"{scores['cases']} cases, {failed} failed; {visibility}."
    )


def cells(scores: dict[str, Any], row: FigureRow) -> tuple[str, ...]:
    """title, measured, interval, number of cases, target."""
    at = scores[row.section][row.key]
    value = at["value"] if row.section == "figures" else at["share"]
    write: Callable[[float], str] = (
        (lambda v: f"{v:.3f}") if row.unit == "" else (lambda v: f"{v:.1f}")
    )
    unit = f" {row.unit}" if row.unit else ""
    sign = ">=" if row.upward else "<="
    measured = "-" if value is None else write(row.factor * value) + unit
    sure = at["low"] is not None and value is not None
    interval = (
        f"{write(row.factor * at['low'])} .. {write(row.factor * at['high'])}" if sure else ""
    )
    aim = "" if row.target is None else f"{sign} {row.target:g}{unit}"
    return row.title, measured, interval, str(at["of"]), aim


def strata(scores: dict[str, Any]) -> dict[str, list[tuple[str, list[str]]]]:
    """dimension -> (bin, rates as text) in the order of TITLES."""
    return {
        dimension: [(name, [_share(rates[key]) for key in TITLES]) for name, rates in bins.items()]
        for dimension, bins in scores.get("strata", {}).items()
    }


def _share(rate: dict[str, Any]) -> str:
    return f"{100.0 * rate['share']:.0f} % ({rate['hits']}/{rate['of']})" if rate["of"] else "-"
