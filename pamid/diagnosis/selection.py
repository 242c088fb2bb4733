"""Effects added step by step, each step a comparison on the held-out windows.

A step refits candidates on top of the model reached so far, pairs among them, and compares all of
them with it. The best material model becomes the reference of the next step, until nothing material
is added. A member whose removal costs nothing material is removed again. At the end each effect
is replaced by each effect that tied with it, with all other effects in the model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.parallel.jobs import Failed
from pamid.diagnosis.candidate_model import CandidateModel, transferred
from pamid.diagnosis.comparison import Comparison, families_of
from pamid.diagnosis.effect_subsets import ScreenedResponses, Subset, best_subsets, responses_of
from pamid.diagnosis.guards import Guards
from pamid.diagnosis.ranges import amount_z, vanished, with_ranges_of
from pamid.diagnosis.screening import by_gain
from pamid.diagnosis.search import (
    RefitStart,
    RefitWork,
    Round,
    Search,
    refit_screened,
    run_round,
    with_finer_steps,
)
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.grey_box import model_with
from pamid.estimation.port_evidence import PortEvidence, locate
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, Attachment


@dataclass(frozen=True, eq=False)
class SelectionStep:
    """A comparison.

    reference: the model that the candidates extend; candidates: the material ones without
    objections, the lowest held-out loss first; tied: the confidence set, the best first; reduced:
    for each tied model, the same model without the ports at which its effect is not needed.
    """

    reference: CandidateModel
    candidates: tuple[CandidateModel, ...]
    tied: tuple[CandidateModel, ...]
    reduced: Mapping[CandidateModel, CandidateModel] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Selection:
    """The model with every effect that was added.

    without: by effect, the model without it; an effect at several ports also has an entry under its
    common label. instead: by effect, tied models with another effect in its place. after: latent
    evidence at the ports, with the effects modelled if a material part of the gap remains,
    otherwise without them.
    """

    best: CandidateModel
    steps: tuple[SelectionStep, ...]
    after: PortEvidence
    without: dict[str, CandidateModel] = field(default_factory=dict)
    instead: dict[str, tuple[CandidateModel, ...]] = field(default_factory=dict)


def select_effects(
    search: Search,
    comparison: Comparison,
    guards: Guards,
    located: PortEvidence,
    first: Round,
) -> Selection:
    """Add effects to the baseline for as long as they remove a material share of the remainder.

    located: latent evidence at the ports without effects; first: the screened and refitted
    candidates on top of the baseline.
    """
    settings, best = search.settings, search.budget.baseline
    reduce = partial(with_needed_ports, search, comparison)
    steps = [compared(comparison, guards, best, first.models, reduce)]
    after = located
    responses: ScreenedResponses | None = None
    while True:
        if steps[-1].tied:
            # Only at their final steps do small shares show which ports need the effect.
            extended = reduce(with_finer_steps(search, steps[-1].tied[0]))
            # Greedy selection may have begun with an effect that two later ones replace. Backward
            # elimination corrects this.
            shorter = _needed_effects(search, comparison, extended)
            # It may be better with the same number of effects. An effect was replaced, or its gain
            # led out of a local minimum.
            if not comparison.is_material(shorter, best):
                break
            best = shorter
        rest = 1.0 - comparison.removed(best).share
        # Further effects could only fit noise, or an error that nobody would act on.
        if rest < settings.material_rest or comparison.at_floor(best):
            break
        if best.attached:
            leaders = [ports[0] for ports in located.classes]
            alike = search.settings.port_alike
            after = locate(search.evidence, best, search.pool, leaders, alike=alike)
        if len(best.additions) >= settings.effects_most:
            break
        # The linearisation needs simulations of every candidate. Later steps reuse its columns.
        if responses is None:
            responses = responses_of(search.evidence, first.reference, first.screened, search.pool)
        search.progress(f"looking for a further effect next to {best.label}")
        larger = _larger(search, best, first.models, located, after, responses)
        steps.append(compared(comparison, guards, best, larger, reduce))
        if not steps[-1].tied:
            break
    chosen = Selection(best, tuple(steps), after)
    return _with_rivals(search, comparison, guards, located, chosen)


def with_plainer_effects(search: Search, comparison: Comparison, first: Round) -> Round:
    """Refit also the effects with no more parameters than the leader of their family.

    Of each family, the simplest tied model is named. Among equally simple models, the best is
    named. Screening prefers effects with more parameters, and its few steps do not rank the others.
    """
    base = search.budget.baseline
    refitted = {c.label for c in first.models}
    fewest: dict[str, int] = {}
    for c in comparison.confidence_set(first.models, base):
        fewest[c.family] = _size(c.assembly)
    plainer = [
        s
        for s in first.screened
        if s.label not in refitted
        and s.gain > 0.0
        and _size(s.ended[0]) <= fewest.get(search.family(s.added), 0)
    ]
    if not plainer:
        return first
    models, failed = refit_screened(search, base, plainer)
    return replace(first, models=[*first.models, *models], failed=[*first.failed, *failed])


def _size(assembly: Assembly) -> int:
    """Number of fitted parameters."""
    return sum(b.fitted for b in assembly.parameters)


def compared(
    comparison: Comparison,
    guards: Guards,
    reference: CandidateModel,
    models: Sequence[CandidateModel],
    reduce: Callable[[CandidateModel], CandidateModel] = lambda model: model,
) -> SelectionStep:
    """Compare models that extend a reference; models with objections are dropped.

    reduce: removes an effect from ports that do not need it. It costs refits, so only tied models
    are reduced.
    """
    candidates = [
        c
        for c in comparison.ordered(models)
        if comparison.is_material(c, reference) and not guards.objections(c)
    ]
    while True:
        # A leading model that ignores the inputs may keep other models out of the set. The set is
        # formed again without its family.
        tied = comparison.confidence_set(candidates, reference)
        # costs a few runs, so that only those are tried that would be named
        idle = {families_of(c) for c in tied if guards.ignores_inputs(c)}
        if not idle:
            reduced = {c: reduce(c) for c in tied}
            return SelectionStep(
                reference,
                tuple(reduced.get(c, c) for c in candidates),
                tuple(reduced.values()),
                reduced,
            )
        candidates = [c for c in candidates if families_of(c) not in idle]


def _larger(
    search: Search,
    best: CandidateModel,
    singles: Sequence[CandidateModel],
    located: PortEvidence,
    after: PortEvidence,
    responses: ScreenedResponses,
) -> list[CandidateModel]:
    """Refit models with one more effect than `best`: `best` plus an effect at a port with remaining
    evidence, and the best subsets of that size."""
    size = len(best.additions) + 1
    models: list[CandidateModel] = []
    # A second effect is sought only where evidence remains. Without a first effect, the first
    # round has already searched.
    if best.attached:
        least = search.settings.port_reach * after.most
        open_ports = {p for k in located.classes for p in k if after.gains[k[0]] >= least}
        others = []
        for added in search.candidates:
            # Two joints may both have dry friction; two laws of it at the same joint are a single
            # cause.
            left = tuple(
                a
                for a in added.members
                if not any(
                    search.family(b) == search.family(a) and _alike(a, located) & set(b.ports)
                    for b in best.attached
                )
            )
            if left and open_ports & set(added.ports):
                others.append(Addition(left))
        # the lines of the gap's spectrum, and over the position, are those of the present remainder
        hints = gather_hints(search.evidence, best)
        models = run_round(replace(search, hints=hints), best, others).models
    known = {frozenset(a.label for a in c.attached) for c in models}
    subsets = best_subsets(
        responses,
        search.family,
        max(size, 2),
        search.settings,
        lambda a, b: not set(a.ports) & _alike(b, located),
    )
    starts = [_joint_start(search, s, best, singles) for s in subsets if s.labels not in known]
    work = RefitWork(search.evidence, search.budget.baseline.fit, search.budget.sizes)
    refitted = search.pool.run(work, [s for s in starts if s is not None], search.progress)
    return [*models, *(c for c in refitted if not isinstance(c, Failed) and c.finite)]


def _alike(a: Addition | Attachment, located: PortEvidence) -> set[str]:
    """The ports where it acts, and those that the recordings cannot tell from these."""
    classes = [k for k in located.classes if set(a.ports) & set(k)]
    return {*a.ports, *(port for k in classes for port in k)}


def _joint_start(
    search: Search, subset: Subset, best: CandidateModel, singles: Sequence[CandidateModel]
) -> RefitStart | None:
    """Start for the joint refit of a subset; None for effects that cannot act together.

    Each member starts from its fit alone. Common parameters start from the strongest
    member. Members of `best` come first, in its order.
    """
    alone = {c.label: (c.assembly, c.fit.p) for c in singles}
    before = [a.label for a in best.attached]
    strongest = by_gain(subset.members)
    attached = tuple(
        sorted(
            (a for s in strongest for a in s.added.members),
            key=lambda a: before.index(a.label) if a.label in before else len(before),
        )
    )
    try:
        assembly = model_with(search.evidence, attached, search.budget.sizes)
    # Two effects may each replace the same law. Such a pair is no model, and not an error either.
    except PamidError:
        return None
    sources = [alone.get(s.label, s.ended) for s in strongest[::-1]]
    return _start_from(attached, assembly, sources)


def _start_from(
    attached: tuple[Attachment, ...], assembly: Assembly, sources: Sequence[tuple[Assembly, Array]]
) -> RefitStart:
    """A model refitted from the parameters of others, in ranges as wide as theirs."""
    wide = with_ranges_of(assembly, *(other for other, _ in sources))
    return RefitStart(
        attached, transferred(wide, *sources), ranges=dict(wide.ranges), assembly=assembly
    )


def refitted_with(
    search: Search, attached: tuple[Attachment, ...], *sources: CandidateModel
) -> CandidateModel:
    """Refit a model with these effects from the parameters of `sources`.

    The last source has priority and gives the window starts.
    """
    base = search.budget.baseline
    if not attached:
        return base
    assembly = model_with(search.evidence, attached, search.budget.sizes)
    # weights as of every candidate's refit
    after = replace(sources[-1].fit, weights=base.fit.weights, continuity=base.fit.continuity)
    work = RefitWork(search.evidence, after, search.budget.sizes)
    start = _start_from(attached, assembly, [(c.assembly, c.fit.p) for c in sources])
    return search.pool.one(work, start)


def _needed_effects(search: Search, comparison: Comparison, best: CandidateModel) -> CandidateModel:
    """Remove every effect whose removal is not material.

    The newest effect is tested as well: it may only have led the smaller model out of a local
    minimum.
    """
    for added in best.additions if len(best.additions) > 1 else ():
        smaller = refitted_with(search, _less(best, added), best)
        if smaller.finite and not comparison.is_material(best, smaller):
            return _needed_effects(search, comparison, smaller)
    return best


def _less(model: CandidateModel, added: Addition) -> tuple[Attachment, ...]:
    """The model's effects without these."""
    return tuple(a for a in model.attached if a not in added.members)


