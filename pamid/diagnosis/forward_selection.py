"""Several effects: proposed from two sides, decided by one rule, with a backward check.

Beside the model M_(k-1) found so far two kinds of models with k effects are refitted, all their
parameters jointly: M_(k-1) with the effects that a screening on top of it puts first where its
ports still have latent evidence (forward selection), and the best subsets of k effects among all
that were screened on top of the baseline (`effect_subsets`), with or without those of M_(k-1):
chosen alone, the first had to account for what the second explains, too. Either way two effects are
of one family only at places that the recordings tell apart. Of all of them the one with the lowest
bootstrapped held-out log loss is taken, or none (`_weighed`). Then an earlier effect whose removal
costs less than the share `worth` of the gap, and not most of what the others leave, is dropped, the
first is replaced by one of its rivals where the pair fits better, and what ended at the limit of
its form by a plainer effect of its family.

Efroymson (1960), Multiple regression analysis, in Mathematical Methods for Digital Computers;
Miller (2002), Subset Selection in Regression, sections 3.2 to 3.5 (forward, backward, replacement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.base.metrics import relative
from pamid.diagnosis.candidate_model import CandidateModel, in_errors, transferred
from pamid.diagnosis.effect_subsets import (
    ScreenedResponses,
    Subset,
    best_subsets,
    responses_of,
)
from pamid.diagnosis.judgement import calibration, decades, signed_decades, within
from pamid.diagnosis.port_evidence import PortEvidence, locate
from pamid.diagnosis.ranges import as_wide, is_plain_inside
from pamid.diagnosis.screening import by_gain
from pamid.diagnosis.search import (
    RefitStart,
    Refitting,
    Round,
    Search,
    by_held_out_loss,
    most_evident,
    run_round,
    with_finer_steps,
)
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.grey_box import model_with
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.parallel.jobs import Failed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ForwardStep:
    """The effect tried beside those already found, all on the held-out windows.

    removed, of_left: what it removes, in shares of the gap and of what the others leave; gain: log
    squared error per channel, sure: in standard errors; margin: standard errors by which it beats
    the next of another family; evidence: gained on the fitted data, nats; at_port: latent evidence
    at its port over the largest one; unexplained: that one, nats per sample; probability of being
    real; taken: is it added to the model? tried: families of every combination that was refitted,
    the best first; closed: families not tried on top of those found, since little is missing where
    they act.
    """

    effect: str
    family: str
    removed: float
    of_left: float
    gain: float
    sure: float
    margin: float
    at_port: float
    unexplained: float
    evidence: float = 0.0
    probability: float = 0.0
    taken: bool = False
    tried: tuple[tuple[str, ...], ...] = ()
    closed: tuple[str, ...] = ()

    def features(self) -> dict[str, float]:
        """As the logistic function takes them."""
        return {
            "removed": decades(self.removed, 1e-3, 1.0),
            "of_left": within(self.of_left, -0.2, 1.0),
            "gain": within(self.gain, -0.2, 2.0),
            "sure": within(self.sure, 0.0, 20.0) / 10.0,
            "margin": within(self.margin, 0.0, 10.0) / 10.0,
            "evidence": signed_decades(self.evidence),
            "at_port": self.at_port,
            "unexplained": decades(self.unexplained, 1e-2, 1e2),
        }


@dataclass(frozen=True, eq=False)
class ForwardSelection:
    """The model with every effect that was added; after: the latent evidence that is left at the
    ports; begun: the model of one effect from which the selection went on; forward_steps: the
    effects that were tried beside the first, in order; tried: every model of several effects that
    was refitted on the way."""

    best: CandidateModel
    after: PortEvidence
    begun: CandidateModel | None = None
    forward_steps: tuple[ForwardStep, ...] = ()
    tried: tuple[CandidateModel, ...] = ()


def select_forward(
    search: Search, ranking: tuple[CandidateModel, ...], located: PortEvidence, first: Round
) -> ForwardSelection:
    """The first of the ranking and the effects that are found beside it; first: the round that the
    ranking is from."""
    chosen = search.settings
    best, steps = with_finer_steps(search, ranking[0]), list[ForwardStep]()
    tried = list[CandidateModel]()
    responses: ScreenedResponses | None = None
    exchanged = False  # was an effect that had been added dropped for another?
    while True:
        search.progress(f"looking where something is missing beside {best.label}")
        leaders = [k[0] for k in located.classes]
        after = locate(search.evidence, best, search.pool, leaders, settings=chosen)
        # too little to look into: a share of what was missing at first, within fixed bounds
        little = max(
            min(chosen.further_share * located.most, chosen.further_always * best.samples),
            chosen.further_never * best.samples,
        )
        if exchanged or len(best.attached) == chosen.effects_most or after.most < little:
            break
        if responses is None:
            responses = responses_of(search.evidence, first.reference, first.screened, search.pool)
        larger, closed = _larger(search, ranking, best, located, after, responses)
        if not larger:
            break
        tried += larger
        steps.append(_weighed(search, best, larger, located, after, closed))
        if not steps[-1].taken:
            break
        known = {_labels(c) for c in larger}
        before = len(best.attached)
        best = _best_first(search, ranking, _backward_check(search, larger[0]), known)
        best = _plainer_members(search, ranking, best)
        best = with_finer_steps(search, best)
        # one effect for another is the end: where any of them will do, exchanges go on and on
        exchanged = len(best.attached) <= before
    return ForwardSelection(best, after, ranking[0], tuple(steps), tuple(tried))


def _labels(c: CandidateModel) -> frozenset[str]:
    return frozenset(a.label for a in c.attached)


def _places(search: Search, c: CandidateModel) -> set[tuple[str, str]]:
    """Family and port (group) of every effect."""
    return {(search.family(a), a.group(search.evidence.rig)) for a in c.attached}


def _families(search: Search, c: CandidateModel) -> tuple[str, ...]:
    return tuple(search.family(a) for a in c.attached)


def _larger(
    search: Search,
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel,
    located: PortEvidence,
    after: PortEvidence,
    responses: ScreenedResponses,
) -> tuple[list[CandidateModel], tuple[str, ...]]:
    """Refitted models with one effect more than `best`, the lowest held-out loss first, before it
    one that what was fitted prefers where that is not sure; families that were not tried on top of
    it because little is missing where they act."""
    least = search.settings.further_ports * after.most
    open_ports = {port for k in located.classes for port in k if after.gains[k[0]] > least}
    others = [a for a in search.candidates if not _is_taken(search, a, best, located)]
    # nothing is put on top of what does not help by itself: there is no first effect
    helps = search.budget.shrinkage(best.absolutes, search.asked) > search.settings.worth
    beside = [a for a in others if helps and open_ports & set(a.ports)]
    models = list[CandidateModel]()
    if beside:
        # the lines of the gap's spectrum, and over the position, are those of what is left by now
        hints = gather_hints(search.evidence, best, search.settings)
        models = run_round(replace(search, hints=hints), best, beside).models
    known = {_labels(c) for c in models}
    subsets = best_subsets(
        responses,
        search.family,
        len(best.attached) + 1,
        search.settings,
        lambda a, b: not set(a.ports) & _alike(b, located),
    )
    work = Refitting(
        search.evidence, search.budget.baseline.fit, search.budget.sizes, search.settings
    )
    starts = [_joint_start(search, s, best, ranking) for s in subsets if s.labels not in known]
    refitted = search.pool.run(work, [s for s in starts if s is not None], search.progress)
    models = [*models, *(c for c in refitted if not isinstance(c, Failed) and c.finite)]
    closed = {search.family(a) for a in others} - {search.family(a) for a in beside}
    ordered = by_held_out_loss(search, models)
    first = [most_evident(search, ordered)] if ordered else []
    return [*first, *(c for c in ordered if c not in first)], tuple(sorted(closed))


def _is_taken(search: Search, a: Attachment, best: CandidateModel, located: PortEvidence) -> bool:
    """Does an effect of its family act where the recordings cannot tell its place from this one's?
    Two joints may both have dry friction; two laws of it at one joint are one cause."""
    places, family = _alike(a, located), search.family(a)
    return any(search.family(b) == family and places & set(b.ports) for b in best.attached)


def _alike(a: Attachment, located: PortEvidence) -> set[str]:
    """The ports where it acts, and those that the recordings cannot tell from these."""
    here = [k for k in located.classes if set(a.ports) & set(k)]
    return {*a.ports, *(port for k in here for port in k)}


def _joint_start(
    search: Search, subset: Subset, best: CandidateModel, ranking: tuple[CandidateModel, ...]
) -> RefitStart | None:
    """A subset's model, refitted from what each member has found alone, the strongest last: it
    knows the rig's own parameters best. Members that are in `best` come first, as there; None of
    effects that cannot act together."""
    alone = {c.label: (c.assembly, c.fit.p) for c in ranking}
    before = [a.label for a in best.attached]
    strongest = by_gain(subset.members)
    members = sorted(
        strongest,
        key=lambda s: (
            before.index(s.attachment.label) if s.attachment.label in before else len(before)
        ),
    )
    attached = tuple(s.attachment for s in members)
    try:
        assembly = model_with(search.evidence, attached, search.budget.sizes)
    except PamidError:
        return None
    found = [alone.get(s.attachment.label, s.ended) for s in strongest[::-1]]
    return _from_found(attached, assembly, found)


def _from_found(
    attached: tuple[Attachment, ...], assembly: Assembly, found: Sequence[tuple[Assembly, Array]]
) -> RefitStart:
    """A model refitted from what others have found, in ranges as wide as theirs."""
    wide = as_wide(assembly, *(other for other, _ in found))
    return RefitStart(
        attached, transferred(wide, *found), ranges=dict(wide.ranges), assembly=assembly
    )


def _weighed(
    search: Search,
    best: CandidateModel,
    larger: list[CandidateModel],
    located: PortEvidence,
    after: PortEvidence,
    closed: tuple[str, ...],
) -> ForwardStep:
    """The first of the larger models against `best`: is it taken? What is as good as certain on
    held-out windows and removes a material share needs no line's consent. Where another family
    would do as well beside the same effects, what is added keeps no name of its own (its lead is
    asked for when it is judged); but what stands beside it is seen only with something there."""
    newest, chosen = larger[0], search.settings
    places = _places(search, newest)
    other = next((c for c in larger if _places(search, c) != places), best)
    losses = search.losses([best, newest, other])
    gain, margin = losses[0] - losses[1], losses[2] - losses[1]
    gap, left = search.excess(search.budget.baseline), search.excess(best)
    removed = left - search.excess(newest)
    ports = set(newest.attached[-1].ports)
    here = max(after.gains[k[0]] for k in located.classes if ports & set(k))
    found = ForwardStep(
        newest.attached[-1].label,
        newest.family,
        relative(removed, gap),
        relative(removed, left),
        float(gain.mean()) / newest.squares.shape[1],
        in_errors(gain),
        in_errors(margin),
        here / after.most if after.most > 0.0 else 1.0,
        after.most / best.samples,
        search.nats(newest) - search.nats(best),
        tried=tuple(dict.fromkeys(_families(search, c) for c in larger)),
        closed=closed,
    )
    line = calibration().lines["further"]
    probability = line.probability(found.features())
    plain = found.sure >= chosen.further_sure
    backed = probability >= line.yes or plain
    material = found.removed >= chosen.further_least or found.of_left >= chosen.further_of_left
    taken = backed and material
    return replace(found, probability=probability, taken=taken)


def _backward_check(search: Search, best: CandidateModel) -> CandidateModel:
    """The model less the first effect whose removal costs less than `worth` of the gap; the model
    itself where every one is needed. The newest is asked, too: where the model below it had ended
    in a local minimum, what it gained may have been the way out alone. What surely removes a good
    part of what the others leave is needed however small that is: beside a spring at the shoulder
    that explains nearly all, the one at the elbow explains the rest."""
    settings = search.settings
    gap = search.excess(search.budget.baseline)
    for a in best.attached:
        smaller = refitted_with(search, tuple(k for k in best.attached if k is not a), best)
        left = search.excess(best)
        lost = search.excess(smaller) - left
        if not smaller.finite or lost >= settings.worth * gap:
            continue
        if (
            lost < settings.further_of_left * (lost + left)
            or _surely(search, smaller, best) < settings.simpler_errors
        ):
            return smaller
    return best


def _surely(search: Search, worse: CandidateModel, better: CandidateModel) -> float:
    """By how many standard errors of the held-out log loss one model is better."""
    losses = search.losses([worse, better])
    return in_errors(losses[0] - losses[1])


def _best_first(
    search: Search,
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel,
    known: set[frozenset[str]],
) -> CandidateModel:
    """The first effect chosen again, among itself and its rivals, beside those added since; known:
    combinations that were worse already."""
    if len(best.attached) < 2 or best.attached[0] is not ranking[0].attached[-1]:
        return best
    taken = {search.family(a) for a in best.attached[1:]}
    rivals = [c for c in ranking[1:] if c.family not in taken][: search.settings.rivals]
    others = [(r, (*r.attached, *best.attached[1:])) for r in rivals]
    options = [
        best,
        *(
            refitted_with(search, attached, r, best)
            for r, attached in others
            if frozenset(a.label for a in attached) not in known
        ),
    ]
    stable = [c for c in options if c.finite]
    return stable[int(np.argmin(search.losses(stable).mean(axis=1)))]


def _plainer_members(
    search: Search, ranking: tuple[CandidateModel, ...], best: CandidateModel
) -> CandidateModel:
    """The model, an effect of it that ended at the limit of its form given up for a plainer one of
    its family at the same port that did not, where that costs less than `worth` of the gap: play of
    no width in front of a spring is a spring."""
    if len(best.attached) < 2:
        return best
    s = search.settings
    worth = s.worth * search.excess(search.budget.baseline)
    for a in best.attached:
        if is_plain_inside(best, s, a.label):
            continue
        plainer = (
            c
            for c in ranking
            if c.family == search.family(a)
            and set(c.attached[-1].ports) == set(a.ports)
            and c.attached[-1].label != a.label
            and is_plain_inside(c, s)
        )
        for c in islice(plainer, s.rivals):
            own = c.attached[-1]
            swapped = tuple(own if k is a else k for k in best.attached)
            found = refitted_with(search, swapped, c, best)
            lost = search.excess(found) - search.excess(best)
            if found.finite and lost < worth and is_plain_inside(found, s, own.label):
                best = found
                break
    return best


def refitted_with(
    search: Search, attached: tuple[Attachment, ...], *found: CandidateModel
) -> CandidateModel:
    """A model with these effects, refitted from what these others have found, the last of them
    first."""
    assembly = model_with(search.evidence, attached, search.budget.sizes)
    work = Refitting(
        search.evidence, search.budget.baseline.fit, search.budget.sizes, search.settings
    )
    start = _from_found(attached, assembly, [(c.assembly, c.fit.p) for c in found])
    return search.pool.one(work, start)
