"""From figures to a verdict: which causes may be named, and is what remains more than tolerances?

Every cause has a probability of its own and the share of the gap that it removes; what remains has
one, too. The word of the verdict follows from them:

    explained           causes, and a remainder not told from noise and tolerances
    partly-explained    causes, and a remainder that is more than these
    ambiguous           one of several families, which these recordings cannot tell apart, or of
                        which none is probable alone
    unknown-effect      no cause that may be named, and a gap that is real
    no-structural-gap   nothing beyond retuned parameters and tolerances
    cannot-tell         data too few, too quiet or too doubtful to say; a gap that is more probable
                        than not, and not sure enough to be called one
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import moving_block_interval, shrinkage_interval
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.judgement import calibration
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.verdict_grounds import LeftOver

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Share:
    """A share of the gap with its 95 % interval, on held-out windows that chose nothing of what
    they report."""

    share: float
    low: float
    high: float

    @property
    def rest(self) -> Share:
        """What it leaves of the gap."""
        return Share(1.0 - self.share, 1.0 - self.high, 1.0 - self.low)


@dataclass(frozen=True)
class Weighed:
    """An effect of the best model, or one tied with it, as the verdict sees it.

    probability: that its family is really there; removes: share of the gap, beside the others;
    at_bound: parameters at a bound that physics did not set; vanished: its amounts, where all of
    them ended at nothing; here: share of the gap that enters at its port or at one that the sensors
    cannot tell from it, or the evidence there over the largest at any port, whichever is more;
    bent: share of what passes by which it bends a characteristic, where it does nothing else;
    of_left: share that it removes of what the others leave; again: the rig's own parameters whose
    terms do what it does; sure: standard errors by which it removes something, and by which it
    removes more than any other family does in its place, the fewer of both
    """

    effect: str
    family: str
    probability: float
    removes: Share
    at_bound: tuple[str, ...]
    here: float
    vanished: tuple[str, ...] = ()
    bent: float | None = None
    of_left: float = 0.0
    again: tuple[str, ...] = ()
    sure: float = 0.0

    def objections(self, settings: Settings = DEFAULT) -> list[str]:
        """Why it must not be named whatever its probability; empty where nothing speaks against
        it."""
        found = []
        if self.removes.low <= 0.0:
            found.append("the interval of what it removes goes through zero")
        if not is_material(self.removes.share, self.of_left, settings):
            found.append("it removes next to nothing")
        if self.vanished:
            found.append(f"{', '.join(self.vanished)} ended at nothing")
        if self.at_bound:
            found.append(f"{', '.join(self.at_bound)} ended at a bound")
        # what removes most of the gap, or is as sure as that, is there, whatever a slowly varying
        # value at its port, as evidence is taken with, can make of it: a delay or a lag is none
        if self.here < settings.port_negligible and not is_sure(
            self.removes.low, self.sure, settings
        ):
            found.append("next to nothing of the gap enters at its port")
        if is_ordinary_bend(self.bent, settings):
            found.append("it bends what passes its port by no more than ordinary machines do")
        if self.again:
            found.append(f"it does what {', '.join(self.again)} of the rig does")
        return found


def is_material(removes: float, of_left: float, settings: Settings) -> bool:
    """Is so much of the gap, or of what other effects leave of it, worth a name?"""
    return removes >= settings.least_shrinkage or of_left >= settings.further_of_left


def is_sure(least: float, sure: float, settings: Settings) -> bool:
    """Is an effect there wherever the gap seems to enter? least: share of the gap that it removes
    with 95 % confidence; sure: as in `Weighed`."""
    return least >= settings.port_overruled or sure >= settings.further_sure


def is_ordinary_bend(bent: float | None, settings: Settings) -> bool:
    """Is this (`pamid.diagnosis.bends.bend`) no more than the characteristic of a machine on which
    nothing is missing departs from a straight line?"""
    return bent is not None and bent <= settings.ordinary_bend


@dataclass(frozen=True)
class Decision:
    """verdict; named: effects that it names; gap, remainder: probabilities that what the refitted
    model and the best one leave is more than noise and tolerances, with the p-values of the
    opposite, and whether it counts as more; known: probability that one of those named is right, or
    of the best where none is."""

    verdict: str
    named: tuple[str, ...]
    gap: float
    remainder: float
    gap_p_value: float
    remainder_p_value: float
    known: float
    gap_real: bool = True
    remainder_real: bool = True
    why: str = ""  # of cannot-tell

    @property
    def left_over(self) -> bool:
        """Is more than noise and tolerances left, with the causes or because there is none?"""
        return self.verdict == "unknown-effect" or (bool(self.named) and self.remainder_real)


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


def gap_share(budget: Budget, without: Array, model: Array, seed: int) -> Share:
    """Share of the gap that a model removes beside another one (errors per held-out window and
    channel), channels weighed by their floors,

        sum (L_without - L_model) / sum (L_baseline - L_floor)

    over the windows, with the moving-block interval of the numerator."""
    base, floor, one, other = (
        budget.channel_losses(x) for x in (budget.baseline.absolutes, budget.floor, model, without)
    )
    gap = float(base.sum() - floor.sum())
    if gap <= 0.0 or len(base) < 2:
        return Share(0.0, -1.0, 1.0)
    whole = float(base.sum())
    low, high = moving_block_interval(other - one, base, seed=seed)
    scale = whole / gap
    share = float((other - one).sum()) / gap
    return Share(min(share, 1.0), min(low * scale, 1.0), min(high * scale, 1.0))


def is_confirmed(
    budget: Budget, model: CandidateModel, reporting: NDArray[np.bool_], seed: int
) -> bool:
    """Does the error shrink on the windows that only report, and on everything held out with 95 %
    confidence? A single window has no say."""
    before, after = (budget.channel_losses(c.absolutes) for c in (budget.baseline, model))
    most = 1.0 - budget.settings.least_shrinkage
    own = not reporting.any() or after[reporting].sum() < most * before[reporting].sum()
    return own and (len(before) < 2 or shrinkage_interval(before, after, seed=seed)[0] > 0.0)


def _above_floor(left: LeftOver, settings: Settings) -> bool:
    """Is what a model leaves beyond the margin that the noise floor is given?"""
    return left.floors >= 1.0 + settings.gap_margin


def counts_from(left: LeftOver, settings: Settings) -> tuple[float, float]:
    """From which probability, and from which latent evidence (nats per sample), what a model leaves
    counts as more than noise and tolerances."""
    c = calibration()
    if left.beside_tolerances:
        return c.stated_yes, settings.plain_beside
    return c.lines["missing"].yes, settings.plain_missing


def is_real(probability: float, left: LeftOver, settings: Settings) -> bool:
    """Is what a model leaves more than noise and tolerances? Nothing at the noise floor is; above
    it the line decides, which may not overrule plain evidence."""
    probable, plain = counts_from(left, settings)
    return _above_floor(left, settings) and (probability >= probable or left.missing >= plain)


def _plausible(
    tied: list[Weighed], weighed: Sequence[Weighed], settings: Settings
) -> list[Weighed]:
    """Those that the other figures do not speak against, beside the most probable one; all of them
    where an effect of the best model is not among these."""
    most = max((w.probability for w in tied), default=0.0)
    found = [w for w in tied if w.probability >= settings.ambiguous_share * most]
    own = {w.effect for w in weighed}
    return found if any(w.effect in own for w in found) else tied


def more_probable_than_not(
    rivals: Sequence[Weighed], settings: Settings = DEFAULT
) -> list[Weighed]:
    """The fewest families, two at least, of which one is there more probably than not: a single
    cause has one family, so that their probabilities add up. Empty where that takes too many, or
    some that are next to improbable beside the first."""
    ordered = sorted(rivals, key=lambda w: w.probability, reverse=True)
    of: dict[str, Weighed] = {}
    for w in ordered:
        if not w.objections(settings):
            of.setdefault(w.family, w)
    most = max((w.probability for w in of.values()), default=0.0)
    fit = [w for w in of.values() if w.probability >= settings.ambiguous_share * most]
    fit = fit[: settings.ambiguous_families]
    sums = np.cumsum([w.probability for w in fit])
    enough = np.flatnonzero(sums >= calibration().lines["cause"].yes)
    return fit[: max(int(enough[0]) + 1, 2)] if enough.size and len(fit) > 1 else []


def decide(
    before: LeftOver,
    after: LeftOver,
    weighed: Sequence[Weighed],
    tied: Sequence[Weighed] = (),
    rivals: Sequence[Weighed] = (),
    *,
    doubt: str = "",
    settings: Settings = DEFAULT,
) -> Decision:
    """The verdict. weighed: effects of the best model; tied: where it has a single one, it and the
    first of every other family that these recordings cannot tell from it; rivals: the most
    probable of every family, of which some together may be probable where none is alone; doubt: why
    nothing can be said of the model whatever the figures are ("" where there is no such reason).
    """
    c = calibration()
    gap, rest = (c.lines["missing"].probability(m.features()) for m in (before, after))
    yes = c.lines["cause"].yes
    gap_real, rest_real = (is_real(p, m, settings) for p, m in ((gap, before), (rest, after)))
    fit = [w for w in weighed if not w.objections(settings)]
    named = [w for w in fit if w.probability >= yes]
    one_of = _plausible([w for w in tied if not w.objections(settings)], weighed, settings)
    together = min(1.0, sum(w.probability for w in one_of))
    known = max((w.probability for w in weighed), default=0.0)
    why = doubt
    if doubt:
        verdict, named = "cannot-tell", []
    elif not _above_floor(before, settings):
        # whatever takes a part of so little off, no cause is needed for it
        verdict, named = "no-structural-gap", []
    elif len({w.family for w in one_of}) > 1 and together >= yes:
        verdict, named, known = "ambiguous", one_of, together
    elif named:
        verdict = "partly-explained" if rest_real else "explained"
        known = max(w.probability for w in named)
    elif gap_real and (several := more_probable_than_not(rivals, settings)):
        verdict, named = "ambiguous", several
        known = min(1.0, sum(w.probability for w in several))
    elif gap_real:
        # probable enough, and lost to the width of an interval alone: more data would tell
        probable = [w for w in weighed if w.probability >= yes and not w.again]
        unsure = [w for w in probable if w.removes.low <= 0.0]
        # what is there is known, and no more than a machine may have on which nothing is missing
        bent = [w for w in probable if is_ordinary_bend(w.bent, settings)]
        verdict = "cannot-tell" if unsure or bent else "unknown-effect"
        why = "few" if unsure else "bent" if bent else ""
    elif gap > settings.open_gap and _above_floor(before, settings):
        # not sure enough to call it real, and less sure that there is none
        verdict, why = "cannot-tell", "open"
    else:
        verdict = "no-structural-gap"
    return Decision(
        verdict,
        tuple(w.effect for w in named),
        gap,
        rest,
        c.p_value(gap),
        c.p_value(rest),
        known,
        gap_real,
        rest_real,
        why,
    )
