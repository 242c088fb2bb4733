"""Further effects beside a first one: greedy addition where something is still missing, with a
backward check and swaps of the first for its rivals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pamid.diagnosis.contender import Contender, transferred
from pamid.diagnosis.decision import WORTH, calibration, decades, in_errors, within
from pamid.diagnosis.port_evidence import Located, locate
from pamid.diagnosis.search import Refitting, Search, Start, run_round, settled
from pamid.estimation.grey_box import model_with
from pamid.model.attachment import Attachment

MOST_CAUSES = 3
FEW_MORE = 4  # candidates refitted beside a first cause
# of the first latent evidence: where no more is missing, no further effect is looked for
LITTLE = 0.005
# nats per sample: where more than this is missing one is looked for in any case
ENOUGH = 0.5
PLAIN = 0.15  # ... and where less than this is, none
OPEN = 0.5  # of the largest latent evidence: ports at which it is looked for
TRACE = 0.02  # of the gap: what an effect has to remove to be named beside another one
RIVALS = 2  # of the first cause, tried in its place beside the second


@dataclass(frozen=True)
class Newcomer:
    """An effect weighed beside the ones already found, all on the windows that choose.

    removed, of_left: what it removes, in shares of the gap and of what the others leave; gain: log
    squared error per channel, sure: in standard errors; margin: standard errors by which it beats
    the next of another family; at_port: latent evidence at its port over the largest one;
    unexplained: that one, nats per sample; probability of being real; taken: is it part of the
    answer?
    """

    effect: str
    family: str
    removed: float
    of_left: float
    gain: float
    sure: float
    margin: float
    at_port: float
    unexplained: float
    probability: float = 0.0
    taken: bool = False

    def features(self) -> dict[str, float]:
        """As the logistic function takes them."""
        return {
            "removed": decades(self.removed, 1e-3, 1.0),
            "of_left": within(self.of_left, -0.2, 1.0),
            "gain": within(self.gain, -0.2, 2.0),
            "sure": within(self.sure, 0.0, 20.0) / 10.0,
            "margin": within(self.margin, 0.0, 10.0) / 10.0,
            "at_port": self.at_port,
            "unexplained": decades(self.unexplained, 1e-2, 1e2),
        }


@dataclass(frozen=True, eq=False)
class Extended:
    """A model with all that has to stand beside its first effect; after: what is still missing
    where; newcomers: the further effects that were weighed, in order."""

    best: Contender
    after: Located
    newcomers: tuple[Newcomer, ...] = ()


def extended(search: Search, ranking: tuple[Contender, ...], located: Located) -> Extended:
    """The first of the ranking with what has to stand beside it.

    A further effect is looked for where something is still missing. After each one the earlier ones
    are left out in turn: an effect that the newcomer has made needless goes.
    """
    best, weighed = settled(search, ranking[0]), list[Newcomer]()
    while True:
        search.progress(f"looking where something is missing beside {best.label}")
        after = locate(search.evidence, best, search.pool, [k[0] for k in located.classes])
        helped = search.budget.shrinkage(best.absolutes, search.chosen) > WORTH
        little = max(min(LITTLE * located.most, ENOUGH * best.samples), PLAIN * best.samples)
        if len(best.attached) == MOST_CAUSES or after.most < little or not helped:
            break
        more = _candidates(search, best, located, after)
        if not more:
            break
        weighed.append(_weighed(search, best, more, located, after))
        if not weighed[-1].taken:
            break
        best = settled(search, _swapped(search, ranking, _without_needless(search, more[0])))
    return Extended(best, after, tuple(weighed))


def _candidates(
    search: Search, best: Contender, located: Located, after: Located
) -> list[Contender]:
    """Refitted models with one more effect, of another family and where something is still missing,
    best first."""
    taken = {search.family(a) for a in best.attached}
    open_ports = {
        port for k in located.classes for port in k if after.gains[k[0]] > OPEN * after.most
    }
    others = [
        a for a in search.candidates if search.family(a) not in taken and open_ports & set(a.ports)
    ]
    more = run_round(search, best, others, FEW_MORE)[0] if others else []
    losses = search.losses(more).mean(axis=1) if more else []
    return [more[i] for i in sorted(range(len(more)), key=lambda i: (losses[i], more[i].label))]


def _weighed(
    search: Search, best: Contender, more: list[Contender], located: Located, after: Located
) -> Newcomer:
    newest = more[0]
    other = next((c for c in more if c.family != newest.family), best)
    losses = search.losses([best, newest, other])
    gain, margin = losses[0] - losses[1], losses[2] - losses[1]
    gap, left = search.excess(search.budget.baseline), search.excess(best)
    removed = left - search.excess(newest)
    ports = set(newest.attached[-1].ports)
    here = max(after.gains[k[0]] for k in located.classes if ports & set(k))
    found = Newcomer(
        newest.attached[-1].label,
        newest.family,
        removed / max(gap, 1e-9),
        removed / max(left, 1e-9),
        float(gain.mean()) / newest.squares.shape[1],
        in_errors(gain),
        in_errors(margin),
        here / after.most,
        after.most / best.samples,
    )
    line = calibration().lines["further"]
    probability = line.probability(found.features())
    return replace(
        found, probability=probability, taken=probability >= line.yes and found.removed >= TRACE
    )


def _without_needless(search: Search, best: Contender) -> Contender:
    """Backward check: the model without any effect but the newest, if that one is missed by
    nobody."""
    for a in best.attached[:-1]:
        smaller = _refitted(search, tuple(k for k in best.attached if k is not a), best)
        if smaller.finite and search.excess(smaller) - search.excess(best) < WORTH * search.excess(
            search.budget.baseline
        ):
            return smaller
    return best


def _swapped(search: Search, ranking: tuple[Contender, ...], best: Contender) -> Contender:
    """The first effect chosen again: alone it had to stand in for its company, too."""
    if len(best.attached) < 2 or best.attached[0] is not ranking[0].attached[-1]:
        return best
    taken = {search.family(a) for a in best.attached[1:]}
    rivals = [c for c in ranking[1:] if c.family not in taken][:RIVALS]
    options = [
        best,
        *(_refitted(search, (*r.attached, *best.attached[1:]), r, best) for r in rivals),
    ]
    stable = [c for c in options if c.finite]
    return stable[int(np.argmin(search.losses(stable).mean(axis=1)))]


def _refitted(search: Search, attached: tuple[Attachment, ...], *found: Contender) -> Contender:
    """A model with these effects, refitted from what these others have found, the last of them
    first."""
    assembly = model_with(search.evidence, attached, search.budget.sizes)
    p = transferred(assembly, *((c.assembly, c.fit.p) for c in found))
    work = Refitting(search.evidence, search.budget.baseline.fit, search.budget.sizes)
    return search.pool.one(work, Start(attached, p))
