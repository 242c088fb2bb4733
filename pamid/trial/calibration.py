"""Calibration: the logistic functions behind a verdict, and how wide an interval has to be.

The probabilities are those of Platt's calibration (1999, Advances in Large Margin Classifiers),
with several features in the place of one score: of cases with features z (in standard deviations)
and answers y = -1 or 1, the weights minimise
    sum log(1 + exp(-y (w0 + w z))) + PRIOR_PRECISION |w|^2 / 2
The penalty keeps them finite where the cases can be separated without error. From which
probability on an answer is given (`yes`) follows from the rates of error that are allowed below.
Only the statistics and labels of the calibration part are used; the test part stays unseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pamid.base.errors import DataError
from pamid.base.json_file import read_json
from pamid.diagnosis.decision import Line, VerdictStatistics, features
from pamid.diagnosis.forward_selection import ForwardStep
from pamid.diagnosis.settings import DEFAULT
from pamid.trial.marking import Marked

Array = NDArray[np.float64]

CALIBRATION_SCHEMA = "pamid.calibration/1"
PRIOR_PRECISION = 1.0  # prior precision of every weight, features in their standard deviations
#: question -> features it may look at
LOOKS_AT = {
    "gap": ("visible", "missing", "of_signal", "sure"),
    "known": (
        "left",
        "shrinkage",
        "sure",
        "margin_sure",
        "at_port",
        "unexplained",
        "visible",
        "missing",
    ),
    "first": ("left", "sure", "margin", "margin_sure", "wins", "at_port", "unexplained"),
    "further": ("of_left", "sure"),
}
# rates of error that the thresholds aim at: the targets in figure_table.py, of false alarms less
# than the 3 % there, since the test cases are others
FALSE_ALARMS, WRONG_ABSTENTIONS, MISSED_UNKNOWNS = 0.02, 0.10, 0.15
COVERAGE = 0.95  # of the intervals of the shrinkage


def calibrated_from(folder: Path) -> dict[str, Any]:
    """calibration.json from the finished cases in the folder of a trial's calibration part."""
    labels = read_json(folder / "labels.json")
    results = [read_json(path) for path in sorted((folder / "cases").glob("*.json"))]
    drawn = {label["number"] for label in labels["cases"]}
    return calibration_json(
        labels["cases"],
        [r for r in results if r["case"] in drawn],
        seed=int(labels["seed"]),
        digest=str(labels["cases_sha256"]),
    )


def calibration_json(
    labels: Sequence[dict[str, Any]], results: Sequence[dict[str, Any]], *, seed: int, digest: str
) -> dict[str, Any]:
    """calibration.json from the labels and results of a trial's calibration part. DataError for any
    other part."""
    if any(label["part"] != "calibration" for label in labels):
        raise DataError(
            "the probabilities of a verdict are fitted to the calibration part alone",
            "give the folder of a trial with --part calibration",
        )
    known = {label["number"]: label for label in labels}
    everything = [Marked(known[r["case"]], r) for r in results if not r["failed"]]
    cases = [m for m in everything if m.found.get("grounds") and (m.visible or not m.truth)]
    silent = sum(not m.truth for m in everything) - sum(not m.truth for m in cases)
    x = [features(VerdictStatistics(**m.found["grounds"])) for m in cases]
    gap, right, exact = (
        np.array([bool(f(m)) for m in cases]) for f in (lambda m: m.truth, _right, _exact_right)
    )
    real = np.flatnonzero(gap)
    lines = {
        "gap": _line(x, gap, LOOKS_AT["gap"]),
        "known": _line([x[i] for i in real], right[real], LOOKS_AT["known"]),
        "first": _line(x, exact, LOOKS_AT["first"]),
    }
    said = {q: np.array([line.probability(row) for row in x]) for q, line in lines.items()}
    yes = {
        "gap": _alarm_from(said["gap"][~gap], silent),
        "known": _known_from(said["known"][real], right[real]),
        "first": max(
            _alarm_from(said["first"][~gap], silent), _alarm_from(said["first"][real][~right[real]])
        ),
    }
    lines = {q: replace(line, yes=yes[q]) for q, line in lines.items()} | {
        "further": _further(everything)
    }
    return {
        "schema": CALIBRATION_SCHEMA,
        "cases": {"part": "calibration", "seed": seed, "sha256": digest, "used": len(cases)},
        "lines": {q: asdict(line) for q, line in lines.items()},
        "spread": _spread(cases),
    }


