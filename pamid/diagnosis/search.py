"""A round of the search: screen all candidates on top of a model and refit the promising ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pamid.base.arrays import Array
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.base.progress import Progress
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import (
    CandidateModel,
    known_along,
    refit,
    replayed,
    transferred,
)
from pamid.diagnosis.comparison import Comparison
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
from pamid.engine.known_slopes import KnownSlopes
from pamid.estimation.grey_box import (
    COARSE,
    GreyBox,
    model_with,
    rechecked,
    restarted,
    settles,
)
from pamid.estimation.lagged_linear import LaggedResponse
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit
from pamid.estimation.restart import REFIT_ITERATIONS, REFIT_TOLERANCE, TRAPPED
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, Attachment, wholes_of
from pamid.model.bound_parameter import Range, Sizes
from pamid.model.effect import Hints
from pamid.simulation.data_split import DataSplit

WIDENINGS = 2  # of a guessed range at most, by 4 each: up to 16 times a typical magnitude
STEP_HALVINGS = 3  # maximum number of halvings of a model's integration step
# maximum number of models refitted with the opposite sign, and the share of the error that any must
# remove to put a sign in doubt
MIRRORED_MOST, MIRRORED_SHARE = 3, 0.2


@dataclass(frozen=True)
class Search:
    """Data, candidates and resources of a diagnosis, shared by all of its steps."""

    evidence: DataSplit
    budget: Budget
    candidates: list[Addition]
    hints: Mapping[str, Hints]
    seed: int
    pool: WorkerPool
    progress: Progress
    response: LaggedResponse | None = None  # linear response of outputs to inputs

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    def family(self, a: Addition | Attachment) -> str:
        return a.family(self.evidence.rig)


@dataclass(frozen=True, eq=False)
class _ScreeningWork(Work[Addition, ScreenedCandidate]):
    """Job that screens a candidate on top of a model."""

    what = "screening"
    evidence: DataSplit
    reference: ScreeningBaseline
    sizes: Sizes
    hints: Mapping[str, Hints]

    def __call__(self, item: Addition) -> ScreenedCandidate:
        return screen(self.evidence, self.reference, item, self.sizes, self.hints)


@dataclass(frozen=True, eq=False)
class _AdvanceWork(Work[ScreenedCandidate, ScreenedCandidate]):
    """Job that takes further steps with a screened candidate."""

    what = "screening further"
    evidence: DataSplit
    reference: ScreeningBaseline

    def __call__(self, item: ScreenedCandidate) -> ScreenedCandidate:
        return advance(self.evidence, self.reference, item)


@dataclass(frozen=True, eq=False)
class RefitStart:
    """A model to refit.

    p: starting parameters (SI; default: the data sheet); first: starting values (SI) by key that
    replace those in p; ranges: ranges (SI) by key that replace those of the parameters; assembly:
    the model, if it is already built.
    """

    attached: tuple[Attachment, ...]
    p: Array | None = None
    first: dict[str, float] = field(default_factory=dict)
    ranges: dict[str, Range] = field(default_factory=dict)
    assembly: Assembly | None = field(kw_only=True, compare=False, repr=False)

    @property
    def label(self) -> str:
        return " + ".join(a.label for a in self.attached)


@dataclass(frozen=True, eq=False)
class RefitWork(Work[RefitStart, CandidateModel]):
    """Job that refits a model after the fit of another, and replays it on held-out data."""

    what = "refitting"
    evidence: DataSplit
    after: Fit
    sizes: Sizes

    @cached_property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        return known_along(self.after)

    def __call__(self, item: RefitStart) -> CandidateModel:
        assembly = item.assembly or model_with(self.evidence, item.attached, self.sizes)
        known = self.known
        if item.ranges:
            assembly = replace(assembly, ranges={**assembly.ranges, **item.ranges})
        # All parameters are fitted jointly, else the effect would absorb the errors of the others.
        fitted = refit(self.evidence, assembly, self.after, p=item.p, first=item.first, known=known)
        # The number of widenings is limited, because a diverging parameter without an upper bound
        # would be widened forever.
        for _ in range(WIDENINGS):
            wider = widened(assembly, fitted)
            if wider is None:
                break
            assembly = wider
            fitted = refit(self.evidence, assembly, self.after, p=fitted.p, known=known)
        return replayed(self.evidence, assembly, fitted)


@dataclass(frozen=True, eq=False)
class Round:
    """Result of a round on top of a model.

    models: refitted and replayed candidates; failed: candidates that could not be screened or
    refitted, with reasons; reference: baseline of the screening; screened: all candidates that
    stayed stable in it.
    """

    models: list[CandidateModel]
    failed: list[tuple[str, str]]
    reference: ScreeningBaseline
    screened: list[ScreenedCandidate]


def run_round(search: Search, base: CandidateModel, candidates: list[Addition]) -> Round:
    """Screen all candidates on top of `base`, refit the promising ones, and replay them over the
    held-out part."""
    reference = ScreeningBaseline.of(base, len(search.candidates), search.settings)
    screened, to_refit = screened_candidates(search, reference, candidates)
    models, failed = refit_screened(search, base, to_refit)
    unusable = [(s.label, s.why) for s in screened if not s.usable]
    return Round(models, unusable + failed, reference, [s for s in screened if s.usable])


def screened_candidates(
    search: Search, reference: ScreeningBaseline, candidates: list[Addition]
) -> tuple[list[ScreenedCandidate], list[ScreenedCandidate]]:
    """Screen candidates; return all of them, and those to refit.

    If a rig has many ports of a kind, an effect is first screened at all of them together. An
    effect at a single port is a special case of this. If all ports together gain no more than
    chance, we do not screen them separately.
    """
    evidence, run, progress = search.evidence, search.pool.run, search.progress
    work = _ScreeningWork(evidence, reference, search.budget.sizes, search.hints)

    def screened_by_label(additions: list[Addition]) -> dict[str, ScreenedCandidate]:
        results = run(work, additions, progress)
        return {
            a.label: ScreenedCandidate(a, None, {}, -np.inf, s.why) if isinstance(s, Failed) else s
            for a, s in zip(additions, results, strict=True)
        }

    joint = screened_by_label(wholes_of(evidence.rig, candidates))
    insignificant = {label for s in joint.values() if s.by_chance for label in s.added.labels}
    screened = screened_by_label([a for a in candidates if a.label not in insignificant])
    # Select by family and by what its laws read. Otherwise a family with many laws would take all
    # places of the next steps, and viscous friction, which the damping of a rig imitates, the place
    # of dry friction.
    kinds = {a.label: (search.family(a), a.members[0].effect.signals) for a in candidates}
    leaders = advancing(kinds, list(screened.values()), reference)
    advanced = run(_AdvanceWork(evidence, reference), leaders, progress)
    screened |= {s.label: s for s in advanced if not isinstance(s, Failed)}
    # from here on only the gain reached counts, not the predicted gain
    final = [replace(s, rival=None) for s in screened.values()]
    return final, promising(kinds, final, reference)


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
            failed.append((s.label, c.why))
        elif not c.finite:
            failed.append((s.label, "became unstable on held-out recordings"))
        else:
            models.append(c)
    return models, failed


def lower_baseline(
    search: Search, comparison: Comparison, ranking: list[CandidateModel]
) -> GreyBox | None:
    """The baseline fitted from where the best model ended; None where that predicts little better.

    ranking: models of a single effect, best first. An effect that is not in the machine can lead
    out of a local minimum or along a flat valley, and would be named for what its refit found in
    the other parameters. The model without it then predicts as well.
    """
    baseline = search.budget.baseline
    if not ranking or not comparison.is_material(ranking[0], baseline):
        return None
    control = search.pool.one(_BaselineRestart(search.evidence, search.budget.model), ranking[0])
    without = comparison.removed(control).share if control.finite else 0.0
    if not without >= TRAPPED * comparison.removed(ranking[0]).share:
        return None
    return restarted(search.budget.model, control.fit, search.seed)


@dataclass(frozen=True, eq=False)
class _BaselineRestart(Work[CandidateModel, CandidateModel]):
    """Job that fits the baseline from where another model ended."""

    what = "fitting the baseline from the values of"
    evidence: DataSplit
    model: GreyBox

    def __call__(self, item: CandidateModel) -> CandidateModel:
        assembly, fitted = self.model.assembly, self.model.fit
        p = transferred(assembly, (item.assembly, item.fit.p))
        start = replace(fitted.end, p=p, starts=item.fit.starts, continuity=())
        return replayed(self.evidence, assembly, fit(fitted.problem, start))


def opposite_signs(
    search: Search, models: list[CandidateModel]
) -> list[tuple[CandidateModel, float]]:
    """Return models that remove much of the error only with the opposite sign, best first.

    With the declared sign their effect was fitted to zero, so the sign of their port is doubtful.
    The second entry is the share of the error that they remove.
    """
    mirrored_models = [(c, ranges) for c in models if (ranges := mirrored(c))]
    # each costs a refit
    mirrored_models = mirrored_models[:MIRRORED_MOST]
    starts = [
        RefitStart(
            c.attached,
            ranges=ranges,
            first={key: 0.5 * low for key, (low, _) in ranges.items()},
            assembly=None,
        )
        for c, ranges in mirrored_models
    ]
    work = RefitWork(search.evidence, search.budget.baseline.fit, search.budget.sizes)
    shares = [
        (c, search.budget.shrinkage(c.absolutes))
        for c in search.pool.run(work, starts, search.progress)
        if not isinstance(c, Failed) and c.finite
    ]
    return sorted(((c, v) for c, v in shares if v > MIRRORED_SHARE), key=lambda e: -e[1])


def _start(s: ScreenedCandidate, base: CandidateModel) -> RefitStart:
    """Start of a screened candidate's refit: the base model's fit if it has effects, else the data
    sheet, because a base without the effect may be bent by its absence. A stepped rig always starts
    from the base fit."""
    assert s.assembly is not None
    continues = base.attached or s.assembly.program.keeps_slopes
    p = transferred(s.assembly, (base.assembly, base.fit.p)) if continues else None
    return RefitStart(s.assembly.attachments, p, s.first, assembly=s.assembly)


def with_finer_steps(search: Search, best: CandidateModel) -> CandidateModel:
    """Return the model with integration steps so fine that halving them changes nothing, refitted
    with these."""
    return search.pool.one(_StepRefinement(search.evidence), best)


@dataclass(frozen=True, eq=False)
class _StepRefinement(Work[CandidateModel, CandidateModel]):
    """Job that refines the integration steps of a model if necessary."""

    what = "refining the integration steps of"
    evidence: DataSplit

    def __call__(self, item: CandidateModel) -> CandidateModel:
        best = item
        for _ in range(STEP_HALVINGS):
            tracks = self.evidence.tracks(best.assembly, held_out=True)
            noise = self.evidence.noise
            # Each halving costs a refit, so only the model to be named is refined.
            change = rechecked(best.assembly, best.fit, tracks, noise)[1]
            if change <= COARSE or not settles(best.assembly, best.fit, tracks, noise, change):
                break
            refined = fit(
                best.fit.problem,
                replace(best.fit.end, stepping=best.fit.stepping.doubled()),
                iterations=REFIT_ITERATIONS,
                tolerance=REFIT_TOLERANCE,
            )
            # with finer steps a delay of a held input becomes a staircase, which may fit worse
            if refined.cost > best.fit.cost:
                break
            best = replayed(self.evidence, best.assembly, refined)
        return best
