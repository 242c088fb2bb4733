"""The diagnosis from end to end: budget, screen, refit, choose, add, locate, judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.attaching import Attachment, attachments
from pamid.diagnosis.budget import NO_GAP, Budget, gap_budget
from pamid.diagnosis.contest import Contender, bootstrap_losses, judged, refit
from pamid.diagnosis.localise import spectrum_peaks
from pamid.diagnosis.look_alikes import look_alike_classes
from pamid.diagnosis.screen import Screened, screen, sent_on
from pamid.effect import Effect, Hints
from pamid.evidence import Evidence, selection_part
from pamid.fitting import fit
from pamid.greybox import COARSE, rechecked
from pamid.jobs import run_jobs
from pamid.metrics import moving_block_interval

Array = NDArray[np.float64]
Told = Callable[[str], None]

MOST_CAUSES = 3
WORTH = 0.05            # of the gap: what an effect has to remove to be worth naming
MORE = 0.10             # ... to be worth naming beside another one
SLIGHT = 0.1            # in log squared error per channel: less is not worth another parameter
SURE = 3.0              # standard errors by which it has to win
EXPLAINED = 0.25        # of the gap that may remain beyond what a black box leaves
HALF_WAY = 0.60         # of the gap that may remain at all


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found. ranking: contenders best first, with probabilities; causes: the chosen model, or None."""

    evidence: Evidence
    budget: Budget
    chosen: NDArray[np.bool_]                 # held-out windows that chose; the others report
    verdict: str
    ranking: tuple[Contender, ...]
    probability: tuple[float, ...]
    failed: tuple[tuple[str, str], ...]       # candidates that could not be fitted, and why
    tied: tuple[Contender, ...]
    cause: Contender | None
    singles: dict[str, Contender] = field(default_factory=dict)
    classes: tuple[tuple[str, ...], ...] = ()

    @property
    def reporting(self) -> NDArray[np.bool_]:
        return ~self.chosen


def diagnose(evidence: Evidence, catalogue: dict[str, type[Effect]], *, seed: int = 0, jobs: int = 1,
             told: Told = lambda text: None) -> Diagnosis:
    """Find where the gap lies, which effect causes it and how far it shrinks. told: what is going on, in words."""
    budget = gap_budget(evidence, seed=seed, jobs=jobs, told=told)
    base = budget.baseline
    chosen = selection_part(list(base.replays))
    if _no_gap(budget, seed):
        return Diagnosis(evidence, budget, chosen, "no-structural-gap", (), (), (), (), None)
    candidates = attachments(evidence.rig, catalogue.values())
    hints = Hints(spectrum_peaks(list(base.replays), evidence.noise))
    contenders, failed = _round(evidence, budget, base, candidates, hints, jobs, told)
    if not contenders:
        return Diagnosis(evidence, budget, chosen, _unexplained(budget), (), (), tuple(failed), (), None)
    order, probability = _rank(contenders, chosen, seed)
    ranking = tuple(contenders[i] for i in order)
    classes = look_alike_classes(evidence, base, list(ranking[:8]))
    best = _simplest(budget, ranking, chosen, seed)
    ranking, probability = _to_front(ranking, probability, best)
    verdict, cause, tied = _judge(evidence, budget, ranking, best, chosen, classes, candidates, hints, seed, jobs, told)
    if cause is not None and cause.label == ranking[0].label:
        ranking = (cause, *ranking[1:])  # the ranking shows the model that the verdict rests on
    return Diagnosis(evidence, budget, chosen, verdict, ranking, tuple(probability), tuple(failed), tied, cause,
                     {c.attached[-1].label: c for c in ranking}, tuple(tuple(k) for k in classes))


def _no_gap(budget: Budget, seed: int) -> bool:
    """The refitted model is at the floor in every channel, within 10 %, with 95 % confidence."""
    return all(moving_block_interval(budget.baseline.absolutes[:, c], budget.floor[:, c], seed=seed)[1] < 1.0 + NO_GAP
               for c in range(budget.floor.shape[1]))


