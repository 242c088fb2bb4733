"""Conversion of a raw log by a mapping: recordings between the gaps, each on an even time base.

Signals are resampled by their kind: commands and references are held; measured signals are
interpolated smoothly, and filtered first if the new time base is coarser.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError
from pamid.intake.logs.channels import Log
from pamid.intake.logs.clocks import Clock, SampledColumn, clocks_of
from pamid.intake.logs.mapping import Mapping, resolved_signals, unknown_to
from pamid.intake.logs.memory_budget import MemoryBudget
from pamid.intake.logs.time_base import GAP_PERIODS
from pamid.model.rig import Rig
from pamid.recording.recording import MIN_SAMPLES

NOMINAL = 1e-3  # largest relative difference of a clock and the stated period of the same sampling
#: significant digits of a round number of s or Hz -> relative distance at which a period is rounded
ROUND = {1: NOMINAL, 2: NOMINAL, 3: 2e-4}
CELL_TEXT = 40  # bytes of a sample while a file is written
FINER = 100  # largest number of samples per row of the log
COARSER = 1.01  # ratio of new to old period from which on the filter is needed
HALF_TAPS = 30  # taps of the filter on either side, per ratio of new to old period
FILTER_WINDOW = ("kaiser", 8.0)  # pass-band ripple of 1e-4
SAME_INSTANT = 1e-6  # of a period: largest distance of an instant from the sample that it equals
Stretch = tuple[float, float]  # from, to: s by the log's clock


@dataclass(frozen=True, eq=False)
class ColumnPieces:
    """Pieces of a column between its gaps: (instants in s, values), without empty cells."""

    clock: Clock
    course: SampledColumn
    pieces: list[tuple[Array, Array]]

    @property
    def filled(self) -> int:
        """Empty cells inside its pieces."""
        if self.clock.diagnosis is None:
            return 0
        instants = self.clock.base.instants
        inside = (np.searchsorted(instants, (t[0], t[-1])) for t, _ in self.pieces)
        return int(sum(1 + last - first for first, last in inside)) - sum(
            t.size for t, _ in self.pieces
        )

    def coarser(self, step: float) -> bool:
        """Whether a period of `step` s is longer than that of the column, which needs a filter."""
        steps = np.diff(self.pieces[0][0]) if self.pieces else np.zeros(0)
        if self.course.signal.hold or not steps.size:
            return False
        return step > COARSER * float(np.median(steps))


@dataclass(frozen=True, eq=False)
class ConvertedRecording:
    """A recording: time (n,) s from 0, columns by full name, and its beginning in the log, as s
    of the log's clock and as a row of the leading clock."""

    time: Array
    columns: dict[str, Array]
    begins_s: float
    first_row: int


@dataclass(frozen=True, eq=False)
class Conversion:
    """Recordings from a log, and their derivation.

    period    sampling period, s
    stretch   seconds of the log's clock per second of the recordings
    lead      clock whose samples the recordings keep
    tracks    columns by name
    """

    log: Log
    mapping: Mapping
    recordings: tuple[ConvertedRecording, ...]
    period: float
    stretch: float
    lead: Clock
    clocks: tuple[Clock, ...]
    tracks: dict[str, ColumnPieces]
    notes: tuple[str, ...]


