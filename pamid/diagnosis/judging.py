"""Refitted models, judged: ranking, further effects, what speaks for every one, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pamid.diagnosis.bends import bend
from pamid.diagnosis.candidate_model import CandidateModel, replayed
from pamid.diagnosis.cross_fitting import Crossed, crossed, reported
from pamid.diagnosis.decision import Decision, Share, Weighed, decide, gap_share
from pamid.diagnosis.forward_selection import (
    ForwardSelection,
    ForwardStep,
    refitted_with,
    select_forward,
)
from pamid.diagnosis.input_response import explained_channels, silent_channels
from pamid.diagnosis.look_alikes import look_alike_classes
from pamid.diagnosis.misfit_beyond_range import scale_doubt
from pamid.diagnosis.own_terms import own_terms
from pamid.diagnosis.port_evidence import PortEvidence, locate
from pamid.diagnosis.ranges import at_bounds, vanished
from pamid.diagnosis.search import Round, Search, indistinguishable_from_first, ranked
from pamid.diagnosis.signature import Signature, alone, cause_probability, signature
from pamid.diagnosis.verdict_grounds import VerdictStatistics, verdict_statistics
from pamid.estimation.restart import escape_local_minimum
from pamid.model.attachment import Attachment
from pamid.model.isolability import isolability
from pamid.simulation.data_split import DataSplit


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of a model: what speaks for it beside the others, how probable it is, what it
    removes of the gap, the families that would do as well in its place, the groups of ports at
    which its own would, by what share of what passes it bends a characteristic, where it does
    nothing else, and the rig's own parameters whose terms do what it does."""

    effect: Attachment
    signature: Signature
    probability: float
    removes: Share
    instead: tuple[str, ...] = ()
    or_at: tuple[str, ...] = ()
    bent: float | None = None
    again: tuple[str, ...] = ()


Tied = tuple[CandidateModel, Member]


@dataclass(frozen=True, eq=False)
class Judged:
    """What is said of models that were refitted. ranking: each with one effect, best first, with
    what speaks for it and its probability; best: the best model, with as many effects as it takes,
    and its members; dropped: effects that were found beside these, and may not be named; after:
    where something is missing beside it; tied: the first of the ranking and the models that these
    recordings cannot tell from it."""

    decision: Decision
    grounds: VerdictStatistics
    ranking: tuple[CandidateModel, ...]
    signatures: tuple[Signature, ...]
    probability: tuple[float, ...]
    best: CandidateModel
    members: tuple[Member, ...]
    dropped: tuple[Member, ...]
    after: PortEvidence
    tied: tuple[Tied, ...]
    halves: Crossed | None  # what either half of the held-out windows would have chosen
    classes: tuple[tuple[str, ...], ...]
    selection: ForwardSelection
    silent: tuple[str, ...]  # channels that do not show this machine
    unused: bool  # the best model does without the inputs: no effect may be named
    units: dict[str, Any] | None  # why units and signs are in doubt

    @property
    def forward_steps(self) -> tuple[ForwardStep, ...]:
        return self.selection.forward_steps

    @property
    def named(self) -> tuple[Member, ...]:
        """Effects of the best model that the verdict names: all of them, unless one of them is
        nothing without another that may not be named."""
        return tuple(m for m in self.members if m.effect.label in self.decision.named)


