"""A diagnosis as the contract's JSON, and as the sentence that opens the report."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import seen_mean
from pamid.base.units import column_size
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.decision import forecast_interval
from pamid.diagnosis.localise import frequency_band, regimes, worst_windows
from pamid.diagnosis.notes import notes
from pamid.diagnosis.proposal import Proposal, proposal_result
from pamid.diagnosis.ranges import at_bounds
from pamid.diagnosis.tournament import Diagnosis
from pamid.diagnosis.transfer import transfer
from pamid.estimation.intervals import background_pull, estimates
from pamid.model.isolability import isolability
from pamid.schemas import diagnosis_file as result
from pamid.schemas.grounds import Confidence, Further, Grounds

Array = NDArray[np.float64]


def diagnosis_json(
    d: Diagnosis, unknown: dict[str, Any] | None, seed: int, proposal: Proposal | None = None
) -> dict[str, Any]:
    """diagnosis.json, section 4 of the contract."""
    return diagnosis_file(d, unknown, seed, proposal).as_json()


def diagnosis_file(
    d: Diagnosis, unknown: dict[str, Any] | None, seed: int, proposal: Proposal | None = None
) -> result.DiagnosisFile:
    """The same as the model that describes it."""
    base = d.budget.baseline
    after = list(d.cause.replays) if d.cause else None
    shares = _where_shares(d)
    final = d.cause or base
    port = d.cause.group if d.cause else (unknown or {}).get("port") or shares[0].port
    return result.DiagnosisFile(
        verdict=cast(result.Verdict, d.verdict),
        sentence=sentence(d, unknown),
        remark=remark(d),
        causes=tuple(causes(d)),
        ranking=(
            *(_ranked(d, c, p, seed) for c, p in zip(d.ranking, d.probability, strict=True)),
            *(_unfitted(label, why) for label, why in d.failed),
        ),
        where=result.Where(
            port=port,
            ports=shares,
            **_isolable(d),
            regimes=tuple(regimes(d.evidence, base, d.cause, d.settings)),
            frequency_hz=tuple(
                frequency_band(list(base.replays), after, d.evidence.noise, d.settings)
            ),
            windows_s=tuple(
                (begin, end) for begin, end in worst_windows(list(base.replays), d.budget)
            ),
        ),
        how_far={c: how_far(d, i, seed) for i, c in enumerate(d.evidence.channels)},
        transfer=tuple(result.Transfer(**one) for one in transfer(d)),
        look_alikes=d.classes,
        next_experiment=proposal_result(proposal),
        parameters={
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
            for e in estimates(final.fit)
            if not e.bound.owner
        },
        background=_background(d, final),
        unknown=result.Unknown(**unknown, free_forms=family_forms(d)) if unknown else None,
        units=result.UnitsInDoubt(**d.units) if d.units else None,
        further=tuple(Further(**vars(n)) for n in d.forward_steps),
        grounds=Grounds(**vars(d.grounds)) if d.grounds else None,
        notes=tuple(notes(d)),
        confidence=Confidence(gap=d.decision.gap, known=d.decision.known, first=d.decision.first)
        if d.decision
        else None,
    )


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
    named = d.cause.group if d.cause and len(d.cause.attached) == 1 else ""
    found = (
        d.located.shares(d.evidence.rig, named)
        if d.located
        else dict.fromkeys(groups(d), 1.0 / len(groups(d)))
    )
    ordered = sorted(found.items(), key=lambda e: (-e[1], e[0]))
    return tuple(result.PortShare(port=g, share=v) for g, v in ordered)


def causes(d: Diagnosis) -> list[result.Cause]:
    """What the verdict adds, strongest first; for "ambiguous" the members that cannot be told
    apart."""
    if d.cause is None:
        return []
    if d.verdict == "ambiguous":
        first_of_family = list({c.family: c for c in reversed(d.tied)}.values())[::-1]
        return [
            _cause(c, c.attached[-1].label, 1.0 / len(first_of_family)) for c in first_of_family
        ]
    labels = [a.label for a in d.cause.attached]
    shares = _cause_shares(d, labels)
    return [
        _cause(d.cause, label, shares[label]) for label in sorted(labels, key=lambda k: -shares[k])
    ]


def _cause_shares(d: Diagnosis, labels: list[str]) -> dict[str, float]:
    """Shapley shares where every effect was also fitted alone; of two and more the singles decide
    the rest."""
    if len(labels) == 1:
        return {labels[0]: 1.0}
    assert d.cause is not None
    whole = d.budget.shrinkage(d.cause.absolutes, d.chosen)
    alone = {
        k: max(d.budget.shrinkage(d.singles[k].absolutes, d.chosen), 0.0) if k in d.singles else 0.0
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


def _cause(c: CandidateModel, label: str, share: float) -> result.Cause:
    attached = next(a for a in c.attached if a.label == label)
    rig = c.assembly.rig
    return result.Cause(
        effect=label,
        family=attached.family(rig),
        port=attached.group(rig),
        parameters=_parameters(c, label),
        share=share,
    )


def _parameters(c: CandidateModel, label: str) -> dict[str, result.CauseParameter]:
    """Fitted parameters of one of a model's effects, by name with unit."""
    return {
        e.bound.name: result.CauseParameter(
            value=e.value, low=e.low, high=e.high, unit=e.bound.unit, word=e.word
        )
        for e in estimates(c.fit)
        if e.bound.owner == label
    }


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
    )


