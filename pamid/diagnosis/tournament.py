"""The diagnosis from end to end: gap budget, latent evidence at the ports, screening, refits,
ranking, forward selection, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.cross_fitting import reported
from pamid.diagnosis.decision import Share, at_noise_floor, gap_share
from pamid.diagnosis.family_forms import FreeForm, free_forms
from pamid.diagnosis.input_response import explained_channels, silent_channels
from pamid.diagnosis.judging import Judged, judge
from pamid.diagnosis.port_evidence import PortEvidence, locate
from pamid.diagnosis.screening import by_gain
from pamid.diagnosis.search import (
    Search,
    carried_on,
    opposite_signs,
    refit_screened,
    run_round,
)
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.lagged_linear import LaggedResponse, lagged_response
from pamid.model.attachment import Attachment, attachments
from pamid.model.effect import Effect
from pamid.parallel.jobs import WorkerPool
from pamid.schemas.diagnosis_file import CAUSED
from pamid.simulation.data_split import DataSplit, half_of_windows

Array = NDArray[np.float64]
NOTHING_OPEN = ("explained", "no-structural-gap")  # verdicts that need no further candidates


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found. located: where something is missing before any effect; judged: what came
    of the candidates; neither where the refitted model is at the noise floor."""

    evidence: DataSplit
    budget: Budget
    half: NDArray[np.bool_]  # of the held-out windows
    seed: int = 0
    silent: tuple[str, ...] = ()  # channels that do not show this machine: `silent_channels`
    response: LaggedResponse | None = None  # of outputs to inputs; None where no input moves
    located: PortEvidence | None = None
    judged: Judged | None = None
    failed: tuple[tuple[str, str], ...] = ()  # candidates that could not be fitted, and why
    screened: str = ""  # family that the screen alone would have named
    # effects that remove much with the opposite sign, and the share of the error that they remove
    opposite: tuple[tuple[CandidateModel, float], ...] = ()
    # families to one of which an effect outside the catalogue belongs, best first
    free_forms: tuple[FreeForm, ...] = ()

    @property
    def verdict(self) -> str:
        if self.judged is None:
            return "cannot-tell" if self.silent else "no-structural-gap"
        return self.judged.decision.verdict

    @property
    def cause(self) -> CandidateModel | None:
        """The model with the causes that the verdict names."""
        return self.judged.best if self.judged and self.verdict in CAUSED else None

    @property
    def removed(self) -> Share | None:
        """Share of the gap that the causes remove together; beside an effect that is not named,
        what each removes."""
        if self.cause is None or self.judged is None:
            return None
        named = [m.removes for m in self.judged.named]
        if 0 < len(named) < len(self.judged.members):
            sums = (
                sum(s.share for s in named),
                sum(s.low for s in named),
                sum(s.high for s in named),
            )
            return Share(*(min(x, 1.0) for x in sums))
        return self.removed_by(self.cause)

    def removed_by(self, c: CandidateModel) -> Share:
        """Share of the gap that a model removes."""
        base = self.budget.baseline.absolutes
        return gap_share(self.budget, base, self.reported(c), self.seed)

    @property
    def left_at(self) -> PortEvidence | None:
        """Where something is missing beside the causes; where there are none, at all."""
        return self.judged.after if self.judged and self.cause else self.located

    @property
    def ranking(self) -> tuple[CandidateModel, ...]:
        return self.judged.ranking if self.judged else ()

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    def reported(self, c: CandidateModel) -> Array:
        """Errors of a model per held-out window and channel, each told by windows that had no part
        in choosing it."""
        return reported(self.judged.halves if self.judged else None, c)

    @property
    def nameless_at(self) -> list[str]:
        """Ports at one of which something enters that has no name: where a free form takes it up,
        else those with the largest latent evidence, which the recordings cannot tell apart."""
        formed = dict.fromkeys(f.attachment.ports[0] for f in self.free_forms)
        return list(formed or (self.left_at.classes[0] if self.left_at else ()))

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
    evidence = evidence.excerpt(settings.fitted_most, settings.held_out_most)
    budget = gap_budget(evidence, seed=seed, pool=pool, progress=progress, settings=settings)
    base = budget.baseline
    half = half_of_windows(list(base.replays), budget.channel_losses(base.absolutes))
    response = lagged_response(evidence, base.assembly)
    explained = explained_channels(budget, base, response, seed)
    silent = silent_channels(budget, base, explained, response)
    at_floor = at_noise_floor(budget, seed)
    # what neither the model nor any lag of the inputs predicts needs no search: whatever effect
    # reproduces it does so without the inputs
    hopeless = response is not None and (response.absent.all() or explained.any())
    if at_floor or (silent and hopeless):
        return Diagnosis(evidence, budget, half, seed, silent, response)
    search = Search(
        evidence,
        budget,
        np.ones_like(half),
        half,
        attachments(evidence.rig, catalogue.values()),
        gather_hints(evidence, base, settings),
        seed,
        pool,
        progress,
        response,
    )
    progress("looking where something is missing")
    located = locate(evidence, base, pool, settings=settings)
    first = run_round(search, base, candidates_to_screen(search.candidates, located, settings))
    judged = judge(search, located, first, first.models)
    failed = first.failed
    opposite: list[tuple[CandidateModel, float]] = []
    if judged.decision.verdict not in NOTHING_OPEN:
        # before the verdict says that nothing known explains the gap, every known effect that acts
        # there is refitted: a few steps of screening are not enough to reject it
        named = bool(judged.decision.named)
        rest = [
            s
            for s in ([] if named else by_gain(first.passed_over))
            if _acts_where(located, s.attachment, settings)
        ]
        models, more = refit_screened(search, base, rest)
        failed = failed + more
        # what stands behind a name has been fitted to its end
        before = first.models if named else carried_on(search, first.models)
        everything = [*before, *carried_on(search, models)]
        if any(a is not b for a, b in zip_longest(everything, first.models)):
            judged = judge(search, located, first, everything, judged.selection)
        if not judged.decision.named:
            opposite = opposite_signs(search, list(judged.ranking))
    forms: list[FreeForm] = []
    if judged.decision.left_over:
        progress("looking for the family of what the catalogue does not hold")
        forms = _forms(search, located, judged, [c for c, _ in opposite])
    return Diagnosis(
        evidence,
        budget,
        half,
        seed,
        judged.silent,
        response,
        located,
        judged,
        tuple(failed),
        first.first_family,
        tuple(opposite),
        tuple(forms),
    )


def _forms(
    search: Search, located: PortEvidence, judged: Judged, opposite: list[CandidateModel]
) -> list[FreeForm]:
    """Free forms of what is missing: beside the causes, or altogether where none is named."""
    if judged.decision.named:
        return free_forms(search, judged.best, judged.after.classes[0])
    rivals = [*judged.ranking, *opposite]
    return free_forms(search, search.budget.baseline, located.classes[0], rivals)


def _acts_where(located: PortEvidence, a: Attachment, settings: Settings) -> bool:
    """Does it act at a port at which something is missing?"""
    most = settings.port_reach * located.most
    return max(located.gains[port] for port in a.ports) >= most


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
