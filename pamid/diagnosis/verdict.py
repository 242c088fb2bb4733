"""A diagnosis as the contract's JSON."""

from __future__ import annotations

from math import isclose
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import seen_mean
from pamid.base.units import column_size
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.consistency import CONTRADICTS, inconsistencies, unnamed
from pamid.diagnosis.decision import Share, counts_from
from pamid.diagnosis.judgement import forecast_interval
from pamid.diagnosis.judging import Member
from pamid.diagnosis.localise import frequency_band, regimes, worst_windows
from pamid.diagnosis.notes import notes, roughness
from pamid.diagnosis.proposal import Proposal, WithheldExperiment, proposal_result
from pamid.diagnosis.ranges import at_bounds
from pamid.diagnosis.signature import Signature
from pamid.diagnosis.tournament import Diagnosis
from pamid.diagnosis.transfer import transfer
from pamid.diagnosis.unknown import left_over
from pamid.diagnosis.verdict_words import chance_figure, remark, sentence
from pamid.estimation.intervals import background_pull, estimates
from pamid.model.isolability import Isolability, isolability
from pamid.model.port_flow import rig_map
from pamid.schemas import diagnosis_file as result
from pamid.schemas import grounds

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
    """All but the next experiment, which takes its time to find, and what is said of
    contradictions. unknown: of what is missing beside the causes, or altogether where none is named
    (`pamid.diagnosis.unknown`)."""
    shares = _where_shares(d)
    causes = _causes(d)
    isolable = isolability(d.evidence.rig, d.evidence.channels)
    port = _leading_port(isolable, shares, causes, unknown)
    remainder = _remainder(d, port, unknown)
    found = result.DiagnosisFile(
        verdict=cast(result.Verdict, d.verdict),
        sentence="",
        remark=remark(d),
        causes=causes,
        remainder=remainder,
        ranking=(*_ranking(d, seed), *(_unfitted(label, why) for label, why in d.failed)),
        where=_where(d, isolable, port, shares),
        how_far={c: how_far(d, i, seed) for i, c in enumerate(d.evidence.channels)},
        transfer=tuple(result.Transfer(**one) for one in transfer(d)),
        parameters=_rig_parameters(d.cause or d.budget.baseline),
        background=_background(d, d.cause or d.budget.baseline),
        unknown=_unknown(d, unknown) if unknown and d.cause is None else None,
        notes=(*notes(d), *roughness(d, remainder)),
        rig=rig_map(d.evidence.rig, d.evidence.channels),
        **_judgement(d),
    )
    return found.model_copy(update={"sentence": sentence(found)})


def _unknown(d: Diagnosis, described: dict[str, Any]) -> result.Unknown:
    told = {k: v for k, v in described.items() if k != "amount"}
    return result.Unknown(**told, free_forms=family_forms(d))


def completed(
    d: Diagnosis, draft: result.DiagnosisFile, proposal: Proposal | WithheldExperiment | None
) -> result.DiagnosisFile:
    """A draft with what to measure next, and with notes on where it contradicts itself."""
    said = draft.model_copy(update={"next_experiment": proposal_result(proposal)})
    against = [f"{CONTRADICTS}: {one}." for one in inconsistencies(said, d.settings)]
    held_back = [
        f"{m.effect} is probable (P {chance_figure(m.probability or 0.0)}), but not named: "
        f"{'; '.join(why)}."
        for m, why in unnamed(said, d.settings)
        if why
    ]
    withheld = [proposal.why] if isinstance(proposal, WithheldExperiment) else []
    return said.model_copy(update={"notes": (*against, *withheld, *held_back, *said.notes)})


