"""One round of the search: screen all candidates on top of a model, refit the promising ones, order
them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.contender import Contender, bootstrap_losses, refit, replayed, transferred
from pamid.diagnosis.decision import WORTH
from pamid.diagnosis.screening import Ground, Screened, screen, sent_on
from pamid.diagnosis.serialise import contender_of, contender_plain
from pamid.diagnosis.starting_hints import Clues
from pamid.estimation.grey_box import COARSE, model_with, rechecked
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Sizes
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.parallel.store import Plain
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]

SLIGHT = 0.1  # in log squared error per channel: less is not worth another parameter
# standard errors by which a more elaborate effect, or one of two alike, has to win
SURE = 3.0


@dataclass(frozen=True)
class Search:
    """What every step of a diagnosis needs."""

    evidence: DataSplit
    budget: Budget
    chosen: NDArray[np.bool_]
    candidates: list[Attachment]
    clues: Clues
    seed: int
    pool: WorkerPool
    progress: Progress

    def family(self, a: Attachment) -> str:
        return a.family(self.evidence.rig)

    def excess(self, c: Contender) -> float:
        return self.budget.excess(c.absolutes, self.chosen)

    def losses(self, contenders: list[Contender]) -> Array:
        return bootstrap_losses(contenders, self.chosen, self.seed)


@dataclass(frozen=True, eq=False)
class _Screening(Work[Attachment, Screened]):
    """A candidate on top of a model."""

    what = "screening"
    evidence: DataSplit
    ground: Ground
    sizes: Sizes
    clues: Clues

    def __call__(self, item: Attachment) -> Plain:
        s = screen(self.evidence, self.ground, item, self.sizes, self.clues)
        return {"first": s.first, "gain": s.gain, "why": s.why, "fits": s.assembly is not None}

    def restored(self, item: Attachment, found: Plain) -> Screened:
        attached = (*self.ground.baseline.attached, item)
        return Screened(
            item,
            model_with(self.evidence, attached, self.sizes) if found["fits"] else None,
            found["first"],
            found["gain"],
            found["why"],
        )

    def name(self, item: Attachment) -> str:
        return item.label


@dataclass(frozen=True, eq=False)
class Start:
    """A model to refit. p: where from (SI; default: the data sheet); first: further starting values
    (SI) by key."""

    attached: tuple[Attachment, ...]
    p: Array | None = None
    first: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Refitting(Work[Start, Contender]):
    """A model refitted after a fit of another one, and replayed on what was held out."""

    what = "refitting"
    evidence: DataSplit
    after: Fit
    sizes: Sizes

    def __call__(self, item: Start) -> Plain:
        assembly = model_with(self.evidence, item.attached, self.sizes)
        done = refit(self.evidence, assembly, self.after, p=item.p, first=item.first)
        return contender_plain(replayed(self.evidence, assembly, done))

    def restored(self, item: Start, found: Plain) -> Contender:
        return contender_of(
            self.evidence, model_with(self.evidence, item.attached, self.sizes), found
        )

    def name(self, item: Start) -> str:
        return " + ".join(a.label for a in item.attached)


def run_round(
    search: Search, base: Contender, candidates: list[Attachment], most: int
) -> tuple[list[Contender], list[tuple[str, str]], str]:
    """Screen all candidates on top of `base`, refit the promising ones, replay them on what was
    held out.

    Returns the models, what failed and why, and the family of the screen's own first choice.
    """
    evidence, sizes, run = search.evidence, search.budget.sizes, search.pool.run
    ground = Ground.of(base, len(search.candidates))
    tried = run(_Screening(evidence, ground, sizes, search.clues), candidates, search.progress)
    found = [
        Screened(a, None, {}, -np.inf, s.why) if isinstance(s, Failed) else s
        for a, s in zip(candidates, tried, strict=True)
    ]
    promising = sent_on({a.label: search.family(a) for a in candidates}, found, most, ground.held)
    starts = [_start(s, base) for s in promising]
    refitted = run(Refitting(evidence, base.fit, sizes), starts, search.progress)
    contenders = [c for c in refitted if not isinstance(c, Failed)]
    failed = [
        (s.attachment.label, s.why) for s in found if s.assembly is None or not np.isfinite(s.gain)
    ]
    failed += [
        (s.attached[-1].label, c.why)
        for s, c in zip(starts, refitted, strict=True)
        if isinstance(c, Failed)
    ]
    failed += [
        (c.attached[-1].label, "became unstable on held-out recordings")
        for c in contenders
        if not c.finite
    ]
    return (
        [c for c in contenders if c.finite],
        failed,
        search.family(promising[0].attachment) if promising else "",
    )


def _start(s: Screened, base: Contender) -> Start:
    """Where a screened candidate is refitted from: what the model below it has found, or the data
    sheet."""
    assert s.assembly is not None
    p = transferred(s.assembly, (base.assembly, base.fit.p)) if base.attached else None
    return Start(s.assembly.attachments, p, s.first)


def ranked(
    search: Search, contenders: list[Contender]
) -> tuple[tuple[Contender, ...], list[float]]:
    """Contenders in order, and the share of resamples that each wins (not yet a probability).

    Order is by mean log loss on the selection windows, but a simpler member of the first one's
    family stands before it unless the gain is sure and worth it; the wins of the kin it was
    preferred to count for it.
    """
    if not contenders:
        return (), []
    losses = search.losses(contenders)
    order = sorted(range(len(contenders)), key=lambda i: (losses[i].mean(), contenders[i].label))
    wins = np.bincount(losses.argmin(axis=0), minlength=len(contenders)) / losses.shape[1]
    ranking, share = [contenders[i] for i in order], [float(wins[i]) for i in order]
    i = ranking.index(_simplest(search, ranking))
    if i:
        share[i], share[0] = share[i] + share[0], 0.0
    order = [i, *(k for k in range(len(ranking)) if k != i)]
    return tuple(ranking[k] for k in order), [share[k] for k in order]


def _simplest(search: Search, ranking: list[Contender]) -> Contender:
    """The first, unless a simpler member of its family is as good: simpler unless the gain is sure
    and worth it."""
    best = ranking[0]
    kin = [c for c in ranking if c.family == best.family and _plainness(c) < _plainness(best)]
    if not kin:
        return best
    losses = search.losses([best, *kin])
    gap = search.excess(search.budget.baseline)
    plain = sorted(enumerate(kin, start=1), key=lambda e: (_plainness(e[1]), losses[e[0]].mean()))
    for i, c in plain:
        gain = losses[i] - losses[0]
        lost = search.excess(c) - search.excess(best)
        unsure = gain.mean() < SURE * gain.std() and lost < 4.0 * WORTH * gap
        slight = gain.mean() < SLIGHT * best.squares.shape[1] and lost < WORTH * gap
        if unsure or slight:
            return c
    return best


def _plainness(c: Contender) -> tuple[int, bool]:
    """Fewer parameters first; of equally many, an effect at home at its port before one of the
    general catalogue."""
    return c.free_count, not c.attached[-1].effect.kinds


def tied_with_first(
    search: Search, ranking: tuple[Contender, ...], classes: list[list[str]]
) -> tuple[Contender, ...]:
    """The first and those that neither the selection windows nor their predictions tell from it;
    those that predict alike have to be surely worse to be progress from it."""
    if not ranking:
        return ()
    losses = search.losses(list(ranking))
    same = next((k for k in classes if ranking[0].attached[-1].label in k), [])
    gap, first = search.excess(search.budget.baseline), search.excess(ranking[0])
    out = [ranking[0]]
    for i, c in enumerate(ranking[1:], start=1):
        worse = losses[i] - losses[0]
        unsure = worse.mean() < (SURE if c.attached[-1].label in same else 1.0) * worse.std()
        if unsure and search.excess(c) - first < 0.1 * gap:
            out.append(c)
    return tuple(out)


def settled(search: Search, best: Contender) -> Contender:
    """The winner with integration steps that doubling no longer changes, refitted where they had to
    be finer."""
    return search.pool.one(_Settling(search.evidence), best)


@dataclass(frozen=True, eq=False)
class _Settling(Work[Contender, Contender]):
    """A model with finer steps, where it needs them."""

    what = "settling"
    evidence: DataSplit

    def __call__(self, item: Contender) -> Plain:
        best = item
        for _ in range(3):
            tracks = self.evidence.tracks(best.assembly, held_out=True)
            if rechecked(best.assembly, best.fit, tracks, self.evidence.noise)[1] <= COARSE:
                break
            f = best.fit
            finer = fit(
                f.problem,
                p=f.p,
                starts=f.starts,
                weights=f.weights,
                continuity=f.continuity,
                stepping=f.stepping.doubled(),
                iterations=15,
                tolerance=2e-2,
            )
            best = replayed(self.evidence, best.assembly, finer)
        return {} if best is item else contender_plain(best)

    def restored(self, item: Contender, found: Plain) -> Contender:
        return contender_of(self.evidence, item.assembly, found) if found else item

    def name(self, item: Contender) -> str:
        return item.label