def _unexplained(budget: Budget) -> str:
    """Nothing helps: is what is left material?"""
    ratio = budget.baseline.absolutes.mean(axis=0) / budget.floor.mean(axis=0)
    return "unknown-effect" if float(ratio.max()) > 1.25 else "no-structural-gap"


def _round(evidence: Evidence, budget: Budget, base: Contender, candidates: list[Attachment], hints: Hints, jobs: int,
           told: Told) -> tuple[list[Contender], list[tuple[str, str]]]:
    """Screen all candidates on top of `base`, refit the promising ones, replay them on what was held out."""
    def screened(a: Attachment) -> Screened:
        return screen(evidence, base, a, budget.sizes, hints)

    found = run_jobs(screened, candidates, jobs=jobs,
                     done=lambda i, n: told(f"screening {i}/{n}: {candidates[i - 1].label}"))
    families = {a.label: _family(evidence, a) for a in candidates}
    promising = sent_on(families, found)

    def fitted(s: Screened) -> Contender:
        assert s.assembly is not None
        done = refit(evidence, s.assembly, base.fit, first=s.first)
        return judged(evidence, s.assembly, done)

    contenders = run_jobs(fitted, promising, jobs=jobs,
                          done=lambda i, n: told(f"refitting {i}/{n}: {promising[i - 1].attachment.label}"))
    failed = [(s.attachment.label, s.why) for s in found if s.assembly is None or not np.isfinite(s.gain)]
    failed += [(c.attached[-1].label, "became unstable on held-out recordings") for c in contenders if not c.finite]
    return [c for c in contenders if c.finite], failed


def _family(evidence: Evidence, a: Attachment) -> str:
    return a.effect.family_at(evidence.rig.ports[a.ports[0]].kind)


def _rank(contenders: list[Contender], chosen: NDArray[np.bool_], seed: int) -> tuple[list[int], list[float]]:
    """Order by mean log loss on the selection windows; probability: share of resamples a contender wins."""
    losses = bootstrap_losses(contenders, chosen, seed)
    order = sorted(range(len(contenders)), key=lambda i: (losses[i].mean(), contenders[i].label))
    wins = np.bincount(losses.argmin(axis=0), minlength=len(contenders)) / losses.shape[1]
    return order, [float(wins[i]) for i in order]


def _simplest(budget: Budget, ranking: tuple[Contender, ...], chosen: NDArray[np.bool_], seed: int) -> Contender:
    """The first, unless a simpler member of its family is as good: simpler unless the gain is sure and worth it."""
    best = ranking[0]
    kin = [c for c in ranking if c.family == best.family and _plainness(c) < _plainness(best)]
    if not kin:
        return best
    losses = bootstrap_losses([best, *kin], chosen, seed)
    gap = budget.excess(budget.baseline.absolutes, chosen)
    plain = sorted(enumerate(kin, start=1), key=lambda e: (_plainness(e[1]), losses[e[0]].mean()))
    for i, c in plain:
        gain = losses[i] - losses[0]
        lost = budget.excess(c.absolutes, chosen) - budget.excess(best.absolutes, chosen)
        unsure = gain.mean() < SURE * gain.std() and lost < 4.0 * WORTH * gap
        slight = gain.mean() < SLIGHT * best.squares.shape[1] and lost < WORTH * gap
        if unsure or slight:
            return c
    return best


def _plainness(c: Contender) -> tuple[int, bool]:
    """Fewer parameters first; of equally many, an effect at home at its port before one of the general catalogue."""
    return c.free_count, not c.attached[-1].effect.kinds


def _to_front(ranking: tuple[Contender, ...], probability: list[float],
              best: Contender) -> tuple[tuple[Contender, ...], list[float]]:
    """Put the chosen one first; the wins of the kin it was preferred to count for it."""
    i = ranking.index(best)
    order = [i, *(k for k in range(len(ranking)) if k != i)]
    wins = list(probability)
    if i:
        wins[i], wins[0] = wins[i] + wins[0], 0.0
    return tuple(ranking[k] for k in order), [wins[k] for k in order]