def _judgement(d: Diagnosis) -> dict[str, Any]:
    """What candidates were judged by; nothing where there was no gap to judge them on."""
    rig, j = d.evidence.rig, d.judged
    if j is None:
        nothing: dict[str, Any] = dict.fromkeys(
            ("members", "dropped", "look_alikes", "further"), ()
        )
        return nothing | dict.fromkeys(("units", "grounds", "confidence"))

    def told(m: Member) -> result.BestMember:
        return result.BestMember(
            effect=m.effect.label,
            family=m.effect.family(rig),
            port=m.effect.group(rig),
            probability=_believed(d, m.probability),
            removes=_share(m.removes),
            bent=m.bent,
            again=m.again,
            signature=grounds.SignatureFigures(**vars(m.signature)),
        )

    return {
        "members": tuple(map(told, j.members)),
        "dropped": tuple(map(told, j.dropped)),
        "look_alikes": j.classes,
        "units": result.UnitsInDoubt(**j.units) if j.units else None,
        "further": tuple(grounds.Further(**vars(n)) for n in j.forward_steps),
        "grounds": grounds.Grounds(**vars(j.grounds)),
        "confidence": grounds.Confidence(
            gap=j.decision.gap,
            known=_believed(d, j.decision.known),
            first=_believed(d, j.probability[0]) if j.probability else 0.0,
        ),
    }


def _believed(d: Diagnosis, probability: float) -> float:
    """No effect is probable on recordings that show nothing of the model."""
    unused = d.judged is not None and d.judged.unused
    return 0.0 if unused or remark(d) else probability


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
        regimes=tuple(regimes(d.evidence, base, d.cause, d.settings)),
        frequency_hz=tuple(frequency_band(list(base.replays), after, d.evidence.noise, d.settings)),
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
    return tuple(
        result.FamilyForm(
            effect=f.attachment.label,
            family=f.family,
            port=f.port,
            known_by=f.known_by,
            shrinkage=f.shrinkage,
            low=f.low,
            high=f.high,
            curve=f.curve,
        )
        for f in d.free_forms
    )


def groups(d: Diagnosis) -> list[str]:
    rig = d.evidence.rig
    return list(dict.fromkeys(rig.group_of(name) for name in rig.ports))


def _where_shares(d: Diagnosis) -> tuple[result.PortShare, ...]:
    """Every port group's share of the gap, largest first."""
    rig = d.evidence.rig
    named = [a.group(rig) for a in d.cause.attached] if d.cause else []
    found = (
        d.located.shares(rig, *named)
        if d.located
        else dict.fromkeys(groups(d), 1.0 / len(groups(d)))
    )
    ordered = sorted(found.items(), key=lambda e: (-e[1], e[0]))
    return tuple(result.PortShare(port=g, share=v) for g, v in ordered)


def _causes(d: Diagnosis) -> tuple[result.Cause, ...]:
    """What the verdict names, strongest first; for "ambiguous" the members that cannot be told
    apart, the most probable first: what they remove does not decide between them."""
    j = d.judged
    if d.cause is None or j is None:
        return ()
    if d.verdict == "ambiguous":
        tied = [one for one in j.tied if one[1].effect.label in j.decision.named]
        tied.sort(key=lambda one: -one[1].probability)
        return tuple(_cause(c, m, 1.0 / len(tied)) for c, m in tied)
    shares = _cause_shares(d, [m.effect.label for m in j.named])
    ordered = sorted(j.named, key=lambda m: -shares[m.effect.label])
    return tuple(_cause(d.cause, m, shares[m.effect.label]) for m in ordered)


def _cause_shares(d: Diagnosis, labels: list[str]) -> dict[str, float]:
    """Shapley shares where every effect was also fitted alone; of two and more the singles decide
    the rest."""
    if len(labels) == 1:
        return {labels[0]: 1.0}
    assert d.cause is not None
    whole = d.budget.shrinkage(d.cause.absolutes)
    alone = {
        k: max(d.budget.shrinkage(d.singles[k].absolutes), 0.0) if k in d.singles else 0.0
        for k in labels
    }
    # two effects: phi_i = (v_i + v - v_j)/2, exact; three: the same with the others' mean
    phi = {
        k: max(
            0.0,
            0.5
            * (alone[k] + whole - sum(v for j, v in alone.items() if j != k) / (len(labels) - 1)),
        )
        for k in labels
    }
    total = sum(phi.values())
    return {k: v / total if total > 0 else 1.0 / len(labels) for k, v in phi.items()}


