"""What speaks for an effect being there: its signature.

All figures are dimensionless, come from fitted data and from the held-out windows, and
compare the model with the effect to the one without it, in the company of the same other effects.
They are what the probability of a cause is learnt from (`pamid.diagnosis.decision`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pamid.base.metrics import relative, seen_mean
from pamid.diagnosis.candidate_model import CandidateModel, in_errors
from pamid.diagnosis.judgement import calibration, decades, signed_decades, within
from pamid.diagnosis.port_evidence import PortEvidence
from pamid.diagnosis.ranges import at_bounds
from pamid.diagnosis.search import Search
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.model.attachment import Attachment


@dataclass(frozen=True)
class Signature:
    """What speaks for one effect, beside the others of its model."""

    removed: float  # share of the gap that it removes
    of_left: float  # ... of what is left without it
    sure: float  # gain in log squared error, in standard errors
    steady: float  # share of the windows in which the error is smaller with it
    lead: float  # share of the gap that the best model of another family leaves more
    lead_sure: float  # ... in log squared error, in standard errors; negative: it is behind
    wins: float  # share of resamples won by its family
    at_port: float  # latent evidence at its port over the largest one
    evidence: float  # log evidence that it gains on the fitted data, priors counted, nats
    evidence_lead: float  # ... over the most evident model without its family
    eased: float  # squared strains and pulls that it takes off the rig and the background
    left: float  # share of the gap that remains with it
    remaining: float  # error with it over the floor, worst channel
    bounds: float  # parameters that ended at a bound which physics did not set
    converged: float  # 1 or 0
    beside: float  # number of other effects in its model

    @property
    def surely(self) -> float:
        """Standard errors by which it removes something, and by which it removes more than any
        other family does, the fewer of both."""
        return min(self.sure, self.lead_sure)

    def features(self) -> dict[str, float]:
        """As the logistic function takes them: within the range of the trial, what spans decades
        as a signed logarithm."""
        return {
            "removed": within(self.removed, -0.2, 1.0),
            "of_left": within(self.of_left, -0.2, 1.0),
            "sure": within(self.sure, -5.0, 20.0) / 10.0,
            "steady": self.steady,
            "lead": within(self.lead, -1.0, 1.0),
            "lead_sure": within(self.lead_sure, -20.0, 20.0) / 10.0,
            "wins": self.wins,
            "at_port": self.at_port,
            "evidence": signed_decades(self.evidence),
            "evidence_lead": signed_decades(self.evidence_lead),
            "eased": signed_decades(self.eased),
            "left": within(self.left, 0.0, 1.2),
            "remaining": decades(self.remaining, 1.0, 100.0),
            "bounds": within(self.bounds, 0.0, 1.0),
            "converged": self.converged,
            "beside": within(self.beside, 0.0, 1.0),
        }


def signature(
    search: Search,
    effect: Attachment,
    model: CandidateModel,
    without: CandidateModel,
    rival: CandidateModel,
    wins: float,
    opposed: float,
    located: PortEvidence,
) -> Signature:
    """Of an effect of `model`; without: the model less it; rival: the best of another
    family, or the model without; opposed: the most evidence of any model without its family, nats;
    located: latent evidence before any effect."""
    gap = search.excess(search.budget.baseline)
    before, after = search.excess(without), search.excess(model)
    losses = search.losses([without, model, rival])
    rows = search.asked
    smaller = (
        search.budget.channel_losses(model.absolutes)[rows]
        < search.budget.channel_losses(without.absolutes)[rows]
    )
    most = located.most
    return Signature(
        removed=relative(before - after, gap),
        of_left=relative(before - after, before),
        sure=in_errors(losses[0] - losses[1]),
        steady=float(smaller.mean()),
        lead=relative(search.excess(rival) - after, gap),
        lead_sure=in_errors(losses[2] - losses[1]),
        wins=wins,
        at_port=max(located.gains[p] for p in effect.ports) / most if most > 0.0 else 1.0,
        evidence=search.nats(model) - search.nats(without),
        evidence_lead=search.nats(model) - opposed,
        eased=_strain(without) - _strain(model),
        left=relative(after, gap),
        remaining=float(
            np.nanmax(seen_mean(model.absolutes[rows]) / seen_mean(search.budget.floor[rows]))
        ),
        bounds=float(len(at_bounds(model, search.settings, effect.label))),
        converged=float(model.fit.converged),
        beside=float(len(model.attached) - 1),
    )


def alone(
    search: Search, ranking: tuple[CandidateModel, ...], located: PortEvidence
) -> tuple[Signature, ...]:
    """Of models with one effect each, against the refitted model."""
    if not ranking:
        return ()
    base = search.budget.baseline
    losses = search.losses(list(ranking))
    order = losses.mean(axis=1).argsort()
    winner = [ranking[i].family for i in losses.argmin(axis=0)]
    nats = [(c.family, search.nats(c)) for c in ranking]
    none = search.nats(base)

    def of(c: CandidateModel) -> Signature:
        rival = next((ranking[i] for i in order if ranking[i].family != c.family), base)
        wins = winner.count(c.family) / len(winner)
        opposed = max([none, *(v for family, v in nats if family != c.family)])
        return signature(search, c.attached[-1], c, base, rival, wins, opposed, located)

    return tuple(of(c) for c in ranking)


def cause_probability(s: Signature, settings: Settings = DEFAULT) -> float:
    """That an effect of this family is really there. The line may not overrule plain evidence: at
    least even odds where the model less it, or with any other family in its place, is worse by five
    standard errors on what was held out, and very strongly so on what was fitted or nothing but
    noise is left with it."""
    line = calibration().lines["cause"]
    evident = s.evidence_lead > settings.simpler_evidence
    at_floor = s.remaining < 1.0 + settings.gap_margin
    plain = (evident or at_floor) and s.surely >= settings.further_sure
    return max(line.probability(s.features()), line.yes if plain else 0.0)


def _strain(c: CandidateModel) -> float:
    """Sum of squares of what the rig's parameters and the background were moved by, in prior
    spreads; those of its effects do not count."""
    a, free = c.assembly, list(c.fit.problem.free)
    own = np.array([not a.parameters[i].owner or a.parameters[i].nuisance for i in free], bool)
    s = c.fit.problem.scale.inside(c.fit.p[free])[own]
    return float(s @ s)
