"""The diagnosis from end to end: gap budget, latent evidence at the ports, screening, refits,
ranking, forward selection, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.candidate_model import CandidateModel, replayed
from pamid.diagnosis.decision import (
    Decision,
    VerdictStatistics,
    at_noise_floor,
    decide,
    is_confirmed,
    probabilities,
    verdict_statistics,
)
from pamid.diagnosis.family_forms import FreeForm, free_forms
from pamid.diagnosis.forward_selection import ForwardSelection, ForwardStep, select_forward
from pamid.diagnosis.look_alikes import look_alike_classes
from pamid.diagnosis.misfit_beyond_range import scale_doubt
from pamid.diagnosis.naive_forecast import explains_nothing
from pamid.diagnosis.port_evidence import PortEvidence, locate
from pamid.diagnosis.search import (
    Search,
    carried_on,
    indistinguishable_from_first,
    opposite_signs,
    ranked,
    refit_screened,
    run_round,
)
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.restart import escape_local_minimum
from pamid.model.attachment import Attachment, attachments
from pamid.model.effect import Effect
from pamid.parallel.jobs import WorkerPool
from pamid.simulation.data_split import DataSplit, selection_part

CAUSED = ("explained", "ambiguous")  # verdicts that name a cause


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found. ranking: models best first, with probabilities; cause: the chosen
    model, or None.

    best: the best model whatever the verdict; located: where something is missing before it.
    """

    evidence: DataSplit
    budget: Budget
    chosen: NDArray[np.bool_]  # held-out windows that chose; the others report
    verdict: str
    ranking: tuple[CandidateModel, ...] = ()
    probability: tuple[float, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()  # candidates that could not be fitted, and why
    tied: tuple[CandidateModel, ...] = ()
    best: CandidateModel | None = None
    located: PortEvidence | None = None
    grounds: VerdictStatistics | None = None
    decision: Decision | None = None
    classes: tuple[tuple[str, ...], ...] = ()
    screened: str = ""  # family that the screen alone would have named
    forward_steps: tuple[ForwardStep, ...] = ()  # effects tried beside the first
    empty: bool = False  # the best model predicts no better than a guess without a model
    units: dict[str, Any] | None = None  # why units and signs are in doubt
    # effects that remove much with the opposite sign, and the share of the error that they remove
    opposite: tuple[tuple[CandidateModel, float], ...] = ()
    # families to one of which an effect outside the catalogue belongs, best first
    free_forms: tuple[FreeForm, ...] = ()

    @property
    def cause(self) -> CandidateModel | None:
        return self.best if self.verdict in CAUSED else None

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    @property
    def reporting(self) -> NDArray[np.bool_]:
        return ~self.chosen

    @property
    def nameless_at(self) -> list[str]:
        """Ports at one of which something enters that has no name: where a free form takes it up,
        else those with the largest latent evidence, which the recordings cannot tell apart."""
        formed = dict.fromkeys(f.attachment.ports[0] for f in self.free_forms)
        return list(formed or (self.located.classes[0] if self.located else ()))

    @property
    def singles(self) -> dict[str, CandidateModel]:
        return {c.attached[-1].label: c for c in self.ranking}


def diagnose(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = silent,
    pool: WorkerPool | None = None,
    settings: Settings = DEFAULT,
) -> Diagnosis:
    """Find where the gap lies, which effect causes it and how far it shrinks. progress: what is
    going on, in words; pool: who does the jobs (default: `jobs` processes of this machine);
    settings: thresholds, counts and times (see `pamid.diagnosis.settings`)."""
    pool = pool or WorkerPool(jobs)
    budget = gap_budget(evidence, seed=seed, pool=pool, progress=progress, settings=settings)
    base = budget.baseline
    chosen = selection_part(list(base.replays), budget.channel_losses(base.absolutes))
    if at_noise_floor(budget, seed):
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
        gather_hints(evidence, base, settings),
        seed,
        pool,
        progress,
    )
    progress("looking where something is missing")
    located = locate(evidence, base, pool, settings=settings)
    first = run_round(search, base, candidates_to_screen(search.candidates, located, settings))
    judged = _judged(search, located, first.models)
    failed = first.failed
    if judged.decision.verdict == "unknown-effect":
        # before it is said that nothing known explains it, everything known that acts there is
        # fitted: a few steps of screening are no verdict
        rest = [s for s in first.passed_over if _acts_where(located, s.attachment, settings)]
        models, more = refit_screened(search, base, rest)
        failed = failed + more
        everything = carried_on(search, [*first.models, *models])
        if everything != first.models:
            judged = _judged(search, located, everything)
    opposite: list[tuple[CandidateModel, float]] = []
    if judged.decision.verdict == "unknown-effect":
        opposite = opposite_signs(search, list(judged.ranking))
    forms: list[FreeForm] = []
    if judged.nameless:
        progress("looking for the family of what the catalogue does not hold")
        rivals = [*judged.ranking, *(c for c, _ in opposite)]
        forms = free_forms(search, base, located.classes[0], rivals)
    return Diagnosis(
        evidence,
        budget,
        chosen,
        judged.verdict,
        judged.ranking,
        tuple(probabilities(judged.decision, judged.wins)),
        tuple(failed),
        judged.tied,
        judged.best,
        located,
        judged.grounds,
        judged.decision,
        tuple(tuple(k) for k in judged.classes),
        first.first_family,
        judged.forward_steps,
        judged.empty,
        judged.units,
        tuple(opposite),
        tuple(forms),
    )