def _cause(c: CandidateModel, m: Member, share: float) -> result.Cause:
    rig = c.assembly.rig
    return result.Cause(
        effect=m.effect.label,
        family=m.effect.family(rig),
        port=m.effect.group(rig),
        or_at=m.or_at,
        parameters=_parameters(c, m.effect.label),
        probability=m.probability,
        removes=_share(m.removes),
        share=share,
    )


def _share(s: Share) -> result.GapShare:
    return result.GapShare(share=s.share, low=s.low, high=s.high)


def _remainder(
    d: Diagnosis, leading: str, unknown: dict[str, Any] | None
) -> result.Remainder | None:
    """What is left of the gap with the causes; the gap itself, which enters at the leading port,
    where there are none."""
    j = d.judged
    if j is None:
        return None
    removed = d.removed
    rest = removed.rest if removed else Share(1.0, 1.0, 1.0)
    misfit = j.grounds.after(j.forward_steps) if d.cause else j.grounds.before
    chance, p_value = (
        (j.decision.remainder, j.decision.remainder_p_value)
        if d.cause
        else (j.decision.gap, j.decision.gap_p_value)
    )
    # of recordings that do not suffice, too: what they leave is there, only not its cause
    unsure = d.verdict == "cannot-tell" and j.decision.gap_real
    described = unknown if unknown and left_over(d) else {}
    at = described.get("port", "")
    port = at if d.cause else leading
    probable, plain = counts_from(misfit, d.settings)
    return result.Remainder(
        share=rest.share,
        low=rest.low,
        high=rest.high,
        floors=misfit.floors,
        probability=chance,
        p_value=p_value,
        probable_from=probable,
        evidence=misfit.missing,
        plain_from=plain,
        real=left_over(d) or unsure,
        port=port if left_over(d) or unsure else "",
        formula=described.get("formula", "") if at == port else "",
        family=d.free_forms[0].family if d.cause and d.free_forms else "",
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


def _ranking(d: Diagnosis, seed: int) -> tuple[result.Candidate, ...]:
    j = d.judged
    if j is None:
        return ()
    return tuple(
        _ranked(d, c, _believed(d, chance), own, seed)
        for c, chance, own in zip(j.ranking, j.probability, j.signatures, strict=True)
    )


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
        signature=None,
    )


def _ranked(
    d: Diagnosis, c: CandidateModel, probability: float, signature: Signature, seed: int
) -> result.Candidate:
    left, before = d.reported(c), d.budget.baseline.absolutes
    losses, base = d.budget.channel_losses(left), d.budget.channel_losses(before)
    low, high = forecast_interval(base, losses, seed, d.settings)
    held = {}
    for i, channel in enumerate(d.evidence.channels):
        held[channel] = result.HeldOut(
            mae_before=column_size(channel, float(seen_mean(before[:, i]))),
            mae_after=column_size(channel, float(seen_mean(left[:, i]))),
        )
    return result.Candidate(
        effect=c.attached[-1].label,
        family=c.family,
        port=c.group,
        probability=probability,
        held_out=held,
        shrinkage=d.budget.shrinkage(left),
        low=low,
        high=high,
        converged=c.fit.converged,
        why=c.fit.why,
        parameters=_parameters(c, c.attached[-1].label),
        at_bound=at_bounds(c, d.settings),
        signature=grounds.SignatureFigures(**vars(signature)),
    )


def how_far(d: Diagnosis, i: int, seed: int) -> result.Reach:
    """One channel's errors on windows that had no part in the choice, in the column's unit."""
    channel, b = d.evidence.channels[i], d.budget
    rows, left = ~np.isnan(b.floor[:, i]), d.reported(d.cause or b.baseline)
    before, after = b.baseline.absolutes[rows, i], left[rows, i]
    low, high = forecast_interval(before, after, seed, d.settings)
    return result.Reach(
        mae_data_sheet=column_size(channel, b.data_sheet[rows, i].mean()),
        mae_refitted=column_size(channel, before.mean()),
        mae_with_cause=column_size(channel, after.mean()),
        noise_floor=column_size(channel, b.floor[rows, i].mean()),
        black_box=column_size(channel, b.black_box[rows, i].mean()),
        shrinkage=float(1.0 - after.mean() / before.mean()),
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
        [c.group for c, _ in (d.judged.tied if d.judged else ())],
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