def convert(
    log: Log, mapping: Mapping, rig: Rig | None, where: str, repair: str = ""
) -> Conversion:
    """Convert a log to recordings.

    where: name of the mapping in errors. repair: overrides its [time] repair. Raises FileError for
    a fault of log or mapping, DataError if the data do not determine the repair of the time base,
    or if too few samples are left.
    """
    units = {
        signal.source: log.channel(signal.source, f"{where}: signals.{column}.source").unit
        for column, signal in mapping.signals.items()
    }
    signals = resolved_signals(mapping, rig, units, where)
    clocks = clocks_of(log, mapping, signals, rig, where, repair)
    lead = _lead(clocks)
    period, stretch = _period(mapping.time.period_s, lead)
    columns = {
        course.signal.column: ColumnPieces(
            clock, course, _pieces(clock, course, mapping.time.max_gap_s)
        )
        for clock in clocks
        for course in clock.sampled
    }
    tracks = {column: columns[column] for column in mapping.signals}
    recordings, short, budget = [], 0, MemoryBudget(log.path)
    for start, end in _common(tracks, period * stretch):
        if (end - start) / (period * stretch) > FINER * lead.rows.stamps.size:
            raise FileError(
                f"{where}: {lead.rows.stamps.size} rows would become {(end - start) / period:.3g} "
                f"samples with a period of {period:g} s.",
                "Correct time.period_s, time.unit or time.max_gap_s.",
                code="mapping",
            )
        cells = round((end - start) / (period * stretch)) * (1 + len(tracks))
        budget.charge("its recordings", cells, raw=CELL_TEXT * cells)
        recording = _recording(tracks, lead, (start, end), period, stretch)
        short += recording.time.size < MIN_SAMPLES
        recordings += [recording] if recording.time.size >= MIN_SAMPLES else []
    if not recordings:
        raise DataError(
            f"{log.path}: no stretch of {MIN_SAMPLES} samples has values of all channels.",
            "Leave out the channel with few values, or allow longer gaps with time.max_gap_s.",
            code="too-short",
        )
    notes = [note for clock in clocks for note in clock.notes]
    if short:
        notes.append(
            f"{short} stretches of fewer than {MIN_SAMPLES} samples between gaps were left out"
        )
    notes += unknown_to(rig, mapping.signals) if rig else []
    return Conversion(
        log, mapping, tuple(recordings), period, stretch, lead, clocks, tracks, tuple(notes)
    )


def _lead(clocks: Sequence[Clock]) -> Clock:
    """Clock whose samples the recording keeps: that of commands, if any, else that of most
    columns."""
    sampled = [clock for clock in clocks if clock.diagnosis is not None]
    if not sampled:
        raise FileError(
            "No measured signal is mapped, so there is nothing to record.",
            "Map a measured signal.",
            code="mapping",
        )
    return max(
        sampled,
        key=lambda c: (any(s.signal.hold for s in c.sampled), len(c.sampled), -c.base.period),
    )


def _period(stated: float | None, lead: Clock) -> tuple[float, float]:
    """(sampling period of the recording in s, seconds of the log's clock per second of the
    recording).

    A log whose clock runs a little fast is not resampled for that: its samples are the recording's.
    """
    measured = lead.base.period
    stated = round_period(measured) if stated is None else stated
    if lead.cure == "jittered-sampling":  # resampled anyway, by the log's clock
        return stated, 1.0
    for factor in (max(round(stated / measured), 1), 1.0 / max(round(measured / stated), 1)):
        stretch = measured * factor / stated
        if abs(stretch - 1.0) < NOMINAL:
            return stated, stretch
    return stated, 1.0


def round_period(measured: float) -> float:
    """Nearest round number of s or Hz to a measured period (s), or the period to 9 digits."""
    for digits, within in ROUND.items():
        for value in (float(f"{measured:.{digits}g}"), 1.0 / float(f"{1.0 / measured:.{digits}g}")):
            if abs(value / measured - 1.0) < within:
                return value
    return float(f"{measured:.9g}")


def _pieces(
    clock: Clock, course: SampledColumn, max_gap: float | None
) -> list[tuple[Array, Array]]:
    pieces = []
    for piece in clock.base.pieces:
        there = np.isfinite(course.values[piece])
        t, y = clock.base.instants[piece][there], course.values[piece][there]
        if late := course.signal.stated.rows:  # a value logged late belongs to an earlier row
            t, y = (t[:-late], y[late:]) if late > 0 else (t[-late:], y[:late])
        steps = np.diff(t)
        # a slow channel in a fast table has many empty rows, which are not gaps
        usual = 1.5 * float(np.median(steps)) if steps.size else 0.0
        limit = max(usual, GAP_PERIODS * clock.base.period if max_gap is None else max_gap)
        longer: list[int] = (np.flatnonzero(steps > limit) + 1).tolist()
        longer = [] if course.signal.hold and course.signal.events else longer
        pieces += [
            (t[a:b], y[a:b])
            for a, b in zip([0, *longer], [*longer, t.size], strict=True)
            if b - a > 1 or (clock.diagnosis is None and b > a)
        ]
    return pieces