def _right(m: Marked) -> bool:
    """Is the first of the ranking of a planted family, or like a planted effect?"""
    return _exact_right(m) or (
        m.stratum in ("single", "double")
        and m.families[:1] != []
        and m.families[0] in {t["family"] for t in m.truth}
    )


def _exact_right(m: Marked) -> bool:
    return m.stratum in ("single", "double") and m.exact_first


def _further(cases: list[Marked]) -> Line:
    """Is a further effect, weighed beside a first one, of a planted family?"""
    weighings = [(m, weighing) for m in cases for weighing in m.found["further"]]
    real = [
        m.stratum in ("single", "double") and weighing["family"] in {t["family"] for t in m.truth}
        for m, weighing in weighings
    ]
    x = [ForwardStep(**weighing).features() for _, weighing in weighings]
    line = _line(x, np.array(real, bool), LOOKS_AT["further"])
    return replace(
        line, yes=_most_right(np.array([line.probability(row) for row in x]), np.array(real, bool))
    )


def _most_right(p: Array, right: NDArray[np.bool_]) -> float:
    """The probability from which on rights outnumber wrongs by most."""
    grid = np.linspace(0.05, 0.95, 91)
    won = np.array([(np.where(right, 1, -1) * (p >= t)).sum() for t in grid])
    return float(grid[won == won.max()].mean())


def _line(x: list[dict[str, float]], yes: NDArray[np.bool_], names: tuple[str, ...]) -> Line:
    """Logistic regression with a ridge penalty on the weights of the standardised features z, none
    on the bias b:

        min over b, w:  sum_i log(1 + exp(-y_i (b + w.z_i))) + RIDGE/2 |w|^2,   y_i = 1 or -1

    le Cessie and van Houwelingen (1992), Applied Statistics 41:191. Returned are the weights of the
    features before standardisation; `yes` is even odds until it is chosen.
    """
    table = np.array([[row[k] for k in names] for row in x])
    centre, spread = table.mean(axis=0), np.maximum(table.std(axis=0), 1e-6)
    z, y = (table - centre) / spread, np.where(yes, 1.0, -1.0)

    def loss(w: Array) -> float:
        return float(
            np.logaddexp(0.0, -y * (w[0] + z @ w[1:])).sum()
            + 0.5 * PRIOR_PRECISION * (w[1:] ** 2).sum()
        )

    w = minimize(loss, np.zeros(1 + len(names)), method="BFGS").x
    weights = w[1:] / spread
    return Line(
        float(w[0] - weights @ centre), dict(zip(names, weights.tolist(), strict=True)), 0.5
    )


def _alarm_from(wrong: Array, silent: int = 0) -> float:
    """The lowest probability that is reached by no more than 2 % of the cases in which it should
    not be; of `silent` further ones it is 0."""
    quiet = np.sort(np.concatenate([np.zeros(silent), wrong]))
    return float(
        np.clip(quiet[int(np.ceil((1.0 - FALSE_ALARMS) * len(quiet))) - 1] + 1e-6, 0.2, 0.98)
    )


def _known_from(p: Array, right: NDArray[np.bool_]) -> float:
    """Where wrong abstentions and missed unknowns are, each against what is allowed, equally
    rare."""
    grid = np.linspace(0.05, 0.95, 91)
    worst = [
        max((p[right] < t).mean() / WRONG_ABSTENTIONS, (p[~right] >= t).mean() / MISSED_UNKNOWNS)
        for t in grid
    ]
    best = np.flatnonzero(np.array(worst) <= min(worst) + 1e-12)
    return float(grid[best].mean())


def _spread(cases: list[Marked]) -> float:
    """What, times the root of the shrinkage and added in squares to the half-widths of the
    moving-block intervals (logarithm of the error ratio), lets them cover 95 % of the cases."""
    need = []
    for m in cases:
        s = m.result["shrinkage"]
        if m.verdict != "explained" or s is None:
            continue
        middle, low, high, got = (
            np.log(max(1.0 - s[k], 1e-9)) for k in ("predicted", "raw_high", "raw_low", "achieved")
        )
        half = high - middle if got > middle else middle - low
        shrinkage = max(s["predicted"], DEFAULT.least_shrinkage)
        need.append(np.sqrt(max((got - middle) ** 2 - half**2, 0.0) / shrinkage))
    return float(np.quantile(need, COVERAGE)) if need else 0.5
