"""Warnings to read before believing a figure; they are never suppressed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from pamid.base.errors import join_words
from pamid.base.metrics import motion
from pamid.base.schemas.diagnosis_file import Reach, Remainder
from pamid.base.share_words import percent_text
from pamid.base.units import NONE, split_column
from pamid.diagnosis.input_response import idle_inputs
from pamid.diagnosis.pipeline import Diagnosis
from pamid.diagnosis.ranges import at_bounds
from pamid.estimation.identifiable_combinations import reported_parameters
from pamid.estimation.intervals import background_pull
from pamid.estimation.lagged_linear import lagged_share
from pamid.estimation.observed_sizes import ports_without_size
from pamid.estimation.problem import Fit
from pamid.intake.checks.sampling_slips import OF_THE_LOG, misplaced_readings
from pamid.model.between_samples import HELD, LINEAR, between_of, other
from pamid.model.no_place import no_place_words, no_places
from pamid.model.port_guide import driving_words, stated_roughness
from pamid.model.registry import effects, rigs
from pamid.simulation.input_effects import IDLE_CURE
from pamid.simulation.tracks import noise_remarks

FEW_WINDOWS = 12  # held-out windows; a note warns about fewer
# tolerances by which an effect must relieve a strained parameter, and number of effects to list
EASED, EASING_MOST = 0.5, 3
PERIOD_TOLERANCE = 0.05  # sampling periods by which a delay of a period may be off
# errors with the causes of a channel that no model explains: of the data sheet's, in noise floors
UNEXPLAINED_ERROR, ABOVE_NOISE = 0.9, 10.0
UNUSED_LISTED, UNUSED_TRIED = 6, 24  # recorded columns without a place in the rig
ROUGH_SHARE = 0.05  # of what passes: ordinary maps are rough by no more


def remark(d: Diagnosis) -> str:
    """Fault of the recordings or of their conversion that makes a verdict impossible."""
    if not d.silent:
        return ""
    channels, single = join_words(d.silent), len(d.silent) == 1
    moving = (
        name
        for name in d.evidence.rig.inputs
        if any(name in r.values and np.ptp(r.values[name]) > 0.0 for r in d.evidence.recordings)
    )
    sent = join_words(moving, "or")
    if d.response is None:
        shown = f"The model predicts {channels} no better than the mean or a straight line does."
    elif d.response.is_reversed and len(d.silent) == len(d.evidence.channels):
        # A feedback controller also acts after the outputs. Channels that the model predicts show
        # that time runs forward.
        shown = (
            f"{channels} {'precedes' if single else 'precede'} {sent}: the rows are probably in "
            "reverse order of time."
        )
    else:
        hardly = not d.response.absent.any()
        respond = ("responds" if single else "respond") if hardly else "respond"
        negation = "hardly" if hardly else f"{'does' if single else 'do'} not"
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
        "in its name, that a single clock recorded all of them, and that the input acted on the "
        "rig."
        f"{rest}"
    )


def notes_of(d: Diagnosis) -> list[str]:
    """Sentences, the most important first."""
    e, rig, final = d.evidence, d.evidence.rig, d.cause or d.budget.baseline
    is_incomplete = d.answer is not None and d.verdict != "explained"
    missing_ports = no_places(rig, effects().values(), rigs()) if is_incomplete else ()
    noise = (r.text for r in noise_remarks(rig, e.recordings, e.channels))
    by_reason: dict[str, list[str]] = {}
    for label, reason in d.left_out:
        by_reason.setdefault(reason, []).append(label)
    return [
        *filter(None, [rig.form_note]),
        *driving_words(rig),
        *(
            f"{c.attached[-1].label} vanishes in the fit, but with the opposite sign it removes "
            f"{100.0 * removed:.0f} % of the error. Check the sign of port "
            f"{c.attached[-1].ports[0]} against its position and velocity: a force that opposes "
            "the motion must lower the value there. If the port reads a reaction, pass its "
            "negative."
            for c, removed in d.opposite[:1]
        ),
        *_unused(d),
        *(f"{text}. {IDLE_CURE}" for text in idle_inputs(final, e.channels, e.noise)),
        *_instead(d),
        *_set_aside(d),
        *_between(d),
        *_row_order(d),
        *(f"{rig.name} has {no_place_words(q)}." for q in missing_ports),
        *_windows(d),
        *_fits(d),
        *_sizes(d),
        *(f"{text}." for text in (*noise, *(term.text for term in e.left_out))),
        *(
            f"Not considered, because {reason}: {', '.join(labels)}."
            for reason, labels in by_reason.items()
        ),
    ]


def unexplained(reached: Mapping[str, Reach]) -> list[str]:
    """A sentence per channel that no model explains.

    Its error with the causes is about that of the data sheet, and far above the noise floor.
    reached: errors by channel.
    """
    units = {channel: split_column(channel)[1] for channel in reached}
    return [
        f"No model explains {channel}: its error is {reach.mae_with_cause:.3g}"
        f"{'' if units[channel] == NONE else f' {units[channel]}'} with the causes "
        f"and {reach.mae_data_sheet:.3g} with the data sheet; the noise "
        f"floor is {reach.noise_floor:.2g}. First check its unit, its sign and its place: `pamid "
        "check` compares the channel with the rig."
        for channel, reach in reached.items()
        if reach.mae_with_cause is not None
        and reach.mae_data_sheet is not None
        and reach.noise_floor is not None
        and reach.mae_with_cause > UNEXPLAINED_ERROR * reach.mae_data_sheet
        and reach.mae_with_cause > ABOVE_NOISE * reach.noise_floor
    ]


def _unused(d: Diagnosis) -> list[str]:
    """Recorded columns outside the rig that move, and the column that a lagged regression finds in
    the remaining error."""
    moving = (c for r in d.evidence.recordings for c in r.unused if motion(r.columns[c]) > 0.0)
    names = list(dict.fromkeys(moving))
    if not names:
        return []
    shares = {name: _share_of_remainder(d, name) for name in names[:UNUSED_TRIED]}
    listed = join_words(names[:UNUSED_LISTED])
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
    """Largest share of a channel's remaining error that a lagged regression on a recorded column
    removes, with that channel."""
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


def _instead(d: Diagnosis) -> list[str]:
    """Families that fit as well in place of a cause, together with the other causes."""
    if d.answer is None or d.verdict == "ambiguous":
        return []
    return [
        f"An effect of the family {' or '.join(c.instead)} fits equally well in place of "
        f"{c.effect.label}."
        for c in d.answer.causes
        if c.instead
    ]


def _set_aside(d: Diagnosis) -> list[str]:
    """Candidates that were better than the answer, and the physical reason against them."""
    if d.silent:
        return []
    best = d.cause or d.budget.baseline
    ahead = [c for c in d.ranking if d.comparison.is_material(c, best)]
    return [
        f"{c.label} removes {percent_text(d.comparison.removed(c).share)} of the gap, but was "
        f"rejected: {'; '.join(why)}."
        for c in ahead
        if len(c.attached) >= len(best.attached) and (why := d.set_aside.get(c.label))
    ][:1]


def _between(d: Diagnosis) -> list[str]:
    """Readings that are early, or commands that are late, by half a sampling period: the sign of an
    input that is wrongly treated as held, or as linear, between samples."""
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
                f"{b.owner} is half a sampling period. This is what you see if an input is "
                f"treated as {way} between samples but is {other(way)}. If {names[0]} is "
                f'{other(way)}, state between = {{"{names[0]}": "{other(way)}"}} in the rig and '
                "diagnose again."
            )
    return notes


def _row_order(d: Diagnosis) -> list[str]:
    """Readings in a wrong row, and delays of a sampling period, which may come from the log.

    Only the log of the first recording is examined, because the others have the same format.
    """
    if d.answer is None or d.verdict == "no-structural-gap":
        return []
    rig, recording = d.evidence.rig, d.evidence.recordings[0]
    orders = misplaced_readings(recording, rig)
    readings = {name for name, port in rig.ports.items() if port.kind == "reading"}
    model, period_s = d.answer.model, max(r.sampling_period_s for r in d.evidence.recordings)
    ports = {a.label: a.ports[0] for a in model.attached}
    return [f"{order.text(recording)} Then diagnose again." for order in orders] + [
        f"{b.owner} is {abs(late) / period_s:.2f} sampling periods: {OF_THE_LOG}. A row contains "
        "a command that acts from the next row on, or the reading of the row before. Shift that "
        "column by a row (`rows` in the mapping of `pamid ingest`) and diagnose again."
        for b, late in zip(model.assembly.parameters, model.fit.p, strict=True)
        if b.key.endswith((":delay", ":start"))
        and abs(abs(late) / period_s - 1.0) < PERIOD_TOLERANCE
        and not (orders and ports.get(b.owner) in readings)
    ]


def _windows(d: Diagnosis) -> list[str]:
    """Held-out windows that are few, or that move less than the rest of the recordings."""
    notes, whole = [], d.evidence.whole_held_out
    if len(d.half) < FEW_WINDOWS:
        cure = (
            "Hold out longer recordings, or more of them."
            if whole
            else "Record for longer, or hold out another recording: --held-out."
        )
        notes.append(
            f"The answer rests on {len(d.half)} held-out windows; {FEW_WINDOWS} or more make it "
            f"stable. {cure}"
        )
    if d.evidence.held_out_rests:
        return [
            *notes,
            "The held-out part moves by less than a quarter of the fitted part, so only small "
            "signals are tested. Hold out a recording that moves as much"
            f"{'' if whole else ': --held-out'}.",
        ]
    used_s, all_s = d.evidence.used_s
    if used_s < 0.99 * all_s:
        notes.append(
            f"Of {all_s:.4g} s of recordings {used_s:.4g} s were used, in evenly spread stretches. "
            "An effect that acts only elsewhere is missed: diagnose that part separately."
        )
    return notes + [
        f"{r.name} is at rest for part of its length: 30 % in several parts were held out, not the "
        "last 30 %. A separate recording is a better test: --held-out."
        for r in d.evidence.spread
    ]


def _fits(d: Diagnosis) -> list[str]:
    """Fits that did not converge, and parameters at a bound or far from their expectation."""
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
    named = d.cause or (d.ranking[0] if d.ranking else None)
    if named is not None and (held := at_bounds(named, d.settings)):
        notes.append(
            f"{', '.join(held)} of {named.attached[-1].label} ended at a bound that had been "
            "widened: the effect may have another form."
        )
    notes += [
        f"Tolerance {term} was moved by {pull:.1f} of its standard deviations: "
        f"{like or 'no effect of the ranking explains that; the tolerance may be too tight'}."
        for term, pull, like in _far_off(d, background_pull)
    ]

    # a parameter far from its prior compensates a missing effect, if the data sheet is right
    def strains(fitted: Fit) -> dict[str, float]:
        parameters = reported_parameters(fitted).items()
        return {b.name: e.strain or 0.0 for b, e in parameters if not b.owner}

    return notes + [
        f"{name} was moved {strain:.1f} standard deviations of its prior: "
        f"{like or 'no effect of the ranking explains that; the data sheet may be wrong'}."
        for name, strain, like in _far_off(d, strains)
    ]


def _far_off(
    d: Diagnosis, off: Callable[[Fit], dict[str, float]]
) -> Iterator[tuple[str, float, str]]:
    """Parameters of the reported model far from their expectation, the distance, and the effects
    that would explain it ("" without any)."""
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
    """Note that an unstated roughness of a map would explain the remainder, if it is small
    enough."""
    rig, most = d.evidence.rig, ROUGH_SHARE
    if rest is None or not rest.real or rest.missing_rms is None or not rest.passing_rms:
        return []
    share = rest.missing_rms / rest.passing_rms
    stated = {rig.group_of(port) for port in rig.background}
    if share > most or rest.port in stated:
        return []
    ports = [name for name in rig.ports if rig.group_of(name) == rest.port]
    return [
        f"The missing value at port {rest.port} is {percent_text(share)} of the total value there. "
        "A map with the same roughness would look alike. If the map of your machine may be that "
        f"rough, state {stated_roughness(rig, *ports)} in the rig and diagnose again."
    ]


def _sizes(d: Diagnosis) -> list[str]:
    bare = ports_without_size(d.evidence, d.budget.sizes)
    if not bare:
        return []
    which = f"port {bare[0]}" if len(bare) == 1 else f"ports {', '.join(bare)}"
    return [
        f"The value at {which} is zero in these recordings, so effects there are scaled by 1 SI "
        'unit. State Port(size={"value": ...}).'
    ]
