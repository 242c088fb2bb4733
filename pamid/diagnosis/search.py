"""One round of the search: screen all candidates on top of a model, refit the promising ones, order
them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import (
    CandidateModel,
    bootstrap_losses,
    known_along,
    log_evidence,
    refit,
    replayed,
    transferred,
)
from pamid.diagnosis.own_terms import own_terms
from pamid.diagnosis.ranges import is_plain_inside, mirrored, vanished, widened
from pamid.diagnosis.screening import Screened, ScreeningBaseline, promising, screen
from pamid.diagnosis.serialise import candidate_plain, candidate_restored
from pamid.diagnosis.settings import Settings
from pamid.diagnosis.starting_hints import GapHints
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.grey_box import COARSE, model_with, rechecked, settles
from pamid.estimation.lagged_linear import LaggedResponse
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Range, Sizes
from pamid.parallel.jobs import Failed, ObjectWork, WorkerPool
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """What every step of a diagnosis needs. asked: held-out windows by whose losses models are
    compared, all of them but where one half is asked by itself; half: one of the two halves."""

    evidence: DataSplit
    budget: Budget
    asked: NDArray[np.bool_]
    half: NDArray[np.bool_]
    candidates: list[Attachment]
    hints: GapHints
    seed: int
    pool: WorkerPool
    progress: Progress
    response: LaggedResponse | None = None  # of outputs to inputs

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    def family(self, a: Attachment) -> str:
        return a.family(self.evidence.rig)

    def excess(self, c: CandidateModel) -> float:
        return self.budget.excess(c.absolutes, self.asked)

    def nats(self, c: CandidateModel) -> float:
        """Log evidence of what was fitted, as many residuals independent as the baseline leaves; to
        be compared among the models of this search."""
        correlated = self.budget.baseline.fit.weights.correlated
        return log_evidence(c.fit, correlated, self.evidence.noise)

    def losses(self, models: list[CandidateModel]) -> Array:
        return bootstrap_losses(models, self.asked, self.seed, self.settings)


@dataclass(frozen=True, eq=False)
class _Screening(ObjectWork[Attachment, Screened]):
    """A candidate on top of a model."""

    what = "screening"
    evidence: DataSplit
    reference: ScreeningBaseline
    sizes: Sizes
    hints: GapHints

    def result(self, item: Attachment) -> Screened:
        return screen(self.evidence, self.reference, item, self.sizes, self.hints)

    def plain_form(self, item: Attachment, found: Screened) -> Plain:
        return {
            "first": found.first,
            "gain": found.gain,
            "why": found.why,
            "fits": found.assembly is not None,
            "p": found.p,
            "starts": found.starts,
            "stepping": found.stepping and [found.stepping.substeps, found.stepping.implicit],
        }

    def restored(self, item: Attachment, found: Plain) -> Screened:
        fits, made = found["fits"], self.reference.model_beside
        return Screened(
            item,
            made(self.evidence, item, self.sizes) if fits else None,
            found["first"],
            found["gain"],
            found["why"],
            found["p"],
            tuple(found["starts"]),
            found["stepping"] and Stepping(*found["stepping"]),
        )

    def name(self, item: Attachment) -> str:
        return item.label


@dataclass(frozen=True, eq=False)
class RefitStart:
    """A model to refit. p: where from (SI; default: the data sheet); first: further starting values
    (SI) by key; ranges: of parameters, in place of their own (SI, by key); assembly: the model put
    together, where it has been already."""

    attached: tuple[Attachment, ...]
    p: Array | None = None
    first: dict[str, float] = field(default_factory=dict)
    ranges: dict[str, Range] = field(default_factory=dict)
    assembly: Assembly | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class Refitting(ObjectWork[RefitStart, CandidateModel]):
    """A model refitted after a fit of another one, and replayed on what was held out."""

    what = "refitting"
    evidence: DataSplit
    after: Fit
    sizes: Sizes
    settings: Settings

    @cached_property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        return known_along(self.after)

    def result(self, item: RefitStart) -> CandidateModel:
        assembly, known = self._assembly(item), self.known
        done = refit(
            self.evidence,
            assembly,
            self.after,
            p=item.p,
            first=item.first,
            known=known,
            settings=self.settings,
        )
        for _ in range(self.settings.widenings):
            wider = widened(assembly, done, self.settings)
            if wider is None:
                break
            assembly = wider
            done = refit(
                self.evidence, assembly, self.after, p=done.p, known=known, settings=self.settings
            )
        return replayed(self.evidence, assembly, done)

    def plain_form(self, item: RefitStart, found: CandidateModel) -> Plain:
        return candidate_plain(found)

    def restored(self, item: RefitStart, found: Plain) -> CandidateModel:
        return candidate_restored(self.evidence, self._assembly(item), found)

    def _assembly(self, item: RefitStart) -> Assembly:
        made = item.assembly or model_with(self.evidence, item.attached, self.sizes)
        return replace(made, ranges={**made.ranges, **item.ranges}) if item.ranges else made

    def name(self, item: RefitStart) -> str:
        return " + ".join(a.label for a in item.attached)


@dataclass(frozen=True, eq=False)
class Round:
    """What a round has found. models: refitted and replayed; failed: candidates that could not be,
    and why; first_family: of the screen's own first choice; reference: what was screened against;
    screened: all candidates that stayed stable in the screening; passed_over: those of them that
    were not refitted."""

    models: list[CandidateModel]
    failed: list[tuple[str, str]]
    first_family: str
    reference: ScreeningBaseline
    screened: list[Screened]
    passed_over: list[Screened]


def run_round(search: Search, base: CandidateModel, candidates: list[Attachment]) -> Round:
    """Screen all candidates on top of `base`, refit the promising ones, replay them on what was
    held out."""
    evidence, sizes, run = search.evidence, search.budget.sizes, search.pool.run
    reference = ScreeningBaseline.of(base, len(search.candidates), search.settings)
    tried = run(_Screening(evidence, reference, sizes, search.hints), candidates, search.progress)
    found = [
        Screened(a, None, {}, -np.inf, s.why) if isinstance(s, Failed) else s
        for a, s in zip(candidates, tried, strict=True)
    ]
    leading = promising({a.label: search.family(a) for a in candidates}, found, reference)
    models, failed = refit_screened(search, base, leading)
    hopeless = [(s.attachment.label, s.why) for s in found if not s.usable]
    taken = {s.attachment.label for s in leading}
    usable = [s for s in found if s.usable]
    return Round(
        models,
        hopeless + failed,
        search.family(leading[0].attachment) if leading else "",
        reference,
        usable,
        [s for s in usable if s.attachment.label not in taken],
    )


def refit_screened(
    search: Search, base: CandidateModel, screened: list[Screened]
) -> tuple[list[CandidateModel], list[tuple[str, str]]]:
    """Refit screened candidates on top of `base` and replay them on what was held out; the models,
    and what failed and why."""
    starts = [_start(s, base) for s in screened]
    work = Refitting(search.evidence, base.fit, search.budget.sizes, search.settings)
    refitted = search.pool.run(work, starts, search.progress)
    models = [c for c in refitted if not isinstance(c, Failed)]
    failed = [
        (s.attached[-1].label, c.why)
        for s, c in zip(starts, refitted, strict=True)
        if isinstance(c, Failed)
    ]
    failed += [
        (c.attached[-1].label, "became unstable on held-out recordings")
        for c in models
        if not c.finite
    ]
    return [c for c in models if c.finite], failed


def opposite_signs(
    search: Search, models: list[CandidateModel]
) -> list[tuple[CandidateModel, float]]:
    """Models whose effect ended at nothing and that remove much of the error with the opposite
    sign, the best first, with the share they remove: the sign of their port is in doubt."""
    tried = [(c, ranges) for c in models if (ranges := mirrored(c))]
    tried = tried[: search.settings.mirrored_most]
    starts = [
        RefitStart(
            c.attached, ranges=ranges, first={key: 0.5 * low for key, (low, _) in ranges.items()}
        )
        for c, ranges in tried
    ]
    work = Refitting(
        search.evidence, search.budget.baseline.fit, search.budget.sizes, search.settings
    )
    found = [
        (c, search.budget.shrinkage(c.absolutes, search.asked))
        for c in search.pool.run(work, starts, search.progress)
        if not isinstance(c, Failed) and c.finite
    ]
    least = search.settings.mirrored_share
    return sorted(((c, v) for c, v in found if v > least), key=lambda e: -e[1])


def _start(s: Screened, base: CandidateModel) -> RefitStart:
    """Where a screened candidate is refitted from: what the model below it has found, or the data
    sheet; of a rig that is stepped always the former, which may have taken more than a fit from
    the data sheet to find."""
    assert s.assembly is not None
    found = base.attached or s.assembly.program.keeps_slopes
    p = transferred(s.assembly, (base.assembly, base.fit.p)) if found else None
    return RefitStart(s.assembly.attachments, p, s.first, assembly=s.assembly)


def ranked(search: Search, models: list[CandidateModel]) -> tuple[CandidateModel, ...]:
    """Contenders by mean bootstrapped log loss; a simpler member of the first one's family goes
    before it where `_simplest` prefers it; one that has become a plainer effect than its name says,
    or a term that the rig has already, stands behind those that have not."""
    ranking = by_held_out_loss(search, models)
    ranking.sort(key=lambda c: bool(c.attached and vanished(c, c.attached[-1].label)))
    behind: list[CandidateModel] = []
    while ranking:
        first = _simplest(search, ranking)
        ranking.remove(first)
        last = first.attached[-1].label if first.attached else ""
        if not last or not own_terms(first, last, search.budget.baseline, search.settings):
            return (first, *ranking, *behind)
        behind.append(first)
    return tuple(behind)


def by_held_out_loss(search: Search, models: list[CandidateModel]) -> list[CandidateModel]:
    """The lowest mean bootstrapped log loss first; among equal ones by name."""
    losses = search.losses(models).mean(axis=1) if models else []
    order = sorted(range(len(models)), key=lambda i: (losses[i], models[i].label))
    return [models[i] for i in order]


def _simplest(search: Search, ranking: list[CandidateModel]) -> CandidateModel:
    """The first, or a simpler member of its family over which its gain is slight or uncertain (the
    one-standard-error rule of Breiman et al. 1984, at three). What is uncertain is decided by the
    fitted data where they speak very strongly for a form: there what more parameters cost has been
    paid. Where a parameter of the first ended at a bound that physics did not set, or at the limit
    of its form, any model counts as simpler whose parameters did not: such an end says that the
    form is another."""
    forced = not is_plain_inside(ranking[0], search.settings)
    best = ranking[0] if forced else most_evident(search, ranking)
    simpler = [
        c
        for c in ranking
        if (c.family == best.family and _complexity(c) < _complexity(best))
        or (forced and c is not best and is_plain_inside(c, search.settings))
    ]
    for c in sorted(simpler, key=_complexity):
        found = _gained(search, best, c)
        if found.slight or (found.unsure and (forced or not _is_evident(search, best, c))):
            return c
    return best


class _Gained(NamedTuple):
    """What the windows asked say of a model beside another: is its gain slight, one standard error
    added? might they as well have preferred the other one? are they alike?"""

    slight: bool
    unsure: bool
    tied: bool


def _gained(search: Search, best: CandidateModel, other: CandidateModel) -> _Gained:
    losses, s = search.losses([best, other]), search.settings
    gain = losses[1] - losses[0]
    lost = search.excess(other) - search.excess(best)
    gap = search.excess(search.budget.baseline)
    worth, most = s.worth * gap, s.simpler_gain * best.squares.shape[1]
    return _Gained(
        bool(gain.mean() + s.tie_errors * gain.std() < most and lost < worth),
        bool(gain.mean() < s.simpler_errors * gain.std() and lost < s.simpler_loss * worth),
        bool(gain.mean() < s.tie_errors * gain.std() and lost < s.tie_share * gap),
    )


def _is_evident(search: Search, one: CandidateModel, other: CandidateModel) -> bool:
    """Do the fitted data speak very strongly for the one?"""
    return search.nats(one) - search.nats(other) > search.settings.simpler_evidence


def most_evident(search: Search, ranking: list[CandidateModel]) -> CandidateModel:
    """The first, or one for which the fitted data speak very strongly: of the same families where
    the windows asked are not sure of the first, of others where both are alike there."""
    best = ranking[0]

    def families(c: CandidateModel) -> list[str]:
        return sorted(map(search.family, c.attached))

    def is_open(c: CandidateModel) -> bool:
        found = _gained(search, best, c)
        return found.unsure if families(c) == families(best) else found.tied

    plain = (
        c
        for c in ranking[1:]
        if is_plain_inside(c, search.settings) and _is_evident(search, c, best) and is_open(c)
    )
    return max(plain, key=search.nats, default=best)


def _complexity(c: CandidateModel) -> int:
    """Fewer parameters first; among equally many the held-out windows decide."""
    return c.free_count


def indistinguishable_from_first(
    search: Search, ranking: tuple[CandidateModel, ...], classes: list[list[str]]
) -> tuple[CandidateModel, ...]:
    """The first and every model that is not significantly worse on the held-out windows: by one
    standard error; where its predictions are like those of the first (`classes`), by three and by
    more than a refit is settled to."""
    if not ranking:
        return ()
    losses, s = search.losses(list(ranking)), search.settings
    same = next((k for k in classes if ranking[0].attached[-1].label in k), [])
    gap, first = search.excess(search.budget.baseline), search.excess(ranking[0])
    out = [ranking[0]]
    for i, c in enumerate(ranking[1:], start=1):
        worse = losses[i] - losses[0]
        least = s.tie_errors * worse.std()
        if c.attached[-1].label in same:
            settled = s.refit_tolerance * c.squares.shape[1]
            least = max(s.simpler_errors * worse.std(), settled)
        unsure = worse.mean() < least
        if unsure and search.excess(c) - first < s.tie_share * gap:
            out.append(c)
    return tuple(out)


def carried_on(search: Search, models: list[CandidateModel]) -> list[CandidateModel]:
    """The models, those whose fit had used up its iterations fitted on from where they ended."""
    open_ended = [c for c in models if not c.fit.converged and c.fit.residuals]
    if not open_ended:
        return models
    work = _CarryingOn(search.evidence, search.settings)
    done = search.pool.run(work, open_ended, search.progress)
    better = {
        id(c): found
        for c, found in zip(open_ended, done, strict=True)
        if not isinstance(found, Failed) and found.finite
    }
    return [better.get(id(c), c) for c in models]


@dataclass(frozen=True, eq=False)
class _CarryingOn(ObjectWork[CandidateModel, CandidateModel]):
    """A fit carried on, and the model replayed."""

    what = "fitting on"
    evidence: DataSplit
    settings: Settings

    def result(self, item: CandidateModel) -> CandidateModel:
        return _fitted_on(
            self.evidence,
            item,
            item.fit.stepping,
            self.settings.carried_on_iterations,
            self.settings,
        )

    def plain_form(self, item: CandidateModel, found: CandidateModel) -> Plain:
        return candidate_plain(found)

    def restored(self, item: CandidateModel, found: Plain) -> CandidateModel:
        return candidate_restored(self.evidence, item.assembly, found)

    def name(self, item: CandidateModel) -> str:
        return item.label


def _fitted_on(
    evidence: DataSplit, c: CandidateModel, stepping: Stepping, iterations: int, settings: Settings
) -> CandidateModel:
    """The model fitted on from where its fit ended, and replayed."""
    f = c.fit
    done = fit(
        f.problem,
        p=f.p,
        starts=f.starts,
        weights=f.weights,
        continuity=f.continuity,
        stepping=stepping,
        iterations=iterations,
        tolerance=settings.refit_tolerance,
    )
    return replayed(evidence, c.assembly, done)


def with_finer_steps(search: Search, best: CandidateModel) -> CandidateModel:
    """The model with integration steps so fine that halving them changes nothing, refitted where
    they were not."""
    return search.pool.one(_StepRefinement(search.evidence, search.settings), best)


@dataclass(frozen=True, eq=False)
class _StepRefinement(ObjectWork[CandidateModel, CandidateModel]):
    """A model with finer steps, where it needs them."""

    what = "refining the integration steps of"
    evidence: DataSplit
    settings: Settings

    def result(self, item: CandidateModel) -> CandidateModel:
        best = item
        for _ in range(self.settings.stepping_rounds):
            tracks = self.evidence.tracks(best.assembly, held_out=True)
            noise = self.evidence.noise
            change = rechecked(best.assembly, best.fit, tracks, noise)[1]
            if change <= COARSE or not settles(best.assembly, best.fit, tracks, noise, change):
                break
            best = _fitted_on(
                self.evidence,
                best,
                best.fit.stepping.doubled(),
                self.settings.refit_iterations,
                self.settings,
            )
        return best

    def plain_form(self, item: CandidateModel, found: CandidateModel) -> Plain:
        return {} if found is item else candidate_plain(found)

    def restored(self, item: CandidateModel, found: Plain) -> CandidateModel:
        return candidate_restored(self.evidence, item.assembly, found) if found else item

    def name(self, item: CandidateModel) -> str:
        return item.label