@dataclass(frozen=True, eq=False)
class _Judged:
    """What is said of models that were refitted."""

    verdict: str
    decision: Decision
    grounds: VerdictStatistics
    ranking: tuple[CandidateModel, ...]
    wins: list[float]
    tied: tuple[CandidateModel, ...]
    best: CandidateModel | None
    classes: list[list[str]]
    forward_steps: tuple[ForwardStep, ...]
    empty: bool
    units: dict[str, Any] | None

    @property
    def nameless(self) -> bool:
        """Is something missing for which the catalogue has no name? Not where the recordings show
        nothing of the model, or are misread."""
        return self.verdict == "unknown-effect" and not self.empty and self.units is None


def _judged(search: Search, located: PortEvidence, models: list[CandidateModel]) -> _Judged:
    """Ranking, further effects and verdict."""
    evidence, budget, chosen, seed = search.evidence, search.budget, search.chosen, search.seed
    base, settings = budget.baseline, search.settings
    ranking, wins = ranked(search, models)
    classes = look_alike_classes(evidence, base, list(ranking[: settings.compared]), settings)
    found = select_forward(search, ranking, located) if ranking else ForwardSelection(base, located)
    best = _freed(evidence, found.best) if ranking else None
    ranking, wins = _with_best(ranking, wins, best)
    grounds = verdict_statistics(budget, chosen, ranking, best, located, found.after, seed)
    tied = indistinguishable_from_first(search, ranking, classes)
    empty = explains_nothing(budget, best or base, seed)
    decision = _decided(search, grounds, best, tied, empty)
    units = scale_doubt(evidence, base, best, settings)
    # a cause found against a misread channel may be an artefact of the slip
    doubted = units and decision.verdict in CAUSED
    return _Judged(
        "unknown-effect" if doubted else decision.verdict,
        decision,
        grounds,
        ranking,
        wins,
        tied,
        best,
        classes,
        found.forward_steps,
        empty,
        units,
    )


def _decided(
    search: Search,
    grounds: VerdictStatistics,
    best: CandidateModel | None,
    tied: tuple[CandidateModel, ...],
    empty: bool,
) -> Decision:
    """The decision on a best model; "ambiguous" can only be one with a single effect, as ties are
    sought among single effects."""
    single = best is not None and len(best.attached) == 1
    return decide(
        grounds,
        ambiguous=single and len({c.family for c in tied}) > 1,
        confirmed=best is None or is_confirmed(search.budget, best, ~search.chosen, search.seed),
        empty=empty,
        settings=search.settings,
    )


def _acts_where(located: PortEvidence, a: Attachment, settings: Settings) -> bool:
    """Does it act at a port at which something is missing?"""
    most = settings.port_reach * located.most
    return max(located.gains[port] for port in a.ports) >= most


def _freed(evidence: DataSplit, best: CandidateModel) -> CandidateModel:
    """The best model, refitted from new window starts where its fit had ended in a local
    minimum."""
    fitted = escape_local_minimum(best.fit, evidence.noise)
    if fitted is best.fit:
        return best
    better = replayed(evidence, best.assembly, fitted)
    return better if better.finite else best


def candidates_to_screen(
    candidates: list[Attachment], located: PortEvidence, settings: Settings = DEFAULT
) -> list[Attachment]:
    """All candidates, up to `held_background_from` of them. Of more, those that act at ports with
    latent evidence, and at least half that number."""
    many = settings.held_background_from
    if len(candidates) <= many:
        return candidates
    there = [max(located.gains[port] for port in a.ports) for a in candidates]
    enough = min(settings.port_reach * located.most, sorted(there)[-many // 2])
    return [a for a, gain in zip(candidates, there, strict=True) if gain >= enough]


def _with_best(
    ranking: tuple[CandidateModel, ...], wins: list[float], best: CandidateModel | None
) -> tuple[tuple[CandidateModel, ...], list[float]]:
    """The ranking led by the best model's first effect: by the best model itself where it has one
    effect (the backward check may have chosen one that was not first), else by the model with its
    first effect alone."""
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
