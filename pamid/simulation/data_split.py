"""Division of recordings: parameters are fitted on a first part, and effects are chosen on a
second. Results are reported on a third part, which neither the fit nor the choice has used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError
from pamid.base.metrics import motion, seen_mean
from pamid.model.assembly import Assembly
from pamid.model.between_samples import as_recorded
from pamid.model.rig import Rig
from pamid.model.sampling import as_sampled
from pamid.recording.noise import noise_level
from pamid.recording.overlap import require_apart
from pamid.recording.recording import Recording
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.error_growth import growth_time_s
from pamid.simulation.free_runs import free_run, known_values, state_spread
from pamid.simulation.idle_background import IdleTerm, without_idle_terms
from pamid.simulation.replay import Replay
from pamid.simulation.rig_data import Data, data_of
from pamid.simulation.tracks import Track, noise_of, stated_noise, track_of

# samples of an independent stretch, that is of a window on which a model is scored
STRETCH_SAMPLES = 20
FEWEST_FITTED, FEWEST_HELD_OUT = 7, 3  # stretches, over all recordings together
# minimum length of a recording that is divided; a shorter recording is fitted or held out as a
# whole
FEWEST_SAMPLES = STRETCH_SAMPLES * (FEWEST_FITTED + FEWEST_HELD_OUT)
# Tenths of a recording that are held out, normally its last three. If a part of the recording is at
# rest, we spread them between fitted ones. The first then is early, while a decaying motion is
# still large.
LAST_TENTHS, SPREAD_TENTHS = (7, 8, 9), (1, 4, 7)
# A part is at rest if every signal moves by less than this share of its motion in the other part,
# as at the end of a step response. Such a part contains almost no information.
QUIET = 0.25
# Correlation times simulated before a held-out part to estimate its initial state. A model with
# permanent memory is simulated from the beginning of the recording.
LEAD = 10.0
# length of a fit window and of the shortest replay window, in correlation times
FIT_WINDOW, REPLAY_WINDOW = 2.5, 1.7
# minimum number of windows if an envelope sets their length, and minimum number to fit in any case
FEW_WINDOWS, LEAST_WINDOWS = 12, 6
DEALS = 64  # random divisions of the held-out windows that are tried
ALIKE_DIGITS = 9  # decimals to which sort keys and imbalances are compared
VISIBLE = 3.0  # multiple of the noise above which a signal moves
# share of the motion in the first half below which the second half counts as decayed
DECAYED = 0.5
# possible error of a model in an unmeasured state per window, as a share of the state's spread
STATE_JUMP = 0.01
STRETCHES = 3  # number of stretches taken from a long span
# minimum length of a stretch, in correlation times: 8 fit windows, 16 full-length replay windows
LEAST_FITTED, LEAST_HELD_OUT = 20.0, 61.0


@dataclass(frozen=True)
class Span:
    """Samples start..stop of a recording."""

    recording: Data
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def seconds(self) -> float:
        return len(self) * self.recording.sampling_period_s


@dataclass(frozen=True)
class DataSplit:
    """Recordings of a rig, divided into a fitted and a held-out part.

    channels: outputs that are both fitted and held out, and that move in a recording; noise: their
    white noise (SI); jump: possible deviation of the rig's states from their prediction by the
    previous window (SI); timescale_s: correlation time, limited by the length of the recordings and
    by the growth of state errors, the unit of all horizons; correlation_s: correlation time without
    these limits, the unit of the time constants of effects.
    """

    rig: Rig
    fit: tuple[Span, ...]
    held_out: tuple[Span, ...]
    channels: tuple[str, ...]
    noise: Array
    jump: Array
    timescale_s: float
    correlation_s: float
    lead_most: float = np.inf  # maximum lead-in of models with memories, in correlation times
    per_run: int = 1  # held-out windows that a model predicts from an estimated state
    left_out: tuple[
        IdleTerm, ...
    ] = ()  # background terms that the fitted recordings cannot determine
    doubts: tuple[str, ...] = ()  # sentences: faults of the recordings that a fit may absorb

    def tracks(self, assembly: Assembly, held_out: bool = False) -> tuple[Track, ...]:
        """Return the tracks for this assembly, with the known parameters of each recording held.

        A held-out track begins with lead-in samples, from which its initial state is estimated.
        """
        tracks, spans = list[Track](), self.held_out if held_out else self.fit
        samples = sum(map(len, spans))
        for span in spans:
            lead = 0
            if held_out:
                scale = self.timescale_s / span.recording.sampling_period_s
                most = self.lead_most * scale if assembly.keeps_memories else round(LEAD * scale)
                lead = int(min(span.start, most))
            first = span.start - lead
            p, known = known_values(assembly, span.recording.known)
            # Models with the same inputs share these arrays, which otherwise would take most of the
            # memory.
            inputs = (assembly.traced.inputs, *assembly.rig.optional.items())
            key = id(span.recording), first, span.stop, inputs
            if key not in self._samples:
                # The arrays come from a slice, so that the rest of a long recording can be freed.
                part = span.recording.slice(first, span.stop)
                self._samples[key] = part.inputs(assembly), part.outputs(self.channels)
            track = Track(
                span.recording.name,
                *self._samples[key],
                p,
                tuple(known),
                span.recording.sampling_period_s,
                self.jump,
                self.timescale_s,
                first,
                lead,
                len(span) / samples,
            )
            tracks.append(track)
        return tuple(tracks)

    @cached_property
    def _samples(self) -> dict[tuple[object, ...], tuple[Array, Array]]:
        return {}

    def excerpt(self, fitted: float, held_out: float) -> DataSplit:
        """Return a split with evenly spread stretches of long recordings.

        The cost of a search then does not grow with the recordings. Every sample of a stretch has
        its full weight, so gradients, covariances and errors are those of a shorter recording.
        Thinning the rows of the Jacobian instead would save a quarter of a step at most, because
        sensitivities are a recursion over all samples. A thinned J'r approximates the full gradient
        only if the residuals are smooth. The residuals of a correct model are not.

        fitted, held_out: maximum total length of these parts, in correlation times.
        """
        held = _stretches(self.held_out, held_out, LEAST_HELD_OUT, self.timescale_s)
        return replace(
            self,
            fit=_stretches(self.fit, fitted, LEAST_FITTED, self.timescale_s),
            held_out=held,
            lead_most=np.inf if held is self.held_out else fitted / STRETCHES,
        )

    @property
    def used_s(self) -> tuple[float, float]:
        """Duration of the fitted and held-out spans together, and of all recordings (s)."""
        spans = (*self.fit, *self.held_out)
        used = sum(s.seconds for s in spans)
        return used, sum(len(r) * r.sampling_period_s for r in self.recordings)

    @cached_property
    def still_inputs(self) -> frozenset[str]:
        """Inputs of the rig that are 0 in all recordings. A missing optional input has its default
        value."""
        assembly = Assembly(self.rig)
        varies = np.zeros(len(assembly.traced.inputs), bool)
        for recording in self.recordings:
            varies |= (recording.inputs(assembly) != 0.0).any(axis=0)
        return frozenset(
            name for name, moves in zip(assembly.traced.inputs, varies, strict=True) if not moves
        )

    def lacking(self, recording: Data) -> list[str]:
        """Channels that are missing in this recording and present in another."""
        return [c for c in self.channels if c not in recording.values]

    @property
    def held_out_rests(self) -> bool:
        """Whether all channels hardly move in the held-out part, compared with the fitted part."""
        motions = [(_motion(self.held_out, c), _motion(self.fit, c)) for c in self.channels]
        return all(in_held_out < QUIET * in_fitted for in_held_out, in_fitted in motions)

    @property
    def whole_held_out(self) -> bool:
        """Whether no recording is divided into a fitted and a held-out part."""
        return not {id(s.recording) for s in self.fit} & {id(s.recording) for s in self.held_out}

    @property
    def spread(self) -> list[Data]:
        """Recordings whose held-out tenths are spread over them instead of at their end."""
        last = {id(s.recording): s.stop for s in self.held_out}
        return [r for r in self.recordings if last.get(id(r), len(r)) < len(r)]

    @property
    def recordings(self) -> list[Data]:
        return list({id(s.recording): s.recording for s in (*self.fit, *self.held_out)}.values())


def split_recordings(rig: Rig, recordings: list[Recording], held_out: list[Recording]) -> DataSplit:
    """Divide recordings into a fitted and a held-out part.

    Without `held_out`, the last 30 % of every recording are held out. If that part or the rest
    hardly moves, three tenths spread over the recording are held out instead. Of episodes shorter
    than `FEWEST_SAMPLES`, three of ten are held out as a whole.

    held_out: recordings that are held out as a whole; may be empty.

    Raises
    ------
    DataError
        The recordings are too short in total, nothing moves, or two contain the same samples. A
        single input or channel may be at rest if another moves.
    FileError
        No output is both fitted and held out, or a recording has none of these outputs.
    """
    raw = [*recordings, *held_out]
    rig = as_sampled(as_recorded(rig, raw), [r.sampling_period_s for r in raw])
    plain = Assembly(rig)
    require_apart(tuple(rig.outputs), recordings, held_out)
    every_recording = [data_of(rig, r) for r in raw]
    pooled, separate = every_recording[: len(recordings)], every_recording[len(recordings) :]
    measured = {id(r): r.measured(rig) for r in every_recording}
    channels = tuple(
        c
        for c in rig.outputs
        if all(any(c in measured[id(r)] for r in role) for role in (pooled, separate or pooled))
    )
    if not channels:
        raise FileError(
            "no measured output is both fitted and held out",
            f"rig {rig.name!r} offers {', '.join(rig.outputs)}",
        )
    for r in every_recording:
        if not any(c in measured[id(r)] for c in channels):
            raise FileError(
                f"{r.path} contains no channel that is fitted and held out: {', '.join(channels)}",
                "leave it out, or hold out a recording that has the same sensors",
            )
    moving: set[str] = set()
    for r in every_recording:
        moving |= require_informative(rig, r)
    channels = tuple(c for c in channels if c in moving)
    # Sort by content: the last digit of a sum depends on its order, so file names must not set it.
    # The mean time of the motion does not depend on units, signs, order or unused columns.
    sort_keys = {}
    for r in every_recording:
        total = 0.0
        for name in sorted({*rig.inputs, *rig.outputs}):
            if (values := r.values.get(name)) is not None:
                squares = (values - values.mean()) ** 2
                peak = float(squares.max())
                if peak > 0.0:
                    squares = squares / peak
                    total += float(np.linspace(0.0, 1.0, len(squares)) @ squares / squares.sum())
        sort_keys[id(r)] = round(total, ALIKE_DIGITS), r.sha256
    if separate:
        fit_spans = [Span(r, 0, len(r)) for r in pooled]
        held_out_spans = [Span(r, 0, len(r)) for r in separate]
    else:
        fit_spans, held_out_spans = list[Span](), list[Span]()
        pooled.sort(key=lambda r: sort_keys[id(r)])
        for recording in pooled:
            if len(recording) >= FEWEST_SAMPLES:
                fitted, held_out_part = _parts(rig, recording)
                fit_spans += fitted
                held_out_spans += held_out_part
        # a third of a short episode is shorter than a window
        episodes = [Span(r, 0, len(r)) for r in pooled if len(r) < FEWEST_SAMPLES]
        for number, episode in enumerate(episodes):
            (held_out_spans if number % 10 in SPREAD_TENTHS else fit_spans).append(episode)
    reason = shortfall(list(map(len, fit_spans)), list(map(len, held_out_spans)))
    if reason:
        raise DataError(
            f"{', '.join(str(r.path) for r in every_recording)}: {reason}",
            "Record longer or add recordings: they are fitted together. At a sampling period of "
            "3 ms, 20 s or more are recommended.",
        )
    by_content = sorted(every_recording, key=lambda r: sort_keys[id(r)])

    def in_order(spans: list[Span]) -> tuple[Span, ...]:
        return tuple(sorted(spans, key=lambda s: (*sort_keys[id(s.recording)], s.start)))

    stated = stated_noise(rig, channels)
    # the time scale is computed from these tracks: 1 s is a placeholder
    whole_tracks = [track_of(plain, r, channels, timescale_s=1.0) for r in by_content]
    noise = np.sqrt(seen_mean(np.stack([noise_of((t,), stated) ** 2 for t in whole_tracks])))
    spreads = np.stack([state_spread(plain, r) for r in by_content])
    finite = np.isfinite(spreads)
    count = finite.sum(axis=0)
    squares = (np.where(finite, spreads, 0.0) ** 2).sum(axis=0) / np.maximum(count, 1)
    jump = STATE_JUMP * np.where(count, np.sqrt(squares), np.inf)
    tables = [(t.y, noise, t.period_s) for t in whole_tracks]
    # The time scale must leave enough windows to fit. If an envelope sets it, both parts must keep
    # enough windows.
    fitted_s, held_out_s = (sum(s.seconds for s in part) for part in (fit_spans, held_out_spans))
    ringing_s = min(fitted_s / FIT_WINDOW, held_out_s / REPLAY_WINDOW) / FEW_WINDOWS
    timescale_s = rig.timescale_s or timescale_of(
        tables, fitted_s / FIT_WINDOW / LEAST_WINDOWS, ringing_s
    )
    growth_s = growth_time_s(
        Assembly(rig, outputs=channels), whole_tracks, noise, FIT_WINDOW * timescale_s
    )
    rig, left_out = without_idle_terms(rig, [s.recording.slice(s.start, s.stop) for s in fit_spans])
    return DataSplit(
        rig,
        in_order(fit_spans),
        in_order(held_out_spans),
        channels,
        noise,
        jump,
        min(timescale_s, growth_s / FIT_WINDOW),
        rig.timescale_s or max(timescale_s, timescale_of(tables, most_ringing_s=0.0)),
        left_out=left_out,
    )


def shortfall(fit: Sequence[int], held_out: Sequence[int]) -> str:
    """Return why the data are too short to fit and judge a model; empty if they suffice.

    The criterion is the number of independent stretches over all recordings. fit, held_out: number
    of samples of each span.
    """
    roles = (fit, FEWEST_FITTED), (held_out, FEWEST_HELD_OUT)
    if all(sum(n // STRETCH_SAMPLES for n in spans) >= fewest for spans, fewest in roles):
        return ""
    fitted, judged = (sum(spans) for spans, _ in roles)
    return (
        f"{fitted} fitted and {judged} held-out samples are too few to fit and judge a model. At "
        f"least {FEWEST_FITTED * STRETCH_SAMPLES} and {FEWEST_HELD_OUT * STRETCH_SAMPLES} are "
        f"needed, in stretches of {STRETCH_SAMPLES} or more"
    )


def shortfall_alone(recording: Recording) -> str:
    """Return why a recording alone is too short to fit and judge a model; empty if it suffices."""
    return shortfall([len(recording)], []) if len(recording) < FEWEST_SAMPLES else ""


def _parts(rig: Rig, recording: Data) -> tuple[list[Span], list[Span]]:
    """Fitted and held-out spans of a recording."""
    edges = [round(k / 10 * len(recording)) for k in range(11)]
    names = [name for name in (*rig.inputs, *rig.outputs) if name in recording.values]
    table = np.stack([recording.values[name] for name in names], axis=1)
    moving = table.std(axis=0) > VISIBLE * noise_level(table)
    edge = edges[LAST_TENTHS[0]]
    before, after = table[:edge, moving].std(axis=0), table[edge:, moving].std(axis=0)
    # all moving signals are at rest in either part, compared with the other
    at_rest = moving.any() and ((after < QUIET * before).all() or (before < QUIET * after).all())
    held_out = SPREAD_TENTHS if at_rest else LAST_TENTHS
    spans: dict[bool, list[Span]] = {False: [], True: []}
    for is_held, tenths in groupby(range(10), held_out.__contains__):
        tenth_spans = list(tenths)
        spans[is_held].append(Span(recording, edges[tenth_spans[0]], edges[tenth_spans[-1] + 1]))
    return spans[False], spans[True]


def _stretches(
    spans: tuple[Span, ...], most: float, least: float, timescale_s: float
) -> tuple[Span, ...]:
    """Return evenly spread stretches of these spans.

    most: maximum total length; least: minimum length of a stretch; both in correlation times. A
    span that is too short for a stretch stays whole.
    """
    times = [s.seconds / timescale_s for s in spans]
    share = most / sum(times)
    if share >= 1.0:
        return spans
    stretches: list[Span] = []
    for s, long in zip(spans, times, strict=True):
        number = min(STRETCHES, int(share * long / least))
        if number == 0:
            stretches.append(s)
            continue
        length = int(share * len(s)) // number
        for first in np.linspace(s.start, s.stop - length, number).astype(int).tolist():
            stretches.append(Span(s.recording, first, first + length))
    return tuple(stretches)


def _motion(spans: Sequence[Span], channel: str) -> float:
    """Standard deviation of a channel (SI), pooled over the spans that recorded it."""
    recorded = [s for s in spans if channel in s.recording.values]
    parts = [s.recording.values[channel][s.start : s.stop] for s in recorded]
    count = sum(map(len, parts))
    return float(np.sqrt(sum(len(y) * y.var() for y in parts) / count)) if count else 0.0


def require_informative(rig: Rig, recording: Data) -> set[str]:
    """Return the outputs that change in this recording.

    Raises
    ------
    DataError
        No output changes. Or no input changes while the outputs keep moving, which is neither a
        decay nor reproduced by the data-sheet model.
    """
    inputs = [n for n in rig.inputs if n in recording.values]
    moving, constant_output = _moving(recording, [n for n in rig.outputs if n in recording.values])
    if not moving and constant_output is not None:
        raise constant_output
    moving_inputs, constant_input = _moving(recording, inputs)
    needed = [name for name in inputs if name not in rig.optional]
    if (
        needed
        and not moving_inputs
        and constant_input is not None
        and not _shows_free_response(rig, recording, sorted(moving))
    ):
        raise constant_input
    return moving


def _moving(recording: Data, names: list[str]) -> tuple[set[str], DataError | None]:
    """Return the signals that change, and an error for the first that does not."""
    moving, error = set(), None
    for name in names:
        if motion(recording.values[name]) > 0.0:
            moving.add(name)
        else:
            error = error or DataError(
                f"{recording.path}: {name} is constant ({recording.shown(name)[0]:g}) throughout.",
                "Record while it moves; `pamid generate-aprbs` makes an excitation that covers the "
                "range.",
                code="not-excited",
            )
    return moving, error


def _shows_free_response(rig: Rig, recording: Data, channels: list[str]) -> bool:
    """Whether motion without input is plausible: it decays, or the data-sheet model also keeps
    moving."""
    assembly = Assembly(rig)
    half = len(recording) // 2
    y = recording.outputs(channels)
    noise = noise_level(y)
    early, late = y[:half].std(axis=0), y[half:].std(axis=0)
    if not (early > VISIBLE * noise).any():
        return False
    if (late < np.maximum(DECAYED * early, VISIBLE * noise)).all():
        return True
    p, _ = known_values(assembly, recording.known)
    run = free_run(assembly, recording.inputs(assembly), p, recording.sampling_period_s)
    places = [assembly.program.outputs.index(c) for c in channels]
    moves = run.outputs[half:, places].std(axis=0)
    return run.blown_up < 0 and bool((moves > VISIBLE * noise).any())


def half_of_windows(replays: list[Replay], losses: Array) -> NDArray[np.bool_]:
    """Return a mask of half of the held-out windows, for two-fold cross-validation.

    Each half is scored with the model that the other half chooses. Of many divisions into halves of
    equal size, we use that with the most similar mean and largest losses. If a transient were in
    a single half, the other half would choose without it. Pairs of neighbouring windows stay
    together.

    replays, losses (windows,): of the model without effects, so that the division does not depend
    on any effect.
    """
    count = sum(len(r.windows) for r in replays)
    # Both halves are spread over all held-out data, so that they have the same conditions. Windows
    # stay in pairs, because the bootstrap also draws them in pairs.
    block_length = 2 if count >= 12 else 1
    blocks = np.arange(count) // block_length
    alternating = blocks % 2 == 0
    block_count = blocks[-1] + 1 if count else 0
    if block_count < 4:
        return alternating
    random = np.random.default_rng(0)
    divisions = [alternating]
    for _ in range(DEALS):
        first = np.zeros(block_count, bool)
        # either of every two neighbouring blocks, so both halves stay spread over the recordings
        for k in range(0, block_count - 1, 2):
            first[k + random.integers(2)] = True
        if block_count % 2:
            first[-1] = True
        divisions.append(first[blocks])

    def imbalance(chosen: NDArray[np.bool_]) -> float:
        first, other = losses[chosen], losses[~chosen]
        error, largest = np.log(first.mean() / other.mean()), np.log(first.max() / other.max())
        return float(abs(error) + 0.5 * abs(largest))

    # Rounded, a division and its swapped halves tie. The first wins, whatever the last digit.
    return min(divisions, key=lambda chosen: round(imbalance(chosen), ALIKE_DIGITS))
