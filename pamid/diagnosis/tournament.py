"""The diagnosis from end to end: budget, screen, refit, choose, add, locate, judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.attaching import Attachment, attachments
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.clues import Clues, gather_clues
from pamid.diagnosis.contest import Contender, bootstrap_losses, refit, replayed
from pamid.diagnosis.judgement import WORTH, Grounds, Judged, at_the_floor, judge, probabilities, weigh
from pamid.diagnosis.latent import Located, locate
from pamid.diagnosis.look_alikes import look_alike_classes
from pamid.diagnosis.screen import MOST, Ground, Screened, screen, sent_on
from pamid.effect import Effect
from pamid.evidence import Evidence, selection_part
from pamid.fitting import fit
from pamid.greybox import COARSE, model_with, rechecked
from pamid.jobs import portable, run_forked, run_jobs

Array = NDArray[np.float64]
Told = Callable[[str], None]

MOST_CAUSES = 3
TRACE = 0.02            # of the gap: what an effect has to remove to be named beside another one
MORE = 0.30             # ... and of what the others leave
SLIGHT = 0.1            # in log squared error per channel: less is not worth another parameter
SURE = 3.0              # standard errors by which it has to win
FEW_MORE = 4            # candidates refitted beside a first cause
LITTLE = 0.005          # of the latent evidence: where no more is missing, no further effect is looked for
PLAIN = 0.15            # ... or where less than this is missing, nats per sample
PLACES = 4              # classes of ports at which it is looked for


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found. ranking: contenders best first, with probabilities; cause: the chosen model, or None.

    best: the best model whatever the verdict; located: where something is missing before it.
    """

    evidence: Evidence
    budget: Budget
    chosen: NDArray[np.bool_]                 # held-out windows that chose; the others report
    verdict: str
    ranking: tuple[Contender, ...] = ()
    probability: tuple[float, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()  # candidates that could not be fitted, and why
    tied: tuple[Contender, ...] = ()
    best: Contender | None = None
    located: Located | None = None
    grounds: Grounds | None = None
    judged: Judged | None = None
    classes: tuple[tuple[str, ...], ...] = ()
    screened: str = ""                        # family that the screen alone would have named

    @property
    def cause(self) -> Contender | None:
        return self.best if self.verdict in ("explained", "ambiguous") else None

    @property
    def reporting(self) -> NDArray[np.bool_]:
        return ~self.chosen

    @property
    def singles(self) -> dict[str, Contender]:
        return {c.attached[-1].label: c for c in self.ranking}


@dataclass(frozen=True)
class _Search:
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


def diagnose(evidence: Evidence, catalogue: dict[str, type[Effect]], *, seed: int = 0, jobs: int = 1,
             told: Told = lambda text: None) -> Diagnosis:
    """Find where the gap lies, which effect causes it and how far it shrinks. told: what is going on, in words."""
    budget = gap_budget(evidence, seed=seed, jobs=jobs, told=told)
    base = budget.baseline
    chosen = selection_part(list(base.replays))
    if at_the_floor(budget, seed):
        return Diagnosis(evidence, budget, chosen, "no-structural-gap")
    search = _Search(evidence, budget, chosen, attachments(evidence.rig, catalogue.values()),
                     gather_clues(evidence, base), seed, jobs, told)
    told("looking where something is missing")
    located = locate(evidence, base, search.run)
    contenders, failed, screened = _round(search, base, search.candidates, MOST)
    ranking, wins = _ranked(search, contenders)
    classes = look_alike_classes(evidence, base, list(ranking[:8]))
    best, after = (None, located) if not ranking else _extended(search, ranking[0], located)
    ranking, wins = _with_best(ranking, wins, best)
    grounds = weigh(budget, chosen, ranking, best, located, after, seed)
    tied = _tied(search, ranking, classes)
    judged = judge(grounds, ambiguous=best is not None and len(best.attached) == 1
                   and len({c.family for c in tied}) > 1)
    return Diagnosis(evidence, budget, chosen, judged.verdict, ranking, tuple(probabilities(judged, wins)),
                     tuple(failed), tied, best, located, grounds, judged, tuple(tuple(k) for k in classes),
                     screened)


def _extended(search: _Search, best: Contender, located: Located) -> tuple[Contender, Located]:
    """The best single effect with what has to stand beside it, settled, and what is then still missing where.

    Greedy addition: a further effect is looked for where something is still missing; it has to remove a fair part of
    what is left and win by three standard errors. After each one the earlier ones are left out in turn: an effect that
    the newcomer has made needless goes.
    """
    best = _settled(search.evidence, best)
    while True:
        search.told(f"looking where something is missing beside {best.label}")
        after = locate(search.evidence, best, search.run, [k[0] for k in located.classes[:PLACES]])
        helped = search.budget.shrinkage(best.absolutes, search.chosen) > WORTH
        little = max(LITTLE * located.most, PLAIN * best.samples)
        if len(best.attached) == MOST_CAUSES or after.most < little or not helped:
            return best, after
        taken = {search.family(a) for a in best.attached}
        open_ports = {port for k in located.classes for port in k if after.gains.get(k[0], 0.0) > 0.5 * after.most}
        others = [a for a in search.candidates if search.family(a) not in taken and open_ports & set(a.ports)]
        more = _round(search, best, others, FEW_MORE)[0] if others else []
        if not more:
            return best, after
        newest = more[int(np.argmin(search.losses(more).mean(axis=1)))]
        if not _worth_it(search, newest, best):
            return best, after
        best = _settled(search.evidence, _without_needless(search, newest))


def _with_best(ranking: tuple[Contender, ...], wins: list[float],
               best: Contender | None) -> tuple[tuple[Contender, ...], list[float]]:
    """The ranking with a single best model as it was settled, in front also where the backward check brought it up."""
    if best is None or len(best.attached) > 1:
        return ranking, wins
    order = sorted(range(len(ranking)), key=lambda i: ranking[i].label != best.label)
    known = ranking[order[0]].label == best.label
    rest = [ranking[i] for i in (order[1:] if known else order)]
    share = wins if known and order[0] == 0 else [max(wins), *(wins[i] for i in (order[1:] if known else order))]
    return (best, *rest), share


def _round(search: _Search, base: Contender, candidates: list[Attachment],
           most: int) -> tuple[list[Contender], list[tuple[str, str]], str]:
    """Screen all candidates on top of `base`, refit the promising ones, replay them on what was held out.

    Returns the models, what failed and why, and the family of the screen's own first choice.
    """
    evidence, told = search.evidence, search.told
    ground = Ground.of(base)

    def screened(a: Attachment) -> Screened:
        return screen(evidence, ground, a, search.budget.sizes, search.clues)

    found = search.run(screened, candidates, lambda i, n: told(f"screening {i}/{n}: {candidates[i - 1].label}"))
    promising = sent_on({a.label: search.family(a) for a in candidates}, found, most)

    def fitted(s: Screened) -> Contender:
        assert s.assembly is not None
        done = refit(evidence, s.assembly, base.fit, first=s.first)
        return replayed(evidence, s.assembly, done)

    contenders = search.run(fitted, promising,
                            lambda i, n: told(f"refitting {i}/{n}: {promising[i - 1].attachment.label}"))
    failed = [(s.attachment.label, s.why) for s in found if s.assembly is None or not np.isfinite(s.gain)]
    failed += [(c.attached[-1].label, "became unstable on held-out recordings") for c in contenders if not c.finite]
    return [c for c in contenders if c.finite], failed, search.family(promising[0].attachment) if promising else ""


def _ranked(search: _Search, contenders: list[Contender]) -> tuple[tuple[Contender, ...], list[float]]:
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


def _simplest(search: _Search, ranking: list[Contender]) -> Contender:
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


def _settled(evidence: Evidence, best: Contender) -> Contender:
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


def _tied(search: _Search, ranking: tuple[Contender, ...], classes: list[list[str]]) -> tuple[Contender, ...]:
    """The first and those that neither the selection windows nor their predictions tell from it."""
    if not ranking:
        return ()
    losses = search.losses(list(ranking))
    same = next((k for k in classes if ranking[0].attached[-1].label in k), [])
    gap, first = search.excess(search.budget.baseline), search.excess(ranking[0])
    out = [ranking[0]]
    for i, c in enumerate(ranking[1:], start=1):
        worse = losses[i] - losses[0]
        close = search.excess(c) - first < 0.1 * gap
        if close and worse.mean() < 2.0 * worse.std() and (c.attached[-1].label in same or worse.mean() < worse.std()):
            out.append(c)
    return tuple(out)


def _worth_it(search: _Search, larger: Contender, smaller: Contender) -> bool:
    losses = search.losses([larger, smaller])
    gain = losses[1] - losses[0]
    left = search.excess(smaller)
    worth = max(TRACE * search.excess(search.budget.baseline), MORE * left)
    return bool(left - search.excess(larger) >= worth and gain.mean() >= SURE * gain.std())


def _without_needless(search: _Search, best: Contender) -> Contender:
    """Backward check: the model without any effect but the newest, if that one is missed by nobody."""
    for a in best.attached[:-1]:
        kept = tuple(k for k in best.attached if k is not a)
        assembly = model_with(search.evidence, kept, search.budget.sizes)
        first = {k: float(best.fit.p[best.assembly.keys[k]]) for k in assembly.keys if ":" in k}
        smaller = replayed(search.evidence, assembly, refit(search.evidence, assembly, search.budget.baseline.fit,
                                                          first=first))
        if smaller.finite and search.excess(smaller) - search.excess(best) < WORTH * search.excess(
                search.budget.baseline):
            return smaller
    return best
