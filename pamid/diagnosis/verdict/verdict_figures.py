"""Content of diagnosis.json from a diagnosis."""

from __future__ import annotations

from math import isclose
from typing import Any, cast

import numpy as np

from pamid.base.metrics import seen_mean
from pamid.base.schemas import diagnosis_file as result
from pamid.base.units import column_size
from pamid.diagnosis.answer import Answer, NamedCause, features, forecast_interval, probability
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import NOTHING, error_removed
from pamid.diagnosis.pipeline import Diagnosis
from pamid.diagnosis.planning.next_experiment import Proposal, WithheldExperiment
from pamid.diagnosis.ranges import at_bounds
from pamid.diagnosis.verdict.localise import frequency_band, regimes, worst_windows
from pamid.diagnosis.verdict.notes import notes_of, remark, roughness, unexplained
from pamid.diagnosis.verdict.remainder import Missing, described
from pamid.diagnosis.verdict.verdict_words import sentence
from pamid.estimation.identifiable_combinations import reported_parameters
from pamid.estimation.intervals import NORMAL_95, background_pull, estimates
from pamid.model.isolability import Isolability, isolability
from pamid.model.port_flow import rig_map
from pamid.simulation.data_split import Span

AMPLITUDE_FACTOR = 1.5  # ratio of standard deviations: other amplitudes


def diagnosis_file(d: Diagnosis, missing: Missing | None = None) -> result.DiagnosisFile:
    """Return diagnosis.json (contract, section 4) without the next experiment.

    missing: estimate of the unexplained value at a port.
    """
    shares, notes = _port_shares(d), notes_of(d)
    # the largest first; for "ambiguous" the members that cannot be separated
    named = _parts_of_causes(d.answer) if d.answer and d.cause else []
    causes = tuple(_cause(c, part) for c, part in named)
    isolable = isolability(d.evidence.rig, d.evidence.channels)
    unknown = described(d, missing) if d.left_over else None
    if causes:
        port = causes[0].port
    else:
        # of ports that tie with the largest share, or are inseparable from it, that at which the
        # missing term is described
        largest = [s.port for s in shares if isclose(s.share, shares[0].share)]
        alike = {q for group in isolable.groups if shares[0].port in group for q in group}
        port = unknown.port if unknown and unknown.port in alike.union(largest) else largest[0]
    remainder = _remainder(d, port, unknown, missing)
    forecast = None
    if d.cause is not None:
        before, after = (
            d.budget.channel_losses(x) for x in (d.budget.baseline.absolutes, d.reported(d.cause))
        )
        if len(before) > 1:
            low, high = forecast_interval(before, after, d.seed)
            share = float(1.0 - after.sum() / before.sum())
            forecast = result.Forecast(share=share, low=low, high=high)
    final = d.cause or d.budget.baseline
    reached = {c: _how_far(d, i) for i, c in enumerate(d.evidence.channels)}
    file = result.DiagnosisFile(
        verdict=cast(result.Verdict, d.verdict),
        sentence="",
        remark=remark(d),
        doubts=d.evidence.doubts,
        causes=causes,
        remainder=remainder,
        ranking=(*(_ranked(d, c) for c in d.ranking), *map(_unfitted, d.failed)),
        comparison=_comparison(d),
        horizon_s=d.budget.horizon_s,
        forecast=forecast,
        where=_where(d, isolable, port, shares),
        how_far=reached,
        transfer=transfer(d),
        parameters={b.name: e for b, e in reported_parameters(final.fit).items() if not b.owner},
        background=_background(d, final),
        unknown=unknown if d.cause is None else None,
        notes=(*unexplained(reached), *notes, *roughness(d, remainder)),
        rig=rig_map(d.evidence.rig, d.evidence.channels),
        next_experiment=None,
    )
    return file.model_copy(update={"sentence": sentence(file)})


def with_experiment(
    file: result.DiagnosisFile, proposal: Proposal | WithheldExperiment | None
) -> result.DiagnosisFile:
    """The same with the next experiment, or with a note on why there is none."""
    if isinstance(proposal, WithheldExperiment):
        return file.model_copy(update={"notes": (proposal.why, *file.notes)})
    experiment = proposal.experiment if proposal else None
    return file.model_copy(update={"next_experiment": experiment})


# ---- comparison and forecast ---------------------------------------------------------------------


