"""A diagnosis as the contract's JSON."""

from __future__ import annotations

from math import isclose
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import seen_mean
from pamid.base.units import column_size
from pamid.diagnosis.answer import Answer, NamedCause, features, forecast_interval, probability
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Share, paired_ratio
from pamid.diagnosis.family_forms import FreeForm
from pamid.diagnosis.localise import frequency_band, regimes, worst_windows
from pamid.diagnosis.notes import notes, roughness
from pamid.diagnosis.port_evidence import PortEvidence
from pamid.diagnosis.proposal import Proposal, WithheldExperiment, proposal_result
from pamid.diagnosis.ranges import at_bounds
from pamid.diagnosis.tournament import Diagnosis
from pamid.diagnosis.transfer import transfer
from pamid.diagnosis.unknown import left_over
from pamid.diagnosis.verdict_words import remark, sentence
from pamid.estimation.intervals import NORMAL_95, background_pull, estimates
from pamid.model.isolability import Isolability, isolability
from pamid.model.port_flow import rig_map
from pamid.model.rig import Rig
from pamid.schemas import diagnosis_file as result

Array = NDArray[np.float64]


def diagnosis_json(
    d: Diagnosis,
    unknown: dict[str, Any] | None,
    seed: int,
    proposal: Proposal | WithheldExperiment | None = None,
) -> dict[str, Any]:
    """diagnosis.json, section 4 of the contract."""
    return diagnosis_file(d, unknown, seed, proposal).as_json()


def diagnosis_file(
    d: Diagnosis,
    unknown: dict[str, Any] | None,
    seed: int,
    proposal: Proposal | WithheldExperiment | None = None,
) -> result.DiagnosisFile:
    """The same as the model that describes it."""
    return completed(d, drafted(d, unknown, seed), proposal)


def drafted(d: Diagnosis, unknown: dict[str, Any] | None, seed: int) -> result.DiagnosisFile:
    """All but the next experiment, which takes its time to find. unknown: of what is missing next
    to the causes, or altogether where none is named (`pamid.diagnosis.unknown`)."""
    shares = _where_shares(d)
    causes = _causes(d)
    isolable = isolability(d.evidence.rig, d.evidence.channels)
    port = _leading_port(isolable, shares, causes, unknown)
    remainder = _remainder(d, port, unknown)
    draft = result.DiagnosisFile(
        verdict=cast(result.Verdict, d.verdict),
        sentence="",
        remark=remark(d),
        causes=causes,
        remainder=remainder,
        ranking=(*_ranking(d), *(_unfitted(label, why) for label, why in d.failed)),
        comparison=_comparison(d),
        horizon_s=d.budget.horizon_s,
        forecast=_forecast(d),
        where=_where(d, isolable, port, shares),
        how_far={c: how_far(d, i, seed) for i, c in enumerate(d.evidence.channels)},
        transfer=tuple(result.Transfer(**one) for one in transfer(d)),
        parameters=_rig_parameters(d.cause or d.budget.baseline),
        background=_background(d, d.cause or d.budget.baseline),
        unknown=_unknown(d, unknown) if unknown and d.cause is None else None,
        notes=(*notes(d), *roughness(d, remainder)),
        rig=rig_map(d.evidence.rig, d.evidence.channels),
        next_experiment=None,
    )
    return draft.model_copy(update={"sentence": sentence(draft)})


def _unknown(d: Diagnosis, described: dict[str, Any]) -> result.Unknown:
    told = {k: v for k, v in described.items() if k != "amount"}
    return result.Unknown(**told, free_forms=family_forms(d))


def completed(
    d: Diagnosis, draft: result.DiagnosisFile, proposal: Proposal | WithheldExperiment | None
) -> result.DiagnosisFile:
    """A draft with the next experiment."""
    withheld = [proposal.why] if isinstance(proposal, WithheldExperiment) else []
    return draft.model_copy(
        update={
            "next_experiment": proposal_result(proposal),
            "notes": (*withheld, *draft.notes),
        }
    )


def _comparison(d: Diagnosis) -> tuple[result.ComparisonStep, ...]:
    """The confidence set of every step that added an effect, and of the last one."""
    if d.selection is None:
        return ()
    rig = d.evidence.rig

    def member(c: CandidateModel, reference: CandidateModel) -> result.SetMember:
        a = c.attached[-1]
        return result.SetMember(
            effect=c.label,
            family=a.family(rig),
            port=a.group(rig),
            removes=_share(d.comparison.removed(c, reference)),
            losses=tuple(map(float, d.comparison.loss(c))),
        )

    return tuple(
        result.ComparisonStep(
            reference=step.reference.label,
            reference_losses=tuple(map(float, d.comparison.loss(step.reference))),
            tied=tuple(member(c, step.reference) for c in step.tied),
        )
        for step in d.selection.steps
    )


