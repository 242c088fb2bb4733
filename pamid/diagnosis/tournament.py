"""The diagnosis from end to end: budget, screen, refit, choose, add, locate, judge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.contender import Contender, replayed
from pamid.diagnosis.decision import (
    Grounds,
    Judged,
    at_the_floor,
    is_backed,
    judge,
    probabilities,
    weigh,
)
from pamid.diagnosis.forward_selection import Extended, Newcomer, extended
from pamid.diagnosis.look_alikes import look_alike_classes
from pamid.diagnosis.misfit_beyond_range import doubt
from pamid.diagnosis.naive_forecast import explains_nothing
from pamid.diagnosis.port_evidence import Located, locate
from pamid.diagnosis.screening import CROWDED, MOST
from pamid.diagnosis.search import Search, ranked, run_round, tied_with_first
from pamid.diagnosis.starting_hints import gather_clues
from pamid.estimation.restart import escape_local_minimum
from pamid.model.attachment import Attachment, attachments
from pamid.model.effect import Effect
from pamid.parallel.jobs import WorkerPool
from pamid.simulation.data_split import DataSplit, selection_part

# of the largest latent evidence: of many candidates those at ports with less are not screened
REACH = 0.3


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found. ranking: contenders best first, with probabilities; cause: the chosen
    model, or None.

    best: the best model whatever the verdict; located: where something is missing before it.
    """

    evidence: DataSplit
    budget: Budget
    chosen: NDArray[np.bool_]  # held-out windows that chose; the others report
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
    screened: str = ""  # family that the screen alone would have named
    newcomers: tuple[Newcomer, ...] = ()  # further effects that were weighed beside the first
    empty: bool = False  # the best model makes nothing of what was recorded
    units: dict[str, Any] | None = None  # why units and signs are in doubt

    @property
    def cause(self) -> Contender | None:
        return self.best if self.verdict in ("explained", "ambiguous") else None

    @property
    def reporting(self) -> NDArray[np.bool_]:
        return ~self.chosen

    @property
    def singles(self) -> dict[str, Contender]:
        return {c.attached[-1].label: c for c in self.ranking}


def diagnose(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = silent,
    pool: WorkerPool | None = None,
) -> Diagnosis:
    """Find where the gap lies, which effect causes it and how far it shrinks. progress: what is
    going on, in words; pool: who does the jobs (default: `jobs` processes of this machine)."""
    pool = pool or WorkerPool(jobs)
    budget = gap_budget(evidence, seed=seed, pool=pool, progress=progress)
    base = budget.baseline
    chosen = selection_part(list(base.replays))
    if at_the_floor(budget, seed):
        return Diagnosis(
            evidence,
            budget,
            chosen,
            "no-structural-gap",
            empty=explains_nothing(budget, base, seed),
        )
    search = Search(
        evidence,
        budget,
        chosen,
        attachments(evidence.rig, catalogue.values()),
        gather_clues(evidence, base),
        seed,
        pool,
        progress,
    )
    progress("looking where something is missing")
    located = locate(evidence, base, pool)
    contenders, failed, screened = run_round(
        search, base, within_reach(search.candidates, located), MOST
    )
    ranking, wins = ranked(search, contenders)
    classes = look_alike_classes(evidence, base, list(ranking[:8]))
    found = extended(search, ranking, located) if ranking else Extended(base, located)
    best = _freed(evidence, found.best) if ranking else None
    ranking, wins = _with_best(ranking, wins, best)
    grounds = weigh(budget, chosen, ranking, best, located, found.after, seed)
    tied = tied_with_first(search, ranking, classes)
    empty = explains_nothing(budget, best or base, seed)
    judged = judge(
        grounds,
        ambiguous=best is not None
        and len(best.attached) == 1
        and len({c.family for c in tied}) > 1,
        backed=best is None or is_backed(budget, best, ~chosen, seed),
        empty=empty,
    )
    units = doubt(evidence, base, best)
    verdict = (
        "unknown-effect"
        if units and judged.verdict in ("explained", "ambiguous")
        else judged.verdict
    )
    return Diagnosis(
        evidence,
        budget,
        chosen,
        verdict,
        ranking,
        tuple(probabilities(judged, wins)),
        tuple(failed),
        tied,
        best,
        located,
        grounds,
        judged,
        tuple(tuple(k) for k in classes),
        screened,
        found.newcomers,
        empty,
        units,
    )


def _freed(evidence: DataSplit, best: Contender) -> Contender:
    """The best model, out of the trap if its fit ended in one."""
    fitted = escape_local_minimum(best.fit, evidence.noise)
    if fitted is best.fit:
        return best
    better = replayed(evidence, best.assembly, fitted)
    return better if better.finite else best


def within_reach(candidates: list[Attachment], located: Located) -> list[Attachment]:
    """The candidates to screen: all of few; on a rig with many like ports those that act where
    something is missing, and enough of them."""
    if len(candidates) <= CROWDED:
        return candidates
    there = [max(located.gains[port] for port in a.ports) for a in candidates]
    enough = min(REACH * located.most, sorted(there)[-CROWDED // 2])
    return [a for a, gain in zip(candidates, there, strict=True) if gain >= enough]


def _with_best(
    ranking: tuple[Contender, ...], wins: list[float], best: Contender | None
) -> tuple[tuple[Contender, ...], list[float]]:
    """The ranking led by the best model's first effect: a single one as it was settled, also where
    the backward check brought it up; beside others as it was fitted alone."""
    if best is None:
        return ranking, wins
    if len(best.attached) > 1:
        label = best.attached[0].label
        best = next((c for c in ranking if c.label == label), ranking[0])
    order = sorted(range(len(ranking)), key=lambda i: ranking[i].label != best.label)
    known = ranking[order[0]].label == best.label
    rest = [ranking[i] for i in (order[1:] if known else order)]
    share = (
        wins
        if known and order[0] == 0
        else [max(wins), *(wins[i] for i in (order[1:] if known else order))]
    )
    return (best, *rest), share
