"""Warnings to read before believing a figure; they are never suppressed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from pamid.base.metrics import motion
from pamid.base.share_words import percent_text
from pamid.base.units import NONE, split_column
from pamid.checks.row_order import OF_THE_LOG, misplaced_readings
from pamid.diagnosis.input_response import idle_inputs
from pamid.diagnosis.pipeline import Diagnosis
from pamid.diagnosis.ranges import at_bounds
from pamid.estimation.identifiable_combinations import reported_parameters
from pamid.estimation.intervals import background_pull
from pamid.estimation.lagged_linear import lagged_share
from pamid.estimation.observed_sizes import ports_without_size
from pamid.estimation.problem import Fit
from pamid.model.between_samples import HELD, LINEAR, between_of, other
from pamid.model.no_place import no_place_words, no_places
from pamid.model.port_guide import driving_words, stated_roughness
from pamid.model.registry import effects, rigs
from pamid.recording.recording import match_column
from pamid.schemas.diagnosis_file import Reach, Remainder
from pamid.simulation.input_effects import IDLE_CURE
from pamid.simulation.tracks import noise_remarks
from pamid.verdict.verdict_words import joined

FEW_WINDOWS = 12  # with fewer held out a note says so
# an effect looks like what stands far off if it takes so many tolerances off it; so many are named
EASED, EASING_MOST = 0.5, 3
ONE_SAMPLE = 0.05  # sampling periods by which a delay of one may be off
# errors with the causes of a channel that no model explains: of the data sheet's, in noise floors
UNEXPLAINED_ERROR, ABOVE_NOISE = 0.9, 10.0
UNUSED_LISTED, UNUSED_TRIED = 6, 24  # recorded columns without a place in the rig
ROUGH_SHARE = 0.05  # of what passes: ordinary maps are rough by no more


def remark(d: Diagnosis) -> str:
    """Fault of the recordings, or of how they were read, for which no verdict is possible."""
    if not d.silent:
        return ""
    channels, one = joined(d.silent, "and"), len(d.silent) == 1
    moving = (
        name
        for name in d.evidence.rig.inputs
        if any(r.has(name) and np.ptp(r.signal(name)) > 0.0 for r in d.evidence.recordings)
    )
    sent = joined(moving, "or")
    if d.response is None:
        shown = f"The model predicts {channels} no better than the mean or a straight line does."
    elif d.response.is_reversed:
        shown = (
            f"{channels} {'precedes' if one else 'precede'} {sent}: the rows seem to be in reverse "
            "order of time."
        )
    else:
        hardly = not d.response.absent.any()
        respond = ("responds" if one else "respond") if hardly else "respond"
        negation = "hardly" if hardly else f"{'does' if one else 'do'} not"
        shown = (
            f"{channels} {negation} {respond} to {sent}: the model predicts no better with the "
            "recorded input than without it."
        )
    rest = (
        " Without it the others can be diagnosed."
        if len(d.silent) < len(d.evidence.channels)
        else ""
    )
    return (
        f"The recordings do not show this machine. {shown} Check that every column is the channel "
        "in its name, that one clock recorded all of them, and that the input acted on the rig."
        f"{rest}"
    )


def notes_of(d: Diagnosis) -> list[str]:
    """Sentences, the most important first."""
    kinds = (
        _form,
        _signs,
        _unused,
        _idle,
        _instead,
        _set_aside,
        _between,
        _row_order,
        _no_place,
        _windows,
        _split,
        _fits,
        _bounds,
        _background,
        _strained,
        _sizes,
        _noise_and_background,
        _left_out,
    )
    return [note for of_kind in kinds for note in of_kind(d)]


def unexplained(reached: Mapping[str, Reach]) -> list[str]:
    """A sentence per channel that no model explains: with the causes its error is that of the data
    sheet, and far above the noise floor. reached: by channel."""
    return [
        f"No model explains {channel}: with the causes it is off by {reach.mae_with_cause:.3g}"
        f"{_in_unit(channel)}, with the data sheet by {reach.mae_data_sheet:.3g}, where the noise "
        f"makes {reach.noise_floor:.2g}. Check its unit, its sign and its place before anything "
        "else: `pamid check` compares it with the rig."
        for channel, reach in reached.items()
        if reach.mae_with_cause is not None
        and reach.mae_data_sheet is not None
        and reach.noise_floor is not None
        and reach.mae_with_cause > UNEXPLAINED_ERROR * reach.mae_data_sheet
        and reach.mae_with_cause > ABOVE_NOISE * reach.noise_floor
    ]


def _in_unit(channel: str) -> str:
    symbol = split_column(channel)[1]
    return "" if symbol == NONE else f" {symbol}"


def _form(d: Diagnosis) -> list[str]:
    """Why a model file is run as equations or stepped, where the recordings decided it."""
    return list(filter(None, [d.evidence.rig.form_note]))


def _signs(d: Diagnosis) -> list[str]:
    return driving_words(d.evidence.rig) + [
        f"{c.attached[-1].label} ends at nothing, but the same with the opposite sign removes "
        f"{100.0 * removed:.0f} % of the error: check the sign of port {c.attached[-1].ports[0]} "
        "against its position and velocity. A force that opposes the motion lowers the value "
        "there; of a reaction that is read, pass its negative."
        for c, removed in d.opposite[:1]
    ]


def _unused(d: Diagnosis) -> list[str]:
    """Recorded columns that move and are not part of the rig, and which of them a lagged regression
    finds in what remains."""
    rig = d.evidence.rig
    known = (*rig.inputs, *rig.outputs, *(q.reference for q in rig.loops))
    names = dict[str, float]()
    for r in d.evidence.recordings:
        used = {match_column(r.columns, name) for name in known}
        names |= {c: 0.0 for c, x in r.columns.items() if c not in used and motion(x) > 0.0}
    if not names:
        return []
    shares = {name: _share_of_remainder(d, name) for name in list(names)[:UNUSED_TRIED]}
    listed = joined(list(names)[:UNUSED_LISTED], "and")
    more = f" and {len(names) - UNUSED_LISTED} more" * (len(names) > UNUSED_LISTED)
    notes = [f"Recorded, but not part of the rig: {listed}{more}."]
    name, (channel, share) = max(shares.items(), key=lambda item: item[1][1])
    if share > 0.0:
        notes[0] += (
            f" A lagged regression on {name} explains {percent_text(share)} of the remaining "
            f"error of {channel}. If it acts on the machine, make it an input of the rig."
        )
    return notes


def _share_of_remainder(d: Diagnosis, column: str) -> tuple[str, float]:
    """The channel of whose remaining error a lagged regression on a recorded column removes the
    largest share, and this share."""
    final, evidence = d.cause or d.budget.baseline, d.evidence
    held_out = [(r.track, r.residual) for r in final.replays]
    fitted = [
        (t, -left) for t, left in zip(final.fit.problem.tracks, final.fit.residuals, strict=True)
    ]
    spans = (*evidence.held_out, *evidence.fit)
    best = "", 0.0
    for place, channel in enumerate(evidence.channels):
        parts = []
        for (track, left), span in zip((*held_out, *fitted), spans, strict=True):
            if track.seen[place] and column in span.recording.columns:
                values = span.recording.columns[column][track.first : track.first + len(track)]
                parts.append((left[:, place], values, track.period_s))
        share = lagged_share(parts, evidence.timescale_s) if parts else 0.0
        if share > best[1]:
            best = channel, share
    return best


def _idle(d: Diagnosis) -> list[str]:
    """Inputs whose term in the equations moves no output."""
    final, e = d.cause or d.budget.baseline, d.evidence
    return [f"{text}. {IDLE_CURE}" for text in idle_inputs(final, e.channels, e.noise)]


def _instead(d: Diagnosis) -> list[str]:
    """Families that do as well in the place of a cause, next to the others."""
    if d.answer is None or d.verdict == "ambiguous":
        return []
    return [
        f"An effect of the family {' or '.join(c.instead)} does as well in the place of "
        f"{c.effect.label}."
        for c in d.answer.causes
        if c.instead
    ]


def _set_aside(d: Diagnosis) -> list[str]:
    """Candidates that would have led, and the physical reason against them."""
    if d.silent:
        return []
    best = d.cause or d.budget.baseline
    ahead = [c for c in d.ranking if d.comparison.is_material(c, best)]
    return [
        f"{c.label} removes {percent_text(d.comparison.removed(c).share)} of the gap and is set "
        f"aside: {'; '.join(why)}."
        for c in ahead
        if len(c.attached) >= len(best.attached) and (why := d.set_aside.get(c.label))
    ][:1]


def _between(d: Diagnosis) -> list[str]:
    """Readings that are half a sampling period early, or commands that are as late: what an input
    that is taken for held, or for linear between samples, makes of a model."""
    if d.answer is None:
        return []
    model, rig = d.answer.model, d.evidence.rig
    period_s = max(r.sampling_period_s for r in d.evidence.recordings)
    notes = []
    for b, late in zip(model.assembly.parameters, model.fit.p, strict=True):
        if not b.owner or b.unit != "s" or round(abs(late) / period_s, 1) != 0.5:
            continue
        way = HELD if late < 0.0 else LINEAR
        names = [name for name in rig.inputs if between_of(rig, name) == way]
        if names:
            notes.append(
                f"{b.owner} comes to half a sampling period. This is what you see if an input is "
                f"treated as {way} between samples but is {other(way)}. If {names[0]} is, state it "
                f'in the rig (between = {{"{names[0]}": "{other(way)}"}}) and diagnose again.'
            )
    return notes


def _row_order(d: Diagnosis) -> list[str]:
    """Readings in another row than their own, and delays of one sampling period, which a log makes
    by itself. The log of the first recording stands for the others."""
    if d.answer is None or d.verdict == "no-structural-gap":
        return []
    rig, recording = d.evidence.rig, d.evidence.recordings[0]
    orders = misplaced_readings(recording, rig)
    readings = {name for name, port in rig.ports.items() if port.kind == "reading"}
    model, period_s = d.answer.model, max(r.sampling_period_s for r in d.evidence.recordings)
    ports = {a.label: a.ports[0] for a in model.attached}
    return [f"{order.text(recording)} Then diagnose again." for order in orders] + [
        f"{b.owner} comes to {abs(late) / period_s:.2f} sampling periods: {OF_THE_LOG}. A row "
        "holds a command that acts from the next row on, or a reading of the row before. Move that "
        "column by one row (`rows` in the mapping of `pamid ingest`) and diagnose again."
        for b, late in zip(model.assembly.parameters, model.fit.p, strict=True)
        if b.key.endswith((":delay", ":start"))
        and abs(abs(late) / period_s - 1.0) < ONE_SAMPLE
        and not (orders and ports.get(b.owner) in readings)
    ]


def _no_place(d: Diagnosis) -> list[str]:
    """Common effects that the rig has no place for, where the answer leaves something open."""
    if d.answer is None or d.verdict == "explained":
        return []
    rig = d.evidence.rig
    return [
        f"{rig.name} has {no_place_words(q)}." for q in no_places(rig, effects().values(), rigs())
    ]


def _windows(d: Diagnosis) -> list[str]:
    count = len(d.half)
    if count >= FEW_WINDOWS:
        return []
    cure = (
        "Hold out longer recordings, or more of them."
        if d.evidence.whole_held_out
        else "Record for longer, or hold out another recording: --held-out."
    )
    return [
        f"The answer rests on {count} held-out windows; {FEW_WINDOWS} or more make it stable. "
        f"{cure}"
    ]


def _split(d: Diagnosis) -> list[str]:
    if d.evidence.held_out_rests:
        how = "" if d.evidence.whole_held_out else ": --held-out"
        return [
            "The held-out part moves by less than a quarter of the fitted one, so that only small "
            f"signals are tested. Hold out a recording that moves as much{how}."
        ]
    used_s, all_s = d.evidence.used_s
    excerpt = [
        f"Of {all_s:.4g} s of recordings {used_s:.4g} s were used, in evenly spread stretches. "
        "An effect that acts only in the rest is not seen: diagnose that part by itself."
    ]
    return excerpt * (used_s < 0.99 * all_s) + [
        f"{r.name} is at rest for a part of its length: three tenths spread over it were held out, "
        "not its last three. A separate recording is a better test: --held-out."
        for r in d.evidence.spread
    ]


def _fits(d: Diagnosis) -> list[str]:
    notes = []
    base = d.budget.baseline.fit
    if not base.converged:
        notes.append(
            f"The refit of the model itself did not converge ({base.why}): the gap may be smaller "
            "than reported."
        )
    if d.budget.model.remark:
        notes.append(d.budget.model.remark)
    if d.cause is not None and not d.cause.fit.converged:
        notes.append(f"The fit with the cause did not converge ({d.cause.fit.why}).")
    return notes


def _bounds(d: Diagnosis) -> list[str]:
    named = d.cause or (d.ranking[0] if d.ranking else None)
    held = at_bounds(named, d.settings) if named is not None else ()
    if named is None or not held:
        return []
    return [
        f"{', '.join(held)} of {named.attached[-1].label} ended at a bound that was widened "
        "before: the effect may have another form."
    ]


def _background(d: Diagnosis) -> list[str]:
    """Background terms that stand as far off as they may: a muscle that is stronger than its twin
    bends a force map, too."""
    return [
        f"Background {term} stands at {pull:.1f} tolerances: "
        f"{like or 'no effect of the ranking takes that up; the tolerance may be too tight'}."
        for term, pull, like in _far_off(d, background_pull)
    ]


def _strained(d: Diagnosis) -> list[str]:
    """Parameters of the rig that the refit has moved far: the data sheet is wrong, or they take up
    what is missing."""
    return [
        f"{name} was moved {strain:.1f} standard deviations of its prior: "
        f"{like or 'no effect of the ranking brings it back; the data sheet may be wrong there'}."
        for name, strain, like in _far_off(d, _strains)
    ]


def _strains(fitted: Fit) -> dict[str, float]:
    return {b.name: e.strain or 0.0 for b, e in reported_parameters(fitted).items() if not b.owner}


def _far_off(
    d: Diagnosis, off: Callable[[Fit], dict[str, float]]
) -> Iterator[tuple[str, float, str]]:
    """Parameters of the reported model that are far off, their distance, and the effects that would
    explain it ("" where there are none)."""
    final = d.cause or d.budget.baseline
    far = {name: size for name, size in off(final.fit).items() if size >= d.settings.far_off}
    named = {a.label for a in final.attached}
    others = [c for c in d.ranking if not named & {a.label for a in c.attached}] if far else []
    eased = {c.label: off(c.fit) for c in others}
    for name, size in far.items():
        like = [
            f"{label} (with it {now[name]:.1f})"
            for label, now in eased.items()
            if now.get(name, size) <= size - EASED
        ][:EASING_MOST]
        yield name, size, f"{' or '.join(like)} would look like this" if like else ""


def roughness(d: Diagnosis, rest: Remainder | None) -> list[str]:
    """Where what is left is no more than a rough map leaves, and the rig states none: that."""
    rig, most = d.evidence.rig, ROUGH_SHARE
    if rest is None or not rest.real or rest.missing_rms is None or not rest.passing_rms:
        return []
    share = rest.missing_rms / rest.passing_rms
    stated = {rig.group_of(port) for port in rig.background}
    if share > most or rest.port in stated:
        return []
    ports = [name for name in rig.ports if rig.group_of(name) == rest.port]
    return [
        f"What is missing at port {rest.port} is {percent_text(share)} of what passes there, and a "
        f"map that is rough by as much would look alike. If yours may be, state it in the rig, "
        f"{stated_roughness(rig, *ports)}, and diagnose again."
    ]


def _left_out(d: Diagnosis) -> list[str]:
    """Candidates without a signal, by the reason."""
    by_reason: dict[str, list[str]] = {}
    for label, reason in d.left_out:
        by_reason.setdefault(reason, []).append(label)
    return [
        f"Not considered, because {reason}: {', '.join(labels)}."
        for reason, labels in by_reason.items()
    ]


def _sizes(d: Diagnosis) -> list[str]:
    bare = ports_without_size(d.evidence, d.budget.sizes)
    if not bare:
        return []
    which = f"port {bare[0]}" if len(bare) == 1 else f"ports {', '.join(bare)}"
    return [
        f"Nothing passes {which} in these recordings: effects there are sized by 1 SI unit. State "
        'Port(size={"value": ...}).'
    ]


def _noise_and_background(d: Diagnosis) -> list[str]:
    """Channels whose noise in fits and floors is not what the rig or the samples suggest, and
    background terms that these recordings do not need."""
    e = d.evidence
    noise = [r.text for r in noise_remarks(e.rig, e.recordings, e.channels)]
    return [f"{text}." for text in (*noise, *(term.text for term in e.left_out))]