def _comparison(d: Diagnosis) -> tuple[result.ComparisonStep, ...]:
    """The confidence set of every step that added an effect, and of the last."""
    if d.selection is None:
        return ()

    def member(c: CandidateModel, reference: CandidateModel) -> result.SetMember:
        return result.SetMember(
            effect=c.label,
            family=c.family,
            port=c.group,
            removes=d.comparison.removed(c, reference),
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


# ---- where ---------------------------------------------------------------------------------------


def _where(
    d: Diagnosis, isolable: Isolability, port: str, shares: tuple[result.PortShare, ...]
) -> result.Where:
    base, group_of = d.budget.baseline, d.evidence.rig.group_of
    after = list(d.cause.replays) if d.cause else None
    # groups that the sensors cannot separate by structure, and those that the recordings leave tied
    together = [list(group) for group in isolable.groups if len(group) > 1]
    alternatives = d.answer.causes if d.answer and d.verdict == "ambiguous" else ()
    for tied in (
        [c.effect.group(d.evidence.rig) for c in alternatives],
        [group_of(name) for name in (d.located.classes[0] if d.located else ())],
    ):
        if len(set(tied)) > 1 and not any(set(tied) <= set(group) for group in together):
            together.append(list(dict.fromkeys(tied)))
    return result.Where(
        port=port,
        ports=shares,
        indistinguishable=tuple(map(tuple, together)),
        redundancy=isolable.redundancy,
        unseen=isolable.unseen,
        sensors=isolable.sensors,
        regimes=regimes(d.evidence, base, d.cause),
        frequency_hz=frequency_band(list(base.replays), after, d.evidence.noise),
        windows_s=worst_windows(list(base.replays), d.budget),
    )


def _port_shares(d: Diagnosis) -> tuple[result.PortShare, ...]:
    """Return the gap share of every port group, the largest first.

    The removed part counts at the ports of the causes or, without causes, of the nonparametric
    curves. The rest is divided by the latent evidence.
    """
    rig, forms = d.evidence.rig, d.answer.free_forms if d.answer else ()
    if d.left_at:
        shares = d.left_at.shares(rig)
    else:
        groups = dict.fromkeys(rig.group_of(name) for name in rig.ports)
        shares = dict.fromkeys(groups, 1.0 / len(groups))
    if d.answer and d.cause and d.removed:
        rest = min(max(d.removed.rest.share, 0.0), 1.0)
        shares = {group: rest * share for group, share in shares.items()}
        for cause, share in _parts_of_causes(d.answer):
            at = dict.fromkeys(rig.group_of(name) for name in cause.effect.ports)
            for group in at:  # an effect at several ports is reported under what these share
                shares[group] += (1.0 - rest) * share / len(at)
    elif forms:
        removed = min(forms[0].removes.share, 1.0)
        total = sum(f.removes.share for f in forms)
        shares = {group: (1.0 - removed) * share for group, share in shares.items()}
        for f in forms:
            shares[f.port] += removed * f.removes.share / total
    ordered = sorted(shares.items(), key=lambda e: (-e[1], e[0]))
    return tuple(result.PortShare(port=g, share=v) for g, v in ordered)


# ---- causes and what remains ---------------------------------------------------------------------


def _parts_of_causes(answer: Answer) -> list[tuple[NamedCause, float]]:
    """Every cause, the largest first, with its part of what they remove
    separately."""
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
        removes=c.removes,
        figures=c.figures,
        share=share,
    )


def _remainder(
    d: Diagnosis, leading: str, unknown: result.Unknown | None, missing: Missing | None
) -> result.Remainder | None:
    """Gap that remains with the causes; without causes the gap itself, at the leading port."""
    if d.answer is None:
        return None
    rest = d.removed.rest if d.removed else NOTHING.rest
    # of recordings that do not suffice, too: what they leave is there, only not its cause
    material = d.left_over or d.verdict == "cannot-tell"
    at = unknown.port if unknown else ""
    port, forms = at if d.cause else leading, d.answer.free_forms
    remainder = result.Remainder(
        share=rest.share,
        low=rest.low,
        high=rest.high,
        floors=d.comparison.floors(d.answer.model),
        real=material,
        port=port if material else "",
        formula=unknown.formula if unknown and at == port else "",
        family=forms[0].family if d.cause and forms else "",
    )
    if not unknown or not missing or at != port:
        return remainder
    return remainder.model_copy(
        update={
            "missing_rms": missing.amount,
            "passing_rms": missing.passing,
            "unit": missing.units["value"],
        }
    )


# ---- ranking -------------------------------------------------------------------------------------


def _unfitted(failed: tuple[str, str]) -> result.Candidate:
    """A candidate that could not be fitted, and the reason."""
    label, why = failed
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


def _ranked(d: Diagnosis, c: CandidateModel) -> result.Candidate:
    before, removed = d.budget.baseline.absolutes, d.comparison.removed(c)
    share, low, high = d.comparison.shrinkage(c)
    held = {
        channel: result.HeldOut(
            mae_before=column_size(channel, float(seen_mean(before[:, i]))),
            mae_after=column_size(channel, float(seen_mean(c.absolutes[:, i]))),
        )
        for i, channel in enumerate(d.evidence.channels)
    }
    first = d.ranking[0]
    # an effect that is named has a single probability: that of the answer
    named = {k.effect.label: k.figures for k in d.answer.causes} if d.answer and d.cause else {}
    label, labels = c.label, [a.label for a in c.attached]
    parameters = {
        f"{item}:{name}" if len(labels) > 1 else name: value
        for item in labels
        for name, value in _parameters(c, item).items()
    }
    alike = named.get(labels[0]) if set(labels) <= set(named) else None
    figures = alike or features(d.comparison, c, d.budget.baseline, d.ranking)
    return result.Candidate(
        effect=label,
        family=c.family,
        port=c.group,
        probability=0.0 if d.silent else probability(figures),
        held_out=held,
        removes=removed,
        behind=0.0 if c is first else d.comparison.removed(first, c).z,
        shrinkage=share,
        low=low,
        high=high,
        converged=c.fit.converged,
        why=c.fit.why,
        parameters=parameters,
        at_bound=at_bounds(c, d.settings),
        figures=figures,
        set_aside=d.set_aside.get(c.label, ()),
    )


