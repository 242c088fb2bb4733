"""From figures to a verdict: is there a gap beyond tolerances, does the best model explain it, is
its name right?

The statistics are dimensionless, so that one decision rule serves every rig. Each question is
answered by a probability, logistic regression on features x of the statistics,

    P(yes | x) = 1 / (1 + exp(-b - w.x)),

whose b and w were fitted by ridge-penalised maximum likelihood to the calibration cases of `pamid
trial` (an independent plant, seeds used for nothing else); they stand in calibration.json with the
digest of those cases (`pamid.trial.calibrate`). Platt (1999), Probabilistic outputs for support
vector machines, in Advances in Large Margin Classifiers.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import moving_block_interval, seen_mean, shrinkage_interval
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel, bootstrap_losses
from pamid.diagnosis.port_evidence import PortEvidence
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.estimation.intervals import background_pull, estimates
from pamid.simulation.replay import spread_of

Array = NDArray[np.float64]

QUESTIONS = ("gap", "known", "first", "further")


@dataclass(frozen=True)
class VerdictStatistics:
    """What a verdict rests on, all on the windows that choose (`grounds` of diagnosis.json)."""

    visible: float  # refitted error over the floor, worst channel
    gap: float  # refitted error above the floor, in floors, summed over channels
    of_signal: float  # refitted error over the standard deviation of the signal, worst channel
    left: float  # share of the gap that remains with the best model
    ceiling: float  # share of the gap that the black box leaves
    shrinkage: float  # of the error, by the best model
    gain: float  # log squared error per channel that the best model gains on the baseline
    sure: float  # ... in standard errors
    helps: float  # share of resamples in which the first effect helps at all
    # share of the gap by which the best of another family is worse than the first
    margin: float
    margin_gain: float  # ... in log squared error per channel
    margin_sure: float  # ... in standard errors
    wins: float  # share of resamples won by the family of the first
    missing: float  # latent evidence before, nats per sample
    unexplained: float  # latent evidence beside the best model, nats per sample
    at_port: float  # latent evidence at the port of the first over the largest one
    strain: float  # largest strain of a parameter of the rig in the best model
    pull: float  # largest pull of the background in the best model
    channels: int  # measured


def at_noise_floor(budget: Budget, seed: int) -> bool:
    """The refitted model is at the floor in every channel, within the margin for a gap (10 %), with
    95 % confidence."""

    def high(left: Array, floor: Array) -> float:
        seen = ~np.isnan(floor)
        return moving_block_interval(left[seen], floor[seen], seed=seed)[1]

    return all(
        high(left, floor) < 1.0 + budget.settings.gap_margin
        for left, floor in zip(budget.baseline.absolutes.T, budget.floor.T, strict=True)
    )


def verdict_statistics(
    budget: Budget,
    chosen: NDArray[np.bool_],
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel | None,
    located: PortEvidence,
    after: PortEvidence,
    seed: int,
) -> VerdictStatistics:
    """What the verdict rests on; where no candidate was refitted, of the baseline alone."""
    base, rows = budget.baseline, chosen
    gap = budget.excess(base.absolutes, rows)
    spread, error = spread_of(base.replays), seen_mean(base.absolutes[rows])
    model = best or base
    first = ranking[0] if ranking else base
    other = next((c for c in ranking if c.family != first.family), base) if ranking else base
    losses = bootstrap_losses([base, model, first, other], chosen, seed, budget.settings)
    gain, margin = losses[0] - losses[1], losses[3] - losses[2]
    channels = base.squares.shape[1]
    everyone = (
        bootstrap_losses(list(ranking), chosen, seed, budget.settings).argmin(axis=0)
        if ranking
        else np.zeros(0, int)
    )
    families = [c.family == first.family for c in ranking] if ranking else []
    before = located.most
    groups = {base.assembly.rig.group_of(k) for k in first.attached[-1].ports} if ranking else set()
    here = max(
        (
            v
            for k, v in located.gains.items()
            if ranking and base.assembly.rig.group_of(k) in groups
        ),
        default=0.0,
    )
    strains = [e.strain for e in estimates(model.fit) if not e.bound.owner]
    return VerdictStatistics(
        visible=float(np.nanmax(error / seen_mean(budget.floor[rows]))),
        gap=gap,
        of_signal=float(np.nanmax(error / spread)),
        left=budget.excess(model.absolutes, rows) / gap if gap > 0.0 else 0.0,
        ceiling=budget.excess(budget.black_box, rows) / gap if gap > 0.0 else 0.0,
        shrinkage=budget.shrinkage(model.absolutes, rows),
        gain=float(gain.mean()) / channels,
        sure=in_errors(gain),
        helps=float((losses[2] < losses[0]).mean()),
        margin=(budget.excess(other.absolutes, rows) - budget.excess(first.absolutes, rows))
        / max(gap, 1e-9),
        margin_gain=float(margin.mean()) / channels,
        margin_sure=in_errors(margin),
        wins=float(np.mean(np.array(families)[everyone])) if ranking else 0.0,
        missing=before / base.samples,
        unexplained=after.most / base.samples,
        at_port=here / before if before > 0.0 else 1.0,
        strain=max(strains, default=0.0),
        pull=max(background_pull(model.fit).values(), default=0.0),
        channels=channels,
    )


def is_confirmed(
    budget: Budget, model: CandidateModel, reporting: NDArray[np.bool_], seed: int
) -> bool:
    """Does the error shrink on the windows that only report, and on everything held out with 95 %
    confidence? A single window has no say."""
    before, after = (budget.channel_losses(c.absolutes) for c in (budget.baseline, model))
    most = 1.0 - budget.settings.least_shrinkage
    own = not reporting.any() or after[reporting].sum() < most * before[reporting].sum()
    return own and (len(before) < 2 or shrinkage_interval(before, after, seed=seed)[0] > 0.0)


def in_errors(draws: Array) -> float:
    """Mean of bootstrap draws in their standard deviations."""
    return float(draws.mean() / max(draws.std(), 1e-6))


def features(g: VerdictStatistics) -> dict[str, float]:
    """The statistics as the logistic functions take them: ratios in decades, everything within the
    range of the trial."""
    return {
        "visible": decades(g.visible, 1.0, 100.0),
        "missing": decades(g.missing, 1e-2, 1e3),
        "of_signal": decades(g.of_signal, 1e-3, 1.0),
        "sure": within(g.sure, 0.0, 20.0) / 10.0,
        "shrinkage": within(g.shrinkage, -0.2, 1.0),
        "left": within(g.left, 0.0, 1.2),
        "margin": within(g.margin, 0.0, 1.0),
        "margin_sure": within(g.margin_sure, 0.0, 20.0) / 10.0,
        "wins": g.wins,
        "at_port": g.at_port,
        "unexplained": decades((g.unexplained + 1e-3) / (g.missing + 1e-3), 1e-3, 3.0),
    }


def within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def decades(value: float, low: float, high: float) -> float:
    return float(np.log10(within(value, low, high)))


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
    """lines: one per question; spread: of the logarithm of the error ratio from recording to
    recording, per root of the shrinkage; cases: where from."""

    lines: dict[str, Line]
    spread: float
    cases: dict[str, Any]


@lru_cache
def calibration() -> Calibration:
    """As fitted to the calibration cases."""
    found = json.loads((files("pamid.diagnosis") / "calibration.json").read_text(encoding="utf-8"))
    return Calibration(
        {q: Line(**found["lines"][q]) for q in QUESTIONS}, float(found["spread"]), found["cases"]
    )


@dataclass(frozen=True)
class Decision:
    """verdict, and the probabilities behind it: a structural gap; a cause that the catalogue knows
    and that is rightly among the named; the first of the ranking (or one that looks like it here)
    being it."""

    verdict: str
    gap: float
    known: float
    first: float


def decide(
    g: VerdictStatistics,
    *,
    ambiguous: bool,
    confirmed: bool = True,
    empty: bool = False,
    steady: bool = True,
    settings: Settings = DEFAULT,
) -> Decision:
    """The verdict; ambiguous: members of several families are tied; confirmed: see `is_confirmed`;
    empty: the best model predicts no better than a guess without a model; steady: either half of
    the held-out windows chooses it, or what it cannot be told from.

    A first candidate that is as good as certain is named even where the evidence for a gap would
    not raise an alarm by itself. No cause is named that held-out windows do not confirm, nor in
    recordings that no model explains.
    """
    c, x = calibration(), features(g)
    gap, known, first = (c.lines[q].probability(x) for q in ("gap", "known", "first"))
    # what no held-out window bears out is no better than a guess, whatever the statistics say
    most = 0.0 if empty else 1.0 if confirmed else settings.unbacked_probability
    known, first = min(known, most), min(first, most)
    if not steady:  # another name on other windows: neither is more than even odds
        first = min(first, settings.unbacked_probability)
    certain = first >= c.lines["first"].yes
    if gap < c.lines["gap"].yes and not certain:
        verdict = "no-structural-gap"
    elif (
        most < 1.0
        or (known < c.lines["known"].yes and not certain)
        or g.shrinkage < settings.least_shrinkage
    ):
        verdict = "unknown-effect" if gap >= c.lines["gap"].yes else "no-structural-gap"
    else:
        verdict = "ambiguous" if ambiguous else "explained"
    return Decision(verdict, gap, known, first)


def probabilities(decision: Decision, wins: list[float]) -> list[float]:
    """One per candidate: the first has its own, the others share in proportion to their wins what
    is left of the probability that the catalogue knows the cause."""
    if not wins:
        return []
    others = np.array(wins[1:]) + 1e-3
    rest = max(0.0, min(1.0, max(decision.known, decision.first)) - decision.first)
    return [decision.first, *(rest * others / others.sum()).tolist()]


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