def _ranked(d: Diagnosis, c: CandidateModel, probability: float, seed: int) -> result.Candidate:
    rows = d.reporting if d.reporting.any() else d.chosen
    losses, base = (
        d.budget.channel_losses(c.absolutes),
        d.budget.channel_losses(d.budget.baseline.absolutes),
    )
    low, high = forecast_interval(base[rows], losses[rows], seed, d.settings)
    held = {}
    for i, channel in enumerate(d.evidence.channels):
        held[channel] = result.HeldOut(
            mae_before=column_size(channel, float(seen_mean(d.budget.baseline.absolutes[rows, i]))),
            mae_after=column_size(channel, float(seen_mean(c.absolutes[rows, i]))),
        )
    return result.Candidate(
        effect=c.attached[-1].label,
        family=c.family,
        port=c.group,
        probability=probability,
        held_out=held,
        shrinkage=d.budget.shrinkage(c.absolutes, rows),
        low=low,
        high=high,
        converged=c.fit.converged,
        why=c.fit.why,
        parameters=_parameters(c, c.attached[-1].label),
        at_bound=at_bounds(c, d.settings),
    )


def how_far(d: Diagnosis, i: int, seed: int) -> result.Reach:
    """One channel's errors on the windows that only report, in the column's unit."""
    channel, b = d.evidence.channels[i], d.budget
    seen = ~np.isnan(b.floor[:, i])
    rows = d.reporting & seen if (d.reporting & seen).any() else seen
    before = b.baseline.absolutes[rows, i]
    after = (d.cause or b.baseline).absolutes[rows, i]
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


def _isolable(d: Diagnosis) -> dict[str, Any]:
    """What these sensors cannot separate by structure, what the recordings leave tied, and sensors
    that would help."""
    found = isolability(d.evidence.rig, d.evidence.channels)
    together = [list(g) for g in found.groups if len(g) > 1]
    port = d.evidence.rig.group_of
    leading = d.located.classes[0] if d.located else ()
    for tied in ([c.group for c in d.tied], [port(name) for name in leading]):
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


def remark(d: Diagnosis) -> str:
    """What is wrong with the recordings, or with how they were read, where no verdict on the model
    means anything."""
    if d.units and (d.units["slips"] or not d.empty):
        channel, share = max(d.units["error_over_spread"].items(), key=lambda pair: pair[1])
        return (
            f"The refitted model misses {channel} by {share:.2g} times what it moves. "
            f"{d.units['advice']}"
        )
    if not d.empty:
        return ""
    return (
        "The recordings show nothing that this model could have made of its input: it predicts "
        "them no better than their own mean or a straight line does. Check that every column is "
        "the channel that it is named after, that all were recorded together on one clock, and "
        "that the input acted on the rig."
    )


def sentence(d: Diagnosis, unknown: dict[str, Any] | None) -> str:
    """The verdict in one sentence; a remark goes before it."""
    if said := remark(d):
        return said
    if d.verdict == "no-structural-gap":
        return (
            "Nothing beyond retuned parameters and ordinary tolerances: no structural gap was "
            "found."
        )
    if d.verdict == "unknown-effect" or d.cause is None:
        where = f" It enters at the {unknown['port']}." if unknown else ""
        return (
            "Something material is missing from the model, and no effect of the catalogue "
            f"explains it.{where}{_family_sentence(d)}"
        )
    rows = d.reporting if d.reporting.any() else d.chosen
    share = 100.0 * d.budget.shrinkage(d.cause.absolutes, rows)
    if d.verdict == "ambiguous":
        names = " or ".join(dict.fromkeys(c.attached[-1].label for c in d.tied))
        return f"The gap shrinks by {share:.0f} %, but these recordings cannot tell {names} apart."
    names = " and ".join(a.label for a in d.cause.attached)
    place = "" if "@" in names else f" at the {d.cause.group}"
    verb = "explains" if len(d.cause.attached) == 1 else "explain"
    return f"{names}{place} {verb} the gap: the held-out error shrinks by {share:.0f} %."


def _family_sentence(d: Diagnosis) -> str:
    """Of which family it is, where a free form of one takes it up; begins with a space."""
    if not d.free_forms:
        return ""
    best = {f.family: f for f in reversed(d.free_forms)}  # of every family
    families = list(dict.fromkeys(f.family for f in d.free_forms))
    taken = []
    for family in families:
        ports = dict.fromkeys(f.port for f in d.free_forms if f.family == family)
        removed = 100.0 * best[family].shrinkage
        taken.append(f"{best[family].known_by} at the {' or '.join(ports)} removes {removed:.0f} %")
    return (
        f" It is of the {' or '.join(families)} family, in a form not in the catalogue: "
        f"{' or '.join(taken)} of the held-out error."
    )