def judge(
    search: Search,
    located: PortEvidence,
    screened: Round,
    models: list[CandidateModel],
    before: ForwardSelection | None = None,
) -> Judged:
    """Ranking, further effects and verdict. located: where something is missing before any effect;
    screened: the round of single effects; models: those of them that were refitted; before: what
    was selected among fewer of them, which holds where the same model leads."""
    base, settings = search.budget.baseline, search.settings
    ranking = ranked(search, models)
    found = ForwardSelection(base, located)
    if before is not None and ranking and ranking[0] is before.begun:
        found = before
    elif ranking:
        found = select_forward(search, ranking, located, screened)
    best, after = _freed(search.evidence, found.best) if ranking else base, found.after
    ranking = _with_best(ranking, best)
    classes = look_alike_classes(
        search.evidence, base, list(ranking[: settings.compared]), settings
    )
    signatures = alone(search, ranking, located)
    units = scale_doubt(search.evidence, base, best, settings)
    response = search.response
    explained = explained_channels(search.budget, best, response, search.seed)
    silent, unused = (
        silent_channels(search.budget, best, explained, response),
        not explained.any(),
    )
    doubt = "units" if units else "silent" if silent else ""
    groups = isolability(search.evidence.rig, search.evidence.channels).groups
    compared = _Compared(
        ranking,
        signatures,
        classes,
        located,
        found.forward_steps,
        found.tried,
        groups,
        doubt,
        unused,
    )
    weighed = everything = _weighed_up(search, compared, best, after)
    instead = _instead(search, compared, weighed)
    if instead is not None:
        leaders = [k[0] for k in located.classes]
        beside = locate(search.evidence, instead, search.pool, leaders, settings=settings)
        again = _weighed_up(search, compared, instead, beside)
        weighed = again if _stands(weighed, again) else weighed
    kept = {m.effect.label for m in weighed.members}
    together = everything.members if len(everything.members) > 1 else ()
    if weighed.best in ranking:
        own = dict(zip(ranking, signatures, strict=True))
        ranking = _with_best(ranking, weighed.best)
        signatures = tuple(own[c] for c in ranking)
    return Judged(
        weighed.decision,
        weighed.grounds,
        ranking,
        signatures,
        tuple(cause_probability(s) for s in signatures),
        weighed.best,
        weighed.members,
        tuple(m for m in together if m.effect.label not in kept),
        weighed.after,
        weighed.tied,
        weighed.halves,
        tuple(tuple(k) for k in classes),
        found,
        silent,
        unused,
        units,
    )


@dataclass(frozen=True, eq=False)
class _Compared:
    """What every verdict on a best model is weighed against."""

    ranking: tuple[CandidateModel, ...]
    signatures: tuple[Signature, ...]
    classes: list[list[str]]
    located: PortEvidence
    forward_steps: tuple[ForwardStep, ...]
    tried: tuple[CandidateModel, ...]  # models of several effects
    groups: tuple[tuple[str, ...], ...]  # of ports that the sensors cannot tell apart
    doubt: str
    unused: bool  # the best model does without the inputs, to which the outputs respond

    @cached_property
    def chances(self) -> dict[CandidateModel, float]:
        """Of every single effect, its probability."""
        return dict(zip(self.ranking, map(cause_probability, self.signatures), strict=True))


@dataclass(frozen=True, eq=False)
class _WeighedUp:
    """A best model with what is made of it."""

    best: CandidateModel
    after: PortEvidence
    grounds: VerdictStatistics
    halves: Crossed | None
    tied: tuple[Tied, ...]
    members: tuple[Member, ...]
    decision: Decision


def _weighed_up(
    search: Search, c: _Compared, best: CandidateModel, after: PortEvidence
) -> _WeighedUp:
    """Grounds, members and verdict of a best model; after: where something is missing beside it."""
    base = search.budget.baseline
    grounds = verdict_statistics(
        search.budget, search.asked, c.ranking, best, c.located, after, search.seed
    )
    alike = indistinguishable_from_first(search, c.ranking, c.classes)
    halves = crossed(search, c.ranking, best, alike, c.classes)
    members = tuple(_placed(search, c, m, best, alike) for m in _members(search, c, best, halves))
    tied = [
        one
        for one in c.ranking
        if one in alike or (halves and not halves.steady and one in halves.choices)
    ]
    rivals = _most_probable_of_families(search, c, best)
    alone = {
        one: _placed(
            search, c, _member(search, one.attached[0], one, base, own, halves), one, alike
        )
        for one, own in zip(c.ranking, c.signatures, strict=True)
        if one in tied or one in rivals
    }
    nameable: list[list[Weighed]] = [[], [], []]
    if not c.unused:
        nameable = [
            [_weighed(search, c, best, m) for m in members],
            [_weighed(search, c, one, alone[one]) for one in _of_families(tied, best)],
            [_weighed(search, c, one, alone[one]) for one in rivals],
        ]
    decision = decide(
        grounds.before,
        grounds.after(c.forward_steps),
        *nameable,
        doubt=c.doubt,
        settings=search.settings,
    )
    if decision.verdict == "ambiguous":
        tied = [one for one in alone if one.label in decision.named]
    one_of = tuple((one, alone[one]) for one in tied)
    return _WeighedUp(best, after, grounds, halves, one_of, members, decision)