# ---- how far -------------------------------------------------------------------------------------


def _how_far(d: Diagnosis, i: int) -> result.Reach:
    """Errors of a channel on windows that had no part in the choice, in the column's unit."""
    channel, b = d.evidence.channels[i], d.budget
    rows, left = ~np.isnan(b.floor[:, i]), d.reported(d.cause or b.baseline)
    before, after = b.baseline.absolutes[rows, i], left[rows, i]
    share, low, high = 0.0, -NORMAL_95, 1.0
    if len(before) > 1:
        share, low, high = error_removed(before, after, d.seed)
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


def transfer(d: Diagnosis) -> tuple[result.Transfer, ...]:
    """Errors under new conditions, cross-validated.

    Each held-out recording whose conditions differ from all fitted recordings has an entry.
    """
    if d.cause is None:
        return ()
    transfers, at, before, after = [], 0, d.budget.baseline.absolutes, d.reported(d.cause)
    for span, replay in zip(d.evidence.held_out, d.budget.baseline.replays, strict=True):
        rows = np.arange(at, at + len(replay.windows))
        at += len(replay.windows)
        new = differences(d, span)
        if not new or not len(rows):
            continue
        errors = {
            channel: (before[rows, i].mean(), after[rows, i].mean())
            for i, channel in enumerate(d.evidence.channels)
            if channel in span.recording.values
        }
        channels = {
            channel: result.ChannelTransfer(
                mae_refitted=column_size(channel, was),
                mae_with_cause=column_size(channel, now),
                shrinkage=float(1.0 - now / was),
            )
            for channel, (was, now) in errors.items()
        }
        recording = span.recording.sha256[:12]
        transfers.append(result.Transfer(recording=recording, differs=new, **channels))
    return tuple(transfers)


def differences(d: Diagnosis, span: Span) -> dict[str, Any]:
    """Conditions that no fitted recording had: known values, loop, controller, amplitude."""
    fitted = [s.recording for s in d.evidence.fit]
    recording = span.recording
    new: dict[str, Any] = {
        k: v for k, v in recording.known.items() if all(r.known.get(k) != v for r in fitted)
    }
    if all(r.loop != recording.loop for r in fitted):
        new["loop"] = recording.loop
    if recording.controller and all(r.controller != recording.controller for r in fitted):
        new["controller"] = {
            k: v
            for k, v in recording.controller.items()
            if all(r.controller.get(k) != v for r in fitted)
        }
    channel = next(
        (c for c in d.evidence.channels if all(c in r.values for r in (recording, *fitted))), None
    )
    if channel is None:
        return new
    spread = recording.values[channel][span.start : span.stop].std()
    ratios = [
        spread / max(s.recording.values[channel][s.start : s.stop].std(), 1e-300)
        for s in d.evidence.fit
    ]
    if all(not 1.0 / AMPLITUDE_FACTOR < r < AMPLITUDE_FACTOR for r in ratios):
        new["amplitude"] = float(min(ratios, key=lambda r: abs(np.log(max(r, 1e-300)))))
    return new


# ---- parameters ----------------------------------------------------------------------------------


def _background(d: Diagnosis, final: CandidateModel) -> dict[str, result.Pull]:
    """Pull of every background term, and a share of the data sheet's gap in proportion to its
    squared pull."""
    pulls = background_pull(final.fit)
    sheet, refitted = np.nansum(d.budget.data_sheet), np.nansum(d.budget.baseline.absolutes)
    gained = max(0.0, 1.0 - refitted / sheet) if sheet > 0 else 0.0
    # strains and pulls are in prior deviations, and their squares what the priors cost
    everything = sum(
        (e.strain or 0.0) ** 2 for b, e in estimates(final.fit).items() if not b.owner
    ) + sum(v**2 for v in pulls.values())
    return {
        k: result.Pull(pull=v, share_of_gap=gained * v**2 / everything if everything > 0 else 0.0)
        for k, v in pulls.items()
    }


def _parameters(c: CandidateModel, label: str) -> dict[str, result.Estimate]:
    """Parameters of an effect of a model, by name with unit: what was fitted, and amounts that
    were read off the recordings."""
    fitted = {
        b.name: result.Estimate(value=e.value, low=e.low, high=e.high, unit=e.unit, word=e.word)
        for b, e in estimates(c.fit).items()
        if b.owner == label
    }
    read_off = {
        b.name: result.Estimate(
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