def _forecast(d: Diagnosis) -> result.Forecast | None:
    """Share of the error to be removed on a fresh recording."""
    if d.cause is None:
        return None
    before, after = (
        d.budget.channel_losses(x) for x in (d.budget.baseline.absolutes, d.reported(d.cause))
    )
    if len(before) < 2:
        return None
    low, high = forecast_interval(before, after, d.seed)
    return result.Forecast(share=float(1.0 - after.sum() / before.sum()), low=low, high=high)


def _rig_parameters(model: CandidateModel) -> dict[str, result.Estimate]:
    return {
        e.name: result.Estimate(
            value=e.value,
            low=e.low,
            high=e.high,
            prior=e.prior,
            strain=e.strain,
            unit=e.bound.unit,
            word=e.word,
            at_bound=e.at_bound,
        )
        for e in estimates(model.fit)
        if not e.bound.owner
    }


def _where(
    d: Diagnosis, isolable: Isolability, port: str, shares: tuple[result.PortShare, ...]
) -> result.Where:
    base = d.budget.baseline
    after = list(d.cause.replays) if d.cause else None
    return result.Where(
        port=port,
        ports=shares,
        **_isolable(d, isolable),
        regimes=tuple(regimes(d.evidence, base, d.cause)),
        frequency_hz=tuple(frequency_band(list(base.replays), after, d.evidence.noise)),
        windows_s=tuple((begin, end) for begin, end in worst_windows(list(base.replays), d.budget)),
    )


def _leading_port(
    isolable: Isolability,
    shares: tuple[result.PortShare, ...],
    causes: tuple[result.Cause, ...],
    unknown: dict[str, Any] | None,
) -> str:
    """The port of the cause that removes most, which carries most of the gap among those that the
    sensors cannot tell from it; without a cause the one with the largest share, of several with the
    same, or that the sensors cannot tell from it, the one whose signals describe best what is
    missing."""
    if causes:
        return causes[0].port
    largest = [s.port for s in shares if isclose(s.share, shares[0].share)]
    alike = {port for group in isolable.groups if shares[0].port in group for port in group}
    described = (unknown or {}).get("port", "")
    return described if described in alike.union(largest) else largest[0]


def family_forms(d: Diagnosis) -> tuple[result.FamilyForm, ...]:
    """The free forms that take up what the catalogue does not explain, best first."""
    return tuple(_family_form(d, f) for f in (d.answer.free_forms if d.answer else ()))


def _family_form(d: Diagnosis, f: FreeForm) -> result.FamilyForm:
    share, low, high = _shrinkage(d, f.model)
    return result.FamilyForm(
        effect=f.attachment.label,
        family=f.family,
        port=f.port,
        known_by=f.known_by,
        removes=_share(f.removes),
        shrinkage=share,
        low=low,
        high=high,
        curve=f.curve,
    )


def groups(d: Diagnosis) -> list[str]:
    rig = d.evidence.rig
    return list(dict.fromkeys(rig.group_of(name) for name in rig.ports))


def _where_shares(d: Diagnosis) -> tuple[result.PortShare, ...]:
    """Every port group's share of the gap, largest first: what the causes remove, without any what
    curves at ports do, and what remains where the latent evidence places it."""
    rig = d.evidence.rig
    even = dict.fromkeys(groups(d), 1.0 / len(groups(d)))
    left = d.left_at or d.located
    found = left.shares(rig) if left else even
    if d.answer and d.cause and d.removed:
        rest = min(max(d.removed.rest.share, 0.0), 1.0)
        found = {group: rest * share for group, share in _shares_of(d.located, rig, left).items()}
        for cause, share in _parts_of_causes(d.answer):
            at = dict.fromkeys(rig.group_of(name) for name in cause.effect.ports)
            for group in at:  # an effect at several ports is reported under what these share
                found[group] += (1.0 - rest) * share / len(at)
    elif d.answer and d.answer.free_forms:
        forms = d.answer.free_forms
        removed = min(forms[0].removes.share, 1.0)
        total = sum(f.removes.share for f in forms)
        found = {group: (1.0 - removed) * share for group, share in found.items()}
        for f in forms:
            found[f.port] += removed * f.removes.share / total
    ordered = sorted(found.items(), key=lambda e: (-e[1], e[0]))
    return tuple(result.PortShare(port=g, share=v) for g, v in ordered)