def _stands(before: _WeighedUp, instead: _WeighedUp) -> bool:
    """Does the other model name something, and of several effects what was named among them? One
    that is nothing by itself is named in the company in which it was found."""
    named = set(instead.decision.named)
    single = len(before.best.attached) == 1 or before.decision.verdict == "ambiguous"
    return bool(named) and (single or named >= set(before.decision.named))


def _instead(search: Search, c: _Compared, weighed: _WeighedUp) -> CandidateModel | None:
    """The model that the figures are to be of instead of the best one. What may not be named does
    not stay in it, unless the rest is nothing without it; where nothing may be, the first effect
    is judged alone. Of several families it is the first that is named. Where a single effect ended
    at a bound, it is the best of its family that did not and removes next to as much."""
    best, named = weighed.best, weighed.decision.named
    if weighed.decision.verdict == "ambiguous":
        one_of = [one for one, _ in weighed.tied if one.label in named]
        return None if best in one_of else one_of[0]
    if len(named) < len(best.attached) > 1:
        kept = tuple(a for a in best.attached if a.label in named) or best.attached[:1]
        return _alone_or_refitted(search, c.ranking, kept, best)
    if named or not at_bounds(best, search.settings):
        return None
    most = search.excess(best) + search.settings.worth * search.excess(search.budget.baseline)
    within = (
        one
        for one in c.ranking
        if one.family == best.family
        and not at_bounds(one, search.settings)
        and search.excess(one) < most
    )
    return next(within, None)


def _members(
    search: Search, c: _Compared, best: CandidateModel, halves: Crossed | None
) -> tuple[Member, ...]:
    """The effects of the best model, each beside the others."""
    base = search.budget.baseline
    if len(best.attached) == 1:
        # what was found beside another may never have been refitted alone
        known = (
            own for one, own in zip(c.ranking, c.signatures, strict=True) if one.label == best.label
        )
        own = next(known, None) or alone(search, (best, *c.ranking), c.located)[0]
        return (_member(search, best.attached[0], best, base, own, halves),)
    found = []
    for a in best.attached:
        others = tuple(k for k in best.attached if k is not a)
        without = _alone_or_refitted(search, c.ranking, others, best)
        field = _InItsPlace.of(search, a, best, without, c.tried)
        own = signature(search, a, best, without, field.rival, field.wins, field.opposed, c.located)
        member = _member(search, a, best, without, own, halves)
        found.append(replace(member, instead=field.as_good))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _InItsPlace:
    """What stands against an effect beside others. rival: the best of the models that do without
    its family, with as many effects or only the others; wins: share of resamples that all of these
    lose; opposed: the most evidence of any of them, nats; as_good: families that do as well beside
    the same others, within one standard error."""

    rival: CandidateModel
    wins: float
    opposed: float
    as_good: tuple[str, ...]

    @classmethod
    def of(
        cls,
        search: Search,
        a: Attachment,
        best: CandidateModel,
        without: CandidateModel,
        tried: Sequence[CandidateModel],
    ) -> _InItsPlace:
        as_many = (c for c in tried if len(c.attached) == len(best.attached))
        own = search.family(a)
        rivals = [without, *(c for c in as_many if own not in map(search.family, c.attached))]
        losses = search.losses([best, *rivals])
        behind = losses[1:] - losses[0]
        order = np.argsort(behind.mean(axis=1), kind="stable")
        others = {k.label for k in best.attached if k is not a}
        as_good = [
            search.family(next(k for k in rivals[i].attached if k.label not in others))
            for i in order
            if others < {k.label for k in rivals[i].attached}
            and behind[i].mean() < search.settings.tie_errors * behind[i].std()
        ]
        return cls(
            rivals[order[0]],
            float((behind > 0.0).all(axis=0).mean()),
            max(map(search.nats, rivals)),
            tuple(dict.fromkeys(as_good)),
        )