def _judge(evidence: Evidence, budget: Budget, ranking: tuple[Contender, ...], best: Contender,
           chosen: NDArray[np.bool_], classes: list[list[str]], candidates: list[Attachment], hints: Hints, seed: int,
           jobs: int, told: Told) -> tuple[str, Contender | None, tuple[Contender, ...]]:
    """Verdict, the model it rests on, and the contenders that cannot be told from the best."""
    gap = budget.excess(budget.baseline.absolutes, chosen)
    base_loss, best_loss = bootstrap_losses([budget.baseline, ranking[0]], chosen, seed)
    helps = float((best_loss < base_loss).mean()) > 0.99
    if not helps or budget.shrinkage(best.absolutes, chosen) < WORTH:
        return _unexplained(budget), None, ()
    best = _settled(evidence, _add_more(evidence, budget, best, chosen, candidates, hints, seed, jobs, told))
    left = budget.excess(best.absolutes, chosen)
    ceiling = budget.excess(budget.black_box, chosen)
    if left > HALF_WAY * gap or left - ceiling > EXPLAINED * gap:
        return "unknown-effect", None, ()
    tied = _tied(budget, ranking, chosen, classes, seed)
    families = {c.family for c in tied}
    if len(families) > 1 and len(best.attached) == 1:
        return "ambiguous", best, tied
    return "explained", best, tied


def _settled(evidence: Evidence, best: Contender) -> Contender:
    """The winner with integration steps that doubling no longer changes, refitted where they had to be finer."""
    for _ in range(3):
        tracks = evidence.tracks(best.assembly, held_out=True)
        if rechecked(best.assembly, best.fit, tracks, evidence.noise)[1] <= COARSE:
            break
        f = best.fit
        best = judged(evidence, best.assembly, fit(f.problem, p=f.p, starts=f.starts, weights=f.weights, pulls=f.pulls,
                                                   stepping=f.stepping.doubled(), iterations=15, tolerance=2e-2))
    return best


def _tied(budget: Budget, ranking: tuple[Contender, ...], chosen: NDArray[np.bool_], classes: list[list[str]],
          seed: int) -> tuple[Contender, ...]:
    """The first and those that neither the selection windows nor their predictions tell from it."""
    losses = bootstrap_losses(list(ranking), chosen, seed)
    same = next((k for k in classes if ranking[0].attached[-1].label in k), [])
    gap = budget.excess(budget.baseline.absolutes, chosen)
    first = budget.excess(ranking[0].absolutes, chosen)
    out = [ranking[0]]
    for i, c in enumerate(ranking[1:], start=1):
        worse = losses[i] - losses[0]
        close = budget.excess(c.absolutes, chosen) - first < 0.1 * gap
        if close and worse.mean() < 2.0 * worse.std() and (c.attached[-1].label in same or worse.mean() < worse.std()):
            out.append(c)
    return tuple(out)


def _add_more(evidence: Evidence, budget: Budget, best: Contender, chosen: NDArray[np.bool_],
              candidates: list[Attachment], hints: Hints, seed: int, jobs: int, told: Told) -> Contender:
    """Greedy addition: a further effect has to remove 10 % of the gap and win by three standard errors."""
    gap = budget.excess(budget.baseline.absolutes, chosen)
    while len(best.attached) < MOST_CAUSES and budget.excess(best.absolutes, chosen) > max(WORTH * gap, NO_GAP):
        taken = {_family(evidence, a) for a in best.attached}
        others = [a for a in candidates if _family(evidence, a) not in taken]
        told(f"looking for a second effect beside {best.label}")
        more, _ = _round(evidence, budget, best, others, hints, jobs, told)
        if not more:
            return best
        losses = bootstrap_losses([best, *more], chosen, seed)
        i = int(np.argmin(losses[1:].mean(axis=1)))
        gain = losses[0] - losses[i + 1]
        removed = budget.excess(best.absolutes, chosen) - budget.excess(more[i].absolutes, chosen)
        if removed < MORE * gap or gain.mean() < SURE * gain.std():
            return best
        best = more[i]
    return best