def _common(tracks: dict[str, ColumnPieces], step: float) -> list[Stretch]:
    """Stretches in which every column has values."""
    common = [(-math.inf, math.inf)]
    for track in tracks.values():
        if track.clock.diagnosis is None:
            covered = [(float(t[0]), math.inf) for t, _ in track.pieces[:1]]
        else:
            last = step if track.course.signal.hold else 0.0
            covered = [(float(t[0]), float(t[-1]) + last) for t, _ in track.pieces]
        # intersection of two ordered lists of stretches
        both, i, j = [], 0, 0
        while i < len(common) and j < len(covered):
            begin, end = max(common[i][0], covered[j][0]), min(common[i][1], covered[j][1])
            if begin < end:
                both.append((begin, end))
            if common[i][1] < covered[j][1]:
                i += 1
            else:
                j += 1
        common = both
    return common


def _recording(
    tracks: dict[str, ColumnPieces], lead: Clock, part: Stretch, period: float, stretch: float
) -> ConvertedRecording:
    """Recording of all columns in a part of the log, on the samples of the leading clock."""
    (start, end), step, instants = part, period * stretch, lead.base.instants
    first = min(int(np.searchsorted(instants, start - 1e-6 * step)), instants.size - 1)
    begin = max(float(instants[first]), start - 1e-6 * step)
    count = max(int(math.floor((end - begin) / step + 1e-6)) + 1, 0)
    base: Array = begin + np.arange(count, dtype=np.float64) * step
    columns = {column: base for column in tracks}
    for column, track in tracks.items() if count else ():
        # the piece that covers the samples
        begun = bisect_right(track.pieces, begin + 0.5 * step, key=lambda piece: float(piece[0][0]))
        resample = hold if track.course.signal.hold else smooth
        columns[column] = resample(*track.pieces[begun - 1], base, step)
    time = np.arange(count, dtype=np.float64) * period
    return ConvertedRecording(time, columns, begin, int(lead.rows.keep[first]))


# ---- resampling ----------------------------------------------------------------------------------


def hold(instants: Array, values: Array, base: Array, step: float) -> Array:
    """Zero-order hold: the value in the middle of each sample of `base` (n,), of length `step` (s).

    The value at the beginning would be a sample late if it was logged slightly late. instants
    (m,) rising, s; values (m,) without NaN. Before the first instant the first value is used.
    """
    index = np.searchsorted(instants, base + 0.5 * step, side="right") - 1
    return values[np.maximum(index, 0)]


def smooth(instants: Array, values: Array, base: Array, step: float) -> Array:
    """Measured signal at `base` (n,) by monotone cubic interpolation (PCHIP); exact at samples.

    If `step` (s) is longer than the period of the signal, a zero-phase low-pass at the new Nyquist
    frequency is applied first. instants (m,) rising, s, at least two; values (m,) without NaN.
    """
    from scipy.interpolate import PchipInterpolator

    # the median step of bursts with pauses is far below the mean spacing of samples
    period = max(float(np.median(np.diff(instants))), 0.2 * float(np.mean(np.diff(instants))))
    if step > COARSER * period:
        from scipy.signal import firwin, oaconvolve

        count = int(round((instants[-1] - instants[0]) / period)) + 1
        even = np.linspace(instants[0], instants[-1], count)
        if count != instants.size or np.abs(even - instants).max() > SAME_INSTANT * period:
            values = np.asarray(PchipInterpolator(instants, values)(even))
        reach = min(int(HALF_TAPS * step / period), count - 1)
        taps = firwin(2 * reach + 1, min(period / step, 0.99), window=FILTER_WINDOW)
        # odd reflection about the ends, so that a slope continues there
        before, after = (
            2.0 * values[0] - values[reach:0:-1],
            2.0 * values[-1] - values[-2 : -reach - 2 : -1],
        )
        wide = np.concatenate([before, values, after])
        instants, values = even, np.asarray(oaconvolve(wide, taps, mode="valid"))
    resampled = np.asarray(
        PchipInterpolator(instants, values)(np.clip(base, instants[0], instants[-1]))
    )
    nearest = np.clip(np.searchsorted(instants, base - 0.5 * period), 0, instants.size - 1)
    same = np.abs(instants[nearest] - base) <= SAME_INSTANT * period
    resampled[same] = values[nearest[same]]
    return resampled
