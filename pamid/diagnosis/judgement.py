"""From figures to a verdict: is there a gap beyond tolerances, and does the best model explain it?

The grounds are dimensionless, so that one judgement serves every rig. Where the lines are drawn was measured on the
calibration cases of `pamid trial`, never on its test cases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.budget import NO_GAP, Budget
from pamid.diagnosis.contest import Contender, bootstrap_losses
from pamid.diagnosis.latent import Located
from pamid.intervals import background_pull, estimates
from pamid.metrics import moving_block_interval

Array = NDArray[np.float64]

WORTH = 0.05            # of the gap: what an effect has to remove to be worth naming
EXPLAINED = 0.25        # of the gap that may remain beyond what a black box leaves
HALF_WAY = 0.60         # of the gap that may remain at all
MATERIAL = 1.25         # refitted error over the floor: less is no gap where nothing helps


@dataclass(frozen=True)
class Grounds:
    """What a verdict rests on, all on the windows that choose."""

    visible: float       # refitted error over the floor, worst channel
    gap: float           # refitted error above the floor, in floors, summed over channels
    of_signal: float     # refitted error over the standard deviation of the signal, worst channel
    left: float          # share of the gap that remains with the best model
    ceiling: float       # share of the gap that the black box leaves
    shrinkage: float     # of the error, by the best model
    gain: float          # log squared error per channel that the best model gains on the baseline
    sure: float          # ... in standard errors
    helps: float         # share of resamples in which the first effect helps at all
    margin: float        # share of the gap by which the best of another family is worse than the first
    margin_gain: float   # ... in log squared error per channel
    margin_sure: float   # ... in standard errors
    wins: float          # share of resamples won by the family of the first
    missing: float       # latent evidence before, nats per sample
    unexplained: float   # latent evidence beside the best model, nats per sample
    at_port: float       # latent evidence at the port of the first over the largest one
    strain: float        # largest strain of a parameter of the rig in the best model
    pull: float          # largest pull of the background in the best model


def at_the_floor(budget: Budget, seed: int) -> bool:
    """The refitted model is at the floor in every channel, within 10 %, with 95 % confidence."""
    return all(moving_block_interval(budget.baseline.absolutes[:, c], budget.floor[:, c], seed=seed)[1] < 1.0 + NO_GAP
               for c in range(budget.floor.shape[1]))


def weigh(budget: Budget, chosen: NDArray[np.bool_], ranking: tuple[Contender, ...], best: Contender | None,
          located: Located, after: Located, seed: int) -> Grounds:
    """The grounds for a verdict; without any candidate those of the baseline alone."""
    base, rows = budget.baseline, chosen
    samples = sum(int(r.scored.sum()) for r in base.replays)
    gap = budget.excess(base.absolutes, rows)
    spread = np.std(np.concatenate([r.track.y[r.scored] for r in base.replays]), axis=0)
    error = base.absolutes[rows].mean(axis=0)
    model = best or base
    first = ranking[0] if ranking else base
    other = next((c for c in ranking if c.family != first.family), base) if ranking else base
    losses = bootstrap_losses([base, model, first, other], chosen, seed)
    gain, margin = losses[0] - losses[1], losses[3] - losses[2]
    channels = base.squares.shape[1]
    everyone = bootstrap_losses(list(ranking), chosen, seed).argmin(axis=0) if ranking else np.zeros(0, int)
    families = [c.family == first.family for c in ranking] if ranking else []
    before = located.most
    here = max((v for k, v in located.gains.items()
                if ranking and base.assembly.rig.group_of(k) == first.group), default=0.0)
    strains = [e.strain for e in estimates(model.fit) if not e.bound.owner]
    return Grounds(
        visible=float((error / budget.floor[rows].mean(axis=0)).max()), gap=gap,
        of_signal=float((error / spread).max()),
        left=budget.excess(model.absolutes, rows) / gap if gap > 0.0 else 0.0,
        ceiling=budget.excess(budget.black_box, rows) / gap if gap > 0.0 else 0.0,
        shrinkage=budget.shrinkage(model.absolutes, rows),
        gain=float(gain.mean()) / channels, sure=_in_errors(gain), helps=float((losses[2] < losses[0]).mean()),
        margin=(budget.excess(other.absolutes, rows) - budget.excess(first.absolutes, rows)) / max(gap, 1e-9),
        margin_gain=float(margin.mean()) / channels, margin_sure=_in_errors(margin),
        wins=float(np.mean(np.array(families)[everyone])) if ranking else 0.0,
        missing=before / samples, unexplained=after.most / samples,
        at_port=here / before if before > 0.0 else 1.0, strain=max(strains, default=0.0),
        pull=max(background_pull(model.fit).values(), default=0.0))


def _in_errors(draws: Array) -> float:
    return float(draws.mean() / max(draws.std(), 1e-6))


def judge(g: Grounds, *, ambiguous: bool) -> str:
    """The verdict."""
    if g.helps <= 0.99 or g.shrinkage < WORTH:
        return "unknown-effect" if g.visible > MATERIAL else "no-structural-gap"
    if g.left > HALF_WAY or g.left - g.ceiling > EXPLAINED:
        return "unknown-effect"
    return "ambiguous" if ambiguous else "explained"
