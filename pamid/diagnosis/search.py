"""One round of the search: screen all candidates on top of a model, refit the promising ones, order them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.attaching import Attachment
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.clues import Clues
from pamid.diagnosis.contest import Contender, bootstrap_losses, refit, replayed, transferred
from pamid.diagnosis.judgement import WORTH
from pamid.diagnosis.screen import Ground, Screened, screen, sent_on
from pamid.evidence import Evidence
from pamid.fitting import fit
from pamid.greybox import COARSE, rechecked
from pamid.jobs import portable, run_forked, run_jobs

Array = NDArray[np.float64]
Told = Callable[[str], None]

SLIGHT = 0.1            # in log squared error per channel: less is not worth another parameter
SURE = 3.0              # standard errors by which a more elaborate effect, or one of two alike, has to win


@dataclass(frozen=True)
class Search:
    """What every step of a diagnosis needs."""

    evidence: Evidence
    budget: Budget
    chosen: NDArray[np.bool_]
    candidates: list[Attachment]
    clues: Clues
    seed: int
    jobs: int
    told: Told

    def run(self, work: Callable[[Any], Any], items: list[Any],
            done: Callable[[int, int], None] | None = None) -> list[Any]:
        """Independent jobs on the cores: in processes, as threads where the rig or an effect cannot be sent to one."""
        effects = [a.effect for a in self.candidates]
        share = run_forked if self.jobs > 1 and portable(self.evidence.rig, effects) else run_jobs
        return share(work, items, jobs=self.jobs, done=done)

    def family(self, a: Attachment) -> str:
        return a.family(self.evidence.rig)

    def excess(self, c: Contender) -> float:
        return self.budget.excess(c.absolutes, self.chosen)

    def losses(self, contenders: list[Contender]) -> Array:
        return bootstrap_losses(contenders, self.chosen, self.seed)


def run_round(search: Search, base: Contender, candidates: list[Attachment],
              most: int) -> tuple[list[Contender], list[tuple[str, str]], str]:
    """Screen all candidates on top of `base`, refit the promising ones, replay them on what was held out.

    Returns the models, what failed and why, and the family of the screen's own first choice.
    """
    evidence, told = search.evidence, search.told
    ground = Ground.of(base, len(search.candidates))

    def screened(a: Attachment) -> Screened:
        return screen(evidence, ground, a, search.budget.sizes, search.clues)

    found = search.run(screened, candidates, lambda i, n: told(f"screening {i}/{n}: {candidates[i - 1].label}"))
    promising = sent_on({a.label: search.family(a) for a in candidates}, found, most, ground.held)

    def fitted(s: Screened) -> Contender:
        assert s.assembly is not None
        p = transferred(s.assembly, (base.assembly, base.fit.p)) if base.attached else None
        done = refit(evidence, s.assembly, base.fit, p=p, first=s.first)
        return replayed(evidence, s.assembly, done)

    contenders = search.run(fitted, promising,
                            lambda i, n: told(f"refitting {i}/{n}: {promising[i - 1].attachment.label}"))
    failed = [(s.attachment.label, s.why) for s in found if s.assembly is None or not np.isfinite(s.gain)]
    failed += [(c.attached[-1].label, "became unstable on held-out recordings") for c in contenders if not c.finite]
    return [c for c in contenders if c.finite], failed, search.family(promising[0].attachment) if promising else ""


def ranked(search: Search, contenders: list[Contender]) -> tuple[tuple[Contender, ...], list[float]]:
    """Contenders in order, and the share of resamples that each wins (not yet a probability).

    Order is by mean log loss on the selection windows, but a simpler member of the first one's family stands before it
    unless the gain is sure and worth it; the wins of the kin it was preferred to count for it.
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
    """The first, unless a simpler member of its family is as good: simpler unless the gain is sure and worth it."""
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
    """Fewer parameters first; of equally many, an effect at home at its port before one of the general catalogue."""
    return c.free_count, not c.attached[-1].effect.kinds


def tied_with_first(search: Search, ranking: tuple[Contender, ...], classes: list[list[str]]) -> tuple[Contender, ...]:
    """The first and those that neither the selection windows nor their predictions tell from it; those that predict
    alike have to be surely worse to be told from it."""
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


def settled(evidence: Evidence, best: Contender) -> Contender:
    """The winner with integration steps that doubling no longer changes, refitted where they had to be finer."""
    for _ in range(3):
        tracks = evidence.tracks(best.assembly, held_out=True)
        if rechecked(best.assembly, best.fit, tracks, evidence.noise)[1] <= COARSE:
            break
        f = best.fit
        finer = fit(f.problem, p=f.p, starts=f.starts, weights=f.weights, pulls=f.pulls,
                    stepping=f.stepping.doubled(), iterations=15, tolerance=2e-2)
        best = replayed(evidence, best.assembly, finer)
    return best
