"""What a verdict rests on, in dimensionless figures, so that one rule serves every rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import relative, seen_mean
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel, bootstrap_losses, in_errors
from pamid.diagnosis.forward_selection import ForwardStep
from pamid.diagnosis.judgement import decades, within
from pamid.diagnosis.port_evidence import PortEvidence
from pamid.estimation.intervals import background_pull, estimates
from pamid.simulation.replay import spread_of


@dataclass(frozen=True)
class LeftOver:
    """What a model leaves, on the held-out windows: the refitted model a gap, the best model a
    remainder."""

    floors: float  # error over the floor, worst channel
    of_signal: float  # error over the standard deviation of the signal, worst channel
    missing: float  # latent evidence, nats per sample
    next_sure: float  # gain of the next effect, in standard errors; 0 where none was worth a try
    next_removes: float  # share of the error, or of what is left, that it removes
    network: float  # share of the gap that a network fitted to the same windows takes beyond it
    beside_tolerances: bool = False  # has the model a background, which takes these up?

    def features(self) -> dict[str, float]:
        """As the logistic function takes them: ratios in decades, within the range of the trial.
        What the network takes counts as a share of the error, too: near the floor the gap is next
        to nothing, and a share of it mostly chance."""
        floors, network = within(self.floors, 1.0, 100.0), within(self.network, -1.0, 1.0)
        return {
            "floors": float(np.log10(floors)),
            "of_signal": decades(self.of_signal, 1e-3, 1.0),
            "missing": decades(self.missing, 1e-2, 1e3),
            "next_sure": within(self.next_sure, 0.0, 20.0) / 10.0,
            "next_removes": within(self.next_removes, -0.2, 1.0),
            "network": network,
            "network_of_error": network * (1.0 - 1.0 / floors),
            "stated": float(self.beside_tolerances),
        }


@dataclass(frozen=True)
class VerdictStatistics:
    """What a verdict rests on, all on the held-out windows (`grounds` of diagnosis.json)."""

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
    # with the best model: error over the floor and over the signal's standard deviation, worst
    # channel
    remaining: float
    remaining_of_signal: float

    @property
    def before(self) -> LeftOver:
        """Of the refitted model."""
        return LeftOver(
            self.visible,
            self.of_signal,
            self.missing,
            self.sure,
            self.shrinkage,
            1.0 - self.ceiling,
            self.pull > 0.0,
        )

    def after(self, steps: Sequence[ForwardStep]) -> LeftOver:
        """Of the best model; steps: the effects that were tried beside those found."""
        next_one = next((s for s in reversed(steps) if not s.taken), None)
        return LeftOver(
            self.remaining,
            self.remaining_of_signal,
            self.unexplained,
            next_one.sure if next_one else 0.0,
            next_one.of_left if next_one else 0.0,
            self.left - self.ceiling,
            self.pull > 0.0,
        )


def verdict_statistics(
    budget: Budget,
    asked: NDArray[np.bool_],
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel,
    located: PortEvidence,
    after: PortEvidence,
    seed: int,
) -> VerdictStatistics:
    """What the verdict rests on; where no candidate was refitted, the baseline is the best."""
    base, rows = budget.baseline, asked
    gap = budget.excess(base.absolutes, rows)
    spread, error = spread_of(base.replays), seen_mean(base.absolutes[rows])
    first = ranking[0] if ranking else base
    other = next((c for c in ranking if c.family != first.family), base) if ranking else base
    losses = bootstrap_losses([base, best, first, other], asked, seed, budget.settings)
    gain, margin = losses[0] - losses[1], losses[3] - losses[2]
    channels = base.squares.shape[1]
    everyone = (
        bootstrap_losses(list(ranking), asked, seed, budget.settings).argmin(axis=0)
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
    strains = [e.strain for e in estimates(best.fit) if not e.bound.owner]
    return VerdictStatistics(
        visible=float(np.nanmax(error / seen_mean(budget.floor[rows]))),
        gap=gap,
        of_signal=float(np.nanmax(error / spread)),
        left=relative(budget.excess(best.absolutes, rows), gap) if gap > 0.0 else 0.0,
        ceiling=relative(budget.excess(budget.black_box, rows), gap) if gap > 0.0 else 0.0,
        shrinkage=budget.shrinkage(best.absolutes, rows),
        gain=float(gain.mean()) / channels,
        sure=in_errors(gain),
        helps=float((losses[2] < losses[0]).mean()),
        margin=relative(
            budget.excess(other.absolutes, rows) - budget.excess(first.absolutes, rows), gap
        ),
        margin_gain=float(margin.mean()) / channels,
        margin_sure=in_errors(margin),
        wins=float(np.mean(np.array(families)[everyone])) if ranking else 0.0,
        missing=before / base.samples,
        unexplained=after.most / base.samples,
        at_port=here / before if before > 0.0 else 1.0,
        strain=max(strains, default=0.0),
        pull=max(background_pull(best.fit).values(), default=0.0),
        channels=channels,
        remaining=float(np.nanmax(seen_mean(best.absolutes[rows]) / seen_mean(budget.floor[rows]))),
        remaining_of_signal=float(np.nanmax(seen_mean(best.absolutes[rows]) / spread)),
    )