def _shares_of(
    located: PortEvidence | None, rig: Rig, left: PortEvidence | None
) -> dict[str, float]:
    """How what remains is divided among the groups of ports: by the evidence that is left."""
    whole = left if left is not None and left.worth else located
    if left is None or whole is None:
        names = list(dict.fromkeys(rig.group_of(name) for name in rig.ports))
        return dict.fromkeys(names, 1.0 / len(names))
    if left.worth:
        return left.shares(rig)
    out = dict.fromkeys((rig.group_of(name) for name in rig.ports), 0.0)
    for name, gain in left.gains.items():
        out[rig.group_of(name)] += gain
    total = sum(out.values())
    return {k: v / total if total > 0.0 else 1.0 / len(out) for k, v in out.items()}


def _causes(d: Diagnosis) -> tuple[result.Cause, ...]:
    """Causes that the verdict names, the one that removes most first; for "ambiguous" the members
    that cannot be separated."""
    if d.answer is None or d.cause is None:
        return ()
    return tuple(_cause(c, part) for c, part in _parts_of_causes(d.answer))


def _parts_of_causes(answer: Answer) -> list[tuple[NamedCause, float]]:
    """Every cause, the one that removes most first, with its part of what they remove one by
    one."""
    causes = sorted(answer.causes, key=lambda c: -c.removes.share)
    removed = [max(c.removes.share, 0.0) for c in causes]
    total = sum(removed)
    parts = [r / total if total > 0.0 else 1.0 / len(removed) for r in removed]
    return list(zip(causes, parts, strict=True))


def _cause(c: NamedCause, share: float) -> result.Cause:
    rig = c.model.assembly.rig
    return result.Cause(
        effect=c.effect.label,
        family=c.effect.family(rig),
        port=c.effect.group(rig),
        or_at=c.or_at,
        instead=c.instead,
        parameters=_parameters(c.model, c.effect.label),
        probability=probability(c.figures),
        removes=_share(c.removes),
        figures=c.figures,
        share=share,
    )


def _share(s: Share) -> result.GapShare:
    return result.GapShare(share=s.share, low=s.low, high=s.high, standard_errors=s.z)


def _remainder(
    d: Diagnosis, leading: str, unknown: dict[str, Any] | None
) -> result.Remainder | None:
    """What is left of the gap with the causes; the gap itself, which enters at the leading port,
    where there are none."""
    if d.answer is None:
        return None
    rest = d.removed.rest if d.removed else Share(1.0, 1.0, 1.0)
    # of recordings that do not suffice, too: what they leave is there, only not its cause
    material = left_over(d) or d.verdict == "cannot-tell"
    described = unknown if unknown and left_over(d) else {}
    at = described.get("port", "")
    port = at if d.cause else leading
    forms = d.answer.free_forms
    return result.Remainder(
        share=rest.share,
        low=rest.low,
        high=rest.high,
        floors=d.answer.floors,
        real=material,
        port=port if material else "",
        formula=described.get("formula", "") if at == port else "",
        family=forms[0].family if d.cause and forms else "",
        **(described.get("amount", {}) if at == port else {}),
    )


def _parameters(c: CandidateModel, label: str) -> dict[str, result.CauseParameter]:
    """Parameters of one of a model's effects, by name with unit: what was fitted, and amounts that
    were read off the recordings."""
    fitted = {
        e.bound.name: result.CauseParameter(
            value=e.value, low=e.low, high=e.high, unit=e.bound.unit, word=e.word
        )
        for e in estimates(c.fit)
        if e.bound.owner == label
    }
    read_off = {
        b.name: result.CauseParameter(
            value=float(p / b.factor),
            low=float(p / b.factor),
            high=float(p / b.factor),
            unit=b.unit,
            word="read off",
        )
        for b, p in zip(c.assembly.parameters, c.fit.p, strict=True)
        if b.owner == label and b.null is not None and not b.fitted
    }
    return fitted | read_off


def _ranking(d: Diagnosis) -> tuple[result.Candidate, ...]:
    return tuple(_ranked(d, c) for c in d.ranking)


def _unfitted(label: str, why: str) -> result.Candidate:
    """A candidate that could not be fitted."""
    return result.Candidate(
        effect=label,
        family="",
        port="",
        probability=0.0,
        held_out={},
        shrinkage=0.0,
        low=0.0,
        high=0.0,
        converged=False,
        why=why,
        parameters={},
        at_bound=(),
        removes=None,
        behind=0.0,
        figures={},
        set_aside=(),
    )


