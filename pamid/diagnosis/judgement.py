"""What calibration cases have taught: how probable a "yes" is, and how wide an interval has to be.

Each question is answered by a probability, logistic regression on dimensionless features x,

    P(yes | x) = 1 / (1 + exp(-b - w.x)),

whose b and w were fitted by ridge-penalised maximum likelihood to the calibration cases of `pamid
trial` (independent machines, seeds used for nothing else; `pamid.trial.calibration`). They stand in
calibration.json with the digest of those cases. Platt (1999), Probabilistic outputs for support
vector machines, in Advances in Large Margin Classifiers.

    missing   is what a model leaves more than noise and ordinary tolerances? asked of the refitted
              model it is the gap, asked of the model with its causes the remainder
    cause     is an effect of this family really at this port?
    further   is it worth to be added beside the others?
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import shrinkage_interval
from pamid.diagnosis.settings import DEFAULT, Settings

Array = NDArray[np.float64]

QUESTIONS = ("missing", "cause", "further")


def within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def decades(value: float, low: float, high: float) -> float:
    return float(np.log10(within(value, low, high)))


def signed_decades(value: float) -> float:
    """sign(x) log10(1 + |x|)"""
    return float(np.sign(value) * np.log10(1.0 + abs(value)))


@dataclass(frozen=True)
class Line:
    """A logistic function of the features; a question is answered with yes from the probability
    `yes` on."""

    bias: float
    weights: dict[str, float]
    yes: float

    def probability(self, x: dict[str, float]) -> float:
        return float(
            1.0 / (1.0 + np.exp(-self.bias - sum(w * x[k] for k, w in self.weights.items())))
        )


@dataclass(frozen=True)
class Calibration:
    """lines: one per question; stated_yes: from where on `missing` counts beside tolerances that
    the rig states, which take up most of what passes for a gap without them; silent: probabilities,
    sorted, that `missing` gives to models of cases in which nothing was missing; spread: of the
    logarithm of the error ratio from recording to recording, per root of the shrinkage; cases:
    where from."""

    lines: dict[str, Line]
    silent: tuple[float, ...]
    spread: float
    cases: dict[str, Any]
    stated_yes: float

    def p_value(self, probability: float) -> float:
        """How often `missing` gives as much or more to what leaves nothing but noise and
        tolerances: the conformal p-value (1 + #{silent >= probability}) / (n + 1) of Vovk,
        Gammerman and Shafer (2005), Algorithmic Learning in a Random World, ch. 2."""
        reached = len(self.silent) - int(np.searchsorted(self.silent, probability, side="left"))
        return (1.0 + reached) / (1.0 + len(self.silent))


@lru_cache
def calibration() -> Calibration:
    """As fitted to the calibration cases."""
    found = json.loads((files("pamid.diagnosis") / "calibration.json").read_text(encoding="utf-8"))
    return Calibration(
        {q: Line(**found["lines"][q]) for q in QUESTIONS},
        tuple(found["silent"]),
        float(found["spread"]),
        found["cases"],
        float(found["stated_yes"]),
    )


def forecast_interval(
    before: Array, after: Array, seed: int = 0, settings: Settings = DEFAULT
) -> tuple[float, float]:
    """95 % interval of the shrinkage to expect on a fresh recording, from losses per window before
    and after.

    The moving-block interval of these windows and, added in squares on the logarithm of the error
    ratio, what another recording brings beyond them: measured on the calibration cases, in
    proportion to the root of the shrinkage. The widest possible with one window.
    """
    if len(before) < 2:
        return -1.0, 1.0
    low, high = shrinkage_interval(before, after, seed=seed)
    # in logarithms of the error ratio, as the spread from recording to recording was measured
    middle = np.log(max(float(after.sum() / before.sum()), 1e-9))
    edges = np.log(np.maximum([1.0 - high, 1.0 - low], 1e-9))
    other = calibration().spread * np.sqrt(max(1.0 - np.exp(middle), settings.least_shrinkage))
    half = np.hypot(edges - middle, other)
    return float(1.0 - np.exp(middle + half[1])), float(1.0 - np.exp(middle - half[0]))