def _member(
    search: Search,
    a: Attachment,
    model: CandidateModel,
    without: CandidateModel,
    own: Signature,
    halves: Crossed | None,
) -> Member:
    """What is said of an effect of a model; halves: what either half of the held-out windows
    chooses. Where that differs, the name hangs on which windows were asked."""
    left = reported(halves, model)
    removes = gap_share(search.budget, without.absolutes, left, search.seed)
    most = 1.0 if halves is None or halves.steady else search.settings.unbacked_probability
    bent = bend(model, a.label, search.settings)
    again = own_terms(model, a.label, search.budget.baseline, search.settings)
    return Member(a, own, min(cause_probability(own), most), removes, bent=bent, again=again)


def _placed(
    search: Search,
    c: _Compared,
    m: Member,
    model: CandidateModel,
    alike: tuple[CandidateModel, ...],
) -> Member:
    """The effect of a model, with the other ports at which one of its family does as well: of those
    that cannot be told from the first of the ranking, where it is one of them."""
    if len(model.attached) > 1 or model not in alike:
        return m
    least = search.settings.ambiguous_share * c.chances[model]
    others = (
        one.group
        for one in alike
        if one.family == model.family
        and not set(one.attached[0].ports) & set(m.effect.ports)
        and c.chances[one] >= least
        and not at_bounds(one, search.settings)
    )
    return replace(m, or_at=tuple(g for g in dict.fromkeys(others) if g != model.group))


def _weighed(search: Search, c: _Compared, model: CandidateModel, m: Member) -> Weighed:
    rig = search.evidence.rig
    own = {rig.group_of(port) for port in m.effect.ports}
    together = own.union(*(group for group in c.groups if own & set(group)))
    shares = c.located.shares(rig, *own)
    return Weighed(
        m.effect.label,
        m.effect.family(rig),
        m.probability,
        m.removes,
        at_bounds(model, search.settings, m.effect.label),
        # shares are worked out for the leading ports alone: evidence tells of the others
        max(m.signature.at_port, sum(shares[group] for group in together)),
        vanished(model, m.effect.label),
        m.bent,
        m.signature.of_left,
        m.again,
        m.signature.surely,
    )


def _alone_or_refitted(
    search: Search,
    ranking: tuple[CandidateModel, ...],
    attached: tuple[Attachment, ...],
    source: CandidateModel,
) -> CandidateModel:
    """The model with these effects, refitted from where the source is; that of the ranking where it
    is there and leaves less. Alone it may have ended in a local minimum, and what led out of it
    would be taken for the other effect's doing."""
    models = [c for c in ranking if c.attached == attached]
    models.append(refitted_with(search, attached, source))
    return min((c for c in models if c.finite), key=search.excess, default=models[0])


def _of_families(models: Sequence[CandidateModel], best: CandidateModel) -> list[CandidateModel]:
    """The first of every family among models of one effect each, where the best has one: neither
    ties nor rivals are sought among several effects."""
    first = {c.family: c for c in reversed(models)}
    return [c for c in models if first[c.family] is c] if len(best.attached) == 1 else []


def _most_probable_of_families(
    search: Search, c: _Compared, best: CandidateModel
) -> list[CandidateModel]:
    """The same with the most probable of every family, which need not be the first of it: one of
    those that ended at no bound, where there is one."""
    free = {one: not at_bounds(one, search.settings) for one in c.ranking}
    ordered = sorted(c.ranking, key=lambda one: (free[one], c.chances[one]), reverse=True)
    return _of_families(ordered, best)


def _freed(evidence: DataSplit, best: CandidateModel) -> CandidateModel:
    """The best model, refitted from new window starts where its fit had ended in a local
    minimum."""
    fitted = escape_local_minimum(best.fit, evidence.noise)
    if fitted is best.fit:
        return best
    better = replayed(evidence, best.assembly, fitted)
    return better if better.finite else best


def _with_best(
    ranking: tuple[CandidateModel, ...], best: CandidateModel
) -> tuple[CandidateModel, ...]:
    """The ranking led by the best model's first effect: by the best model itself where it has one
    effect (the backward check may have chosen one that was not first), else by the model with its
    first effect alone."""
    if not best.attached:
        return ranking
    if len(best.attached) > 1:
        label = best.attached[0].label
        best = next((c for c in ranking if c.label == label), ranking[0])
    return (best, *(c for c in ranking if c.label != best.label))