def _shrinkage(d: Diagnosis, c: CandidateModel) -> tuple[float, float, float]:
    """Share of the baseline's held-out error that a model removes, with its 95 % interval."""
    base = d.comparison.loss(d.budget.baseline)
    if len(base) < 2:
        return 0.0, 0.0, 0.0
    return _interval(*paired_ratio(base - d.comparison.loss(c), base, d.seed))


def _interval(share: float, error: float) -> tuple[float, float, float]:
    """A share of the error with the 95 % interval of its standard error, at most 1."""
    return share, share - NORMAL_95 * error, min(share + NORMAL_95 * error, 1.0)


def _ranked(d: Diagnosis, c: CandidateModel) -> result.Candidate:
    before, removed = d.budget.baseline.absolutes, d.comparison.removed(c)
    share, low, high = _shrinkage(d, c)
    held = {
        channel: result.HeldOut(
            mae_before=column_size(channel, float(seen_mean(before[:, i]))),
            mae_after=column_size(channel, float(seen_mean(c.absolutes[:, i]))),
        )
        for i, channel in enumerate(d.evidence.channels)
    }
    first = d.ranking[0]
    # an effect that is named has one probability: that of the answer
    named = {k.effect.label: k.figures for k in d.answer.causes} if d.answer and d.cause else {}
    label = c.attached[-1].label
    figures = named.get(label) or features(d.comparison, c, d.budget.baseline, d.ranking)
    return result.Candidate(
        effect=c.attached[-1].label,
        family=c.family,
        port=c.group,
        probability=0.0 if remark(d) else probability(figures),
        held_out=held,
        removes=_share(removed),
        behind=0.0 if c is first else d.comparison.removed(first, c).z,
        shrinkage=share,
        low=low,
        high=high,
        converged=c.fit.converged,
        why=c.fit.why,
        parameters=_parameters(c, c.attached[-1].label),
        at_bound=at_bounds(c, d.settings),
        figures=figures,
        set_aside=d.set_aside.get(c.label, ()),
    )


def how_far(d: Diagnosis, i: int, seed: int) -> result.Reach:
    """One channel's errors on windows that had no part in the choice, in the column's unit."""
    channel, b = d.evidence.channels[i], d.budget
    rows, left = ~np.isnan(b.floor[:, i]), d.reported(d.cause or b.baseline)
    before, after = b.baseline.absolutes[rows, i], left[rows, i]
    ratio = paired_ratio(before - after, before, seed) if len(before) > 1 else (0.0, 1.0)
    share, low, high = _interval(*ratio)
    short = None if b.short is None else column_size(channel, b.short[rows, i].mean())
    return result.Reach(
        mae_data_sheet=column_size(channel, b.data_sheet[rows, i].mean()),
        mae_refitted=column_size(channel, before.mean()),
        mae_with_cause=column_size(channel, after.mean()),
        noise_floor=column_size(channel, b.floor[rows, i].mean()),
        mae_refitted_short=short,
        shrinkage=share,
        low=low,
        high=high,
    )


def _isolable(d: Diagnosis, found: Isolability) -> dict[str, Any]:
    """What these sensors cannot separate by structure, what the recordings leave tied, and sensors
    that would help."""
    together = [list(g) for g in found.groups if len(g) > 1]
    port = d.evidence.rig.group_of
    leading = d.located.classes[0] if d.located else ()
    for tied in (
        [c.effect.group(d.evidence.rig) for c in (d.answer.causes if d.answer else ())]
        if d.verdict == "ambiguous"
        else [],
        [port(name) for name in leading],
    ):
        if len(set(tied)) > 1 and not any(set(tied) <= set(g) for g in together):
            together.append(list(dict.fromkeys(tied)))
    return {
        "indistinguishable": together,
        "redundancy": found.redundancy,
        "unseen": found.unseen,
        "sensors": tuple(result.Sensor(sensor=s.sensor, splits=s.splits) for s in found.sensors),
    }


def _background(d: Diagnosis, final: CandidateModel) -> dict[str, result.Pull]:
    """Pull of every background term, and a share of the data sheet's gap in proportion to its
    squared pull."""
    pulls = background_pull(final.fit)
    sheet, refitted = np.nansum(d.budget.data_sheet), np.nansum(d.budget.baseline.absolutes)
    gained = max(0.0, 1.0 - refitted / sheet) if sheet > 0 else 0.0
    # strains and pulls are in prior deviations, and their squares what the priors cost
    everything = sum(e.strain**2 for e in estimates(final.fit) if not e.bound.owner) + sum(
        v**2 for v in pulls.values()
    )
    return {
        k: result.Pull(pull=v, share_of_gap=gained * v**2 / everything if everything > 0 else 0.0)
        for k, v in pulls.items()
    }
