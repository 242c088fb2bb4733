"""One round of the search: screen all candidates on top of a model, refit the promising ones, order
them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import (
    REFIT_ITERATIONS,
    REFIT_TOLERANCE,
    CandidateModel,
    known_along,
    refit,
    replayed,
    transferred,
)
from pamid.diagnosis.ranges import mirrored, widened
from pamid.diagnosis.screening import (
    ScreenedCandidate,
    ScreeningBaseline,
    advance,
    advancing,
    promising,
    screen,
)
from pamid.diagnosis.settings import Settings
from pamid.diagnosis.starting_hints import GapHints
from pamid.engine.known_slopes import KnownSlopes
from pamid.estimation.grey_box import COARSE, model_with, rechecked, settles
from pamid.estimation.lagged_linear import LaggedResponse
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, Attachment, wholes_of
from pamid.model.bound_parameter import Range, Sizes
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]

WIDENINGS = 2  # of a range that is a guess, by 4 each: sixteen times a typical magnitude
STEP_HALVINGS = 3  # of the integration steps of a model, at most
# candidates fitted with the opposite sign, and the share of the error that puts a sign in doubt
MIRRORED_MOST, MIRRORED_SHARE = 3, 0.2


@dataclass(frozen=True)
class Search:
    """Data, candidates and means of one diagnosis, shared by all of its steps."""

    evidence: DataSplit
    budget: Budget
    candidates: list[Addition]
    hints: GapHints
    seed: int
    pool: WorkerPool
    progress: Progress
    response: LaggedResponse | None = None  # of outputs to inputs

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    def family(self, a: Addition | Attachment) -> str:
        return a.family(self.evidence.rig)


@dataclass(frozen=True, eq=False)
class _ScreeningWork(Work[Addition, ScreenedCandidate]):
    """A candidate on top of a model."""

    what = "screening"
    evidence: DataSplit
    reference: ScreeningBaseline
    sizes: Sizes
    hints: GapHints

    def __call__(self, item: Addition) -> ScreenedCandidate:
        return screen(self.evidence, self.reference, item, self.sizes, self.hints)

    def name(self, item: Addition) -> str:
        return item.label


@dataclass(frozen=True, eq=False)
class _AdvanceWork(Work[ScreenedCandidate, ScreenedCandidate]):
    """A screened candidate some steps further."""

    what = "screening further"
    evidence: DataSplit
    reference: ScreeningBaseline

    def __call__(self, item: ScreenedCandidate) -> ScreenedCandidate:
        return advance(self.evidence, self.reference, item)

    def name(self, item: ScreenedCandidate) -> str:
        return item.added.label


@dataclass(frozen=True, eq=False)
class RefitStart:
    """A model to refit.

    p: its start (SI; default: the data sheet); first: further starting values (SI) by key; ranges:
    of parameters, in place of their own (SI, by key); assembly: the model itself, where it exists
    already.
    """

    attached: tuple[Attachment, ...]
    p: Array | None = None
    first: dict[str, float] = field(default_factory=dict)
    ranges: dict[str, Range] = field(default_factory=dict)
    assembly: Assembly | None = field(kw_only=True, compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class RefitWork(Work[RefitStart, CandidateModel]):
    """A model refitted from a fit of another one, and replayed over the held-out part."""

    what = "refitting"
    evidence: DataSplit
    after: Fit
    sizes: Sizes

    @cached_property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        return known_along(self.after)

    def __call__(self, item: RefitStart) -> CandidateModel:
        assembly, known = self._assembly(item), self.known
        # All parameters are fitted jointly. With the rig's parameters held, an effect would also
        # explain their errors.
        done = refit(self.evidence, assembly, self.after, p=item.p, first=item.first, known=known)
        # Bounded, because an effect without an upper limit would be widened for ever as a
        # parameter runs away.
        for _ in range(WIDENINGS):
            wider = widened(assembly, done)
            if wider is None:
                break
            assembly = wider
            done = refit(self.evidence, assembly, self.after, p=done.p, known=known)
        return replayed(self.evidence, assembly, done)

    def _assembly(self, item: RefitStart) -> Assembly:
        assembly = item.assembly or model_with(self.evidence, item.attached, self.sizes)
        return (
            replace(assembly, ranges={**assembly.ranges, **item.ranges})
            if item.ranges
            else assembly
        )

    def name(self, item: RefitStart) -> str:
        return " + ".join(a.label for a in item.attached)


@dataclass(frozen=True, eq=False)
class Round:
    """Candidates screened and refitted on top of a model. models: refitted and replayed; failed:
    candidates that could not be, and why; reference: of the screening; screened: all candidates
    that stayed stable in it."""

    models: list[CandidateModel]
    failed: list[tuple[str, str]]
    reference: ScreeningBaseline
    screened: list[ScreenedCandidate]


def run_round(search: Search, base: CandidateModel, candidates: list[Addition]) -> Round:
    """Screen all candidates on top of `base`, refit the promising ones, and replay them over the
    held-out part."""
    reference = ScreeningBaseline.of(base, len(search.candidates), search.settings)
    screened, leading = screened_candidates(search, reference, candidates)
    models, failed = refit_screened(search, base, leading)
    hopeless = [(s.added.label, s.why) for s in screened if not s.usable]
    return Round(models, hopeless + failed, reference, [s for s in screened if s.usable])


def screened_candidates(
    search: Search, reference: ScreeningBaseline, candidates: list[Addition]
) -> tuple[list[ScreenedCandidate], list[ScreenedCandidate]]:
    """The candidates screened, and those of them to refit.

    At many ports of a kind an effect is screened at all of them together first. Every member is a
    special case of it: where the whole gains no more than chance, so does each.
    """
    evidence, run, progress = search.evidence, search.pool.run, search.progress
    work = _ScreeningWork(evidence, reference, search.budget.sizes, search.hints)

    def screened_by_label(several: list[Addition]) -> dict[str, ScreenedCandidate]:
        tried = run(work, several, progress)
        return {
            a.label: ScreenedCandidate(a, None, {}, -np.inf, s.why) if isinstance(s, Failed) else s
            for a, s in zip(several, tried, strict=True)
        }

    wholes = screened_by_label(wholes_of(evidence.rig, candidates))
    idle = {label for s in wholes.values() if s.by_chance for label in s.added.labels}
    screened = screened_by_label([a for a in candidates if a.label not in idle])
    # Families, not labels: a family with many laws would otherwise take all places of the next
    # steps.
    families = {a.label: search.family(a) for a in candidates}
    leading = advancing(families, list(screened.values()), reference)
    further = run(_AdvanceWork(evidence, reference), leading, progress)
    screened |= {s.added.label: s for s in further if not isinstance(s, Failed)}
    # a candidate that was left behind has the gain that it has reached, and no promise
    ended = [replace(s, rival=None) for s in screened.values()]
    return ended, promising(families, ended, reference)


def refit_screened(
    search: Search, base: CandidateModel, screened: list[ScreenedCandidate]
) -> tuple[list[CandidateModel], list[tuple[str, str]]]:
    """Refit screened candidates on top of `base` and replay them over the held-out part. Returns
    the models, and the failures with their reasons."""
    starts = [_start(s, base) for s in screened]
    work = RefitWork(search.evidence, base.fit, search.budget.sizes)
    refitted = search.pool.run(work, starts, search.progress)
    models, failed = [], []
    for s, c in zip(screened, refitted, strict=True):
        if isinstance(c, Failed):
            failed.append((s.added.label, c.why))
        elif not c.finite:
            failed.append((s.added.label, "became unstable on held-out recordings"))
        else:
            models.append(c)
    return models, failed


def opposite_signs(
    search: Search, models: list[CandidateModel]
) -> list[tuple[CandidateModel, float]]:
    """Models whose effect ended at nothing and that remove much of the error with the opposite
    sign, the best first, with the share they remove: the sign of their port is in doubt."""
    tried = [(c, ranges) for c in models if (ranges := mirrored(c))]
    # Each one costs a refit.
    tried = tried[:MIRRORED_MOST]
    starts = [
        RefitStart(
            c.attached,
            ranges=ranges,
            first={key: 0.5 * low for key, (low, _) in ranges.items()},
            assembly=None,
        )
        for c, ranges in tried
    ]
    work = RefitWork(search.evidence, search.budget.baseline.fit, search.budget.sizes)
    shares = [
        (c, search.budget.shrinkage(c.absolutes))
        for c in search.pool.run(work, starts, search.progress)
        if not isinstance(c, Failed) and c.finite
    ]
    return sorted(((c, v) for c, v in shares if v > MIRRORED_SHARE), key=lambda e: -e[1])


def _start(s: ScreenedCandidate, base: CandidateModel) -> RefitStart:
    """Start of a screened candidate's refit: the fit of the model below it, or the data sheet. For
    a rig that is stepped always the fit, which a fit from the data sheet may not reach."""
    assert s.assembly is not None
    continues = base.attached or s.assembly.program.keeps_slopes
    p = transferred(s.assembly, (base.assembly, base.fit.p)) if continues else None
    return RefitStart(s.assembly.attachments, p, s.first, assembly=s.assembly)


def with_finer_steps(search: Search, best: CandidateModel) -> CandidateModel:
    """The model with integration steps so fine that halving them changes nothing, refitted where
    they were not."""
    return search.pool.one(_StepRefinement(search.evidence), best)


@dataclass(frozen=True, eq=False)
class _StepRefinement(Work[CandidateModel, CandidateModel]):
    """A model with finer steps, where it needs them."""

    what = "refining the integration steps of"
    evidence: DataSplit

    def __call__(self, item: CandidateModel) -> CandidateModel:
        best = item
        for _ in range(STEP_HALVINGS):
            tracks = self.evidence.tracks(best.assembly, held_out=True)
            noise = self.evidence.noise
            # Refinement costs refits, so that only the model to be named is refined.
            change = rechecked(best.assembly, best.fit, tracks, noise)[1]
            if change <= COARSE or not settles(best.assembly, best.fit, tracks, noise, change):
                break
            done = fit(
                best.fit.problem,
                p=best.fit.p,
                starts=best.fit.starts,
                weights=best.fit.weights,
                continuity=best.fit.continuity,
                stepping=best.fit.stepping.doubled(),
                iterations=REFIT_ITERATIONS,
                tolerance=REFIT_TOLERANCE,
            )
            # a delay of an input that is held between samples becomes a staircase at finer steps
            if done.cost > best.fit.cost:
                break
            best = replayed(self.evidence, best.assembly, done)
        return best

    def name(self, item: CandidateModel) -> str:
        return item.label