def with_needed_ports(
    search: Search, comparison: Comparison, whole: CandidateModel
) -> CandidateModel:
    """The model without the ports at which an effect is not needed: the reduced model fits as well
    as the whole.

    The weakest is tried first, until an effect is needed. All are compared with the whole, because
    many small losses add up.
    """
    best = whole
    while shared := [added.members for added in best.additions if len(added.members) > 1]:
        # attachments whose amount vanished, otherwise the least significant; one per effect stays
        gone = [
            a
            for members in shared
            for a in sorted(members, key=lambda a: amount_z(best, a.label))[:-1]
            if vanished(best, a.label)
        ]
        rest = [a for members in shared for a in members]
        weakest = gone or sorted(rest, key=lambda a: amount_z(best, a.label))[:1]
        left = tuple(a for a in best.attached if a not in weakest)
        smaller = refitted_with(search, left, best)
        if not smaller.finite or not comparison.is_tied(smaller, whole):
            break
        best = smaller
    return best


def _with_rivals(
    search: Search,
    comparison: Comparison,
    guards: Guards,
    located: PortEvidence,
    selection: Selection,
) -> Selection:
    """The selection with the alternatives to every effect: the model without it, and models that do
    as well with another effect in its place or with the same effect at a port that the recordings
    do not separate."""
    best, steps = selection.best, selection.steps
    without: dict[str, CandidateModel] = {}
    instead: dict[str, tuple[CandidateModel, ...]] = {}
    families = set(map(search.family, best.attached))
    for added in best.additions:
        others = _less(best, added)
        for part in (added, *(Addition((a,)) for a in added.members)):
            if part.label not in without:
                below = refitted_with(search, _less(best, part), best)
                without[part.label] = below if below.finite else search.budget.baseline
        rivals = {
            k.label: (k, c)
            for step in steps
            for c in step.tied
            for k in c.additions
            if search.family(k) not in families
            and any(search.family(added) in families_of(m) for m in step.tied)
        }
        models = [
            c
            if {m.label for m in c.attached} == {m.label for m in (*others, *k.members)}
            else refitted_with(search, (*others, *k.members), best, c)
            for k, c in rivals.values()
        ]
        models += [
            refitted_with(search, (*others, a), best) for a in _moved(search, added, located)
        ]
        tied = tuple(
            c
            for c in comparison.ordered([c for c in models if c.finite])
            if comparison.is_tied(c, best) and not guards.objections(c)
        )
        instead |= dict.fromkeys(added.labels, tied)
    return replace(selection, without=without, instead=instead)


def _moved(search: Search, added: Addition, located: PortEvidence) -> list[Attachment]:
    """The same effect at other ports of the kind that the recordings do not separate from its
    place."""
    if len(added.members) > 1:
        return []
    alike = _alike(added, located)
    return [
        a
        for candidate in search.candidates
        if added.label in candidate.labels
        for a in candidate.members
        if a.label != added.label and set(a.ports) <= alike
    ]
