"""From a raw log and a mapping to recordings: every column in its unit, on one even time base,
between the gaps."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pamid.base.errors import DataError, FileError
from pamid.base.metrics import FloatArray
from pamid.ingest.channels import Log
from pamid.ingest.clocks import Clock, SampledColumn, channel_of, clocks_of
from pamid.ingest.mapping import Mapping, settle, unknown_to
from pamid.ingest.memory_budget import MemoryBudget
from pamid.ingest.resampling import COARSER, hold, smooth
from pamid.ingest.time_base import GAP_PERIODS
from pamid.model.rig import Rig
from pamid.recording.recording import MIN_SAMPLES

NOMINAL = 1e-3  # a clock and a stated period that differ by less name the same sampling
#: significant digits of a round number of s or Hz -> how close to it a measured period is meant so
ROUND = {1: NOMINAL, 2: NOMINAL, 3: 2e-4}
CELL_TEXT = 40  # bytes of a sample on its way into a file
FINER = 100  # times the rows of the log: more samples are not made of them
Stretch = tuple[float, float]  # from, to: s by the log's clock


@dataclass(frozen=True, eq=False)
class ColumnPieces:
    """A column between its gaps: (instants in s, values) of each piece, without the empty cells."""

    clock: Clock
    course: SampledColumn
    pieces: list[tuple[FloatArray, FloatArray]]

    @property
    def filled(self) -> int:
        """Empty cells inside its pieces."""
        if self.clock.found is None:
            return 0
        instants = self.clock.base.instants
        inside = (np.searchsorted(instants, (t[0], t[-1])) for t, _ in self.pieces)
        return int(sum(1 + last - first for first, last in inside)) - sum(
            t.size for t, _ in self.pieces
        )

    def coarser(self, step: float) -> bool:
        """True if samples `step` s apart are fewer than the column has, so that it is filtered
        first."""
        steps = np.diff(self.pieces[0][0]) if self.pieces else np.zeros(0)
        return (
            not self.course.signal.hold
            and steps.size > 0
            and step > COARSER * float(np.median(steps))
        )


@dataclass(frozen=True, eq=False)
class MadeRecording:
    """One recording: time (n,) s from 0, columns by full name, and where in the log it begins: s by
    the log's clock, and the row of the leading clock."""

    time: FloatArray
    columns: dict[str, FloatArray]
    begins_s: float
    first_row: int


@dataclass(frozen=True, eq=False)
class Conversion:
    """The recordings made from one log, and how: sampling period (s), seconds of the log's clock
    per second of the recordings, the clock whose samples they keep, all clocks and columns, and
    what the user should know."""

    log: Log
    mapping: Mapping
    recordings: tuple[MadeRecording, ...]
    period: float
    stretch: float
    lead: Clock
    clocks: tuple[Clock, ...]
    tracks: dict[str, ColumnPieces]
    notes: tuple[str, ...]


def convert(
    log: Log, mapping: Mapping, rig: Rig | None, where: str, repair: str = ""
) -> Conversion:
    """Make recordings of a log. `where` names the mapping in errors; `repair` overrules its [time]
    repair.

    FileError for what is wrong with log or mapping, DataError where the data do not decide how to
    mend the time base or too little is left.
    """
    channels = [
        channel_of(log, signal.source, f"{where}: signals.{column}.source")
        for column, signal in mapping.signals.items()
    ]
    signals = settle(mapping, rig, {channel.name: channel.unit for channel in channels}, where)
    clocks = clocks_of(log, mapping, signals, rig, where, repair)
    lead = _lead(clocks)
    period, stretch = _period(mapping.time.period_s, lead)
    tracks = {
        course.signal.column: ColumnPieces(
            clock, course, _pieces(clock, course, mapping.time.max_gap_s)
        )
        for clock in clocks
        for course in clock.sampled
    }
    tracks = {column: tracks[column] for column in mapping.signals}
    recordings, short, budget = [], 0, MemoryBudget(log.path)
    for start, end in _common(tracks, period * stretch):
        if (end - start) / (period * stretch) > FINER * lead.rows.stamps.size:
            raise FileError(
                f"{where}: {(end - start) / period:.3g} samples of {period:g} s would be made of "
                f"{lead.rows.stamps.size} rows.",
                "Correct time.period_s, time.unit or time.max_gap_s.",
                code="mapping",
            )
        cells = round((end - start) / (period * stretch)) * (1 + len(tracks))
        budget.charge("its recordings", cells, raw=CELL_TEXT * cells)
        one = _recording(tracks, lead, start, end, period, stretch)
        if one.time.size < MIN_SAMPLES:
            short += 1
        else:
            recordings.append(one)
    if not recordings:
        raise DataError(
            f"{log.path}: nowhere are all channels there for {MIN_SAMPLES} samples in a row.",
            "Leave out the channel that is hardly there, or allow longer gaps with time.max_gap_s.",
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
    """The clock whose samples the recording keeps: that of commands if it has them, else that of
    most columns."""
    sampled = [clock for clock in clocks if clock.found is not None]
    if not sampled:
        raise FileError(
            "No measured signal is mapped: there is nothing to make a recording of.",
            "Map at least one measured signal.",
            code="mapping",
        )
    return max(
        sampled,
        key=lambda c: (any(one.signal.hold for one in c.sampled), len(c.sampled), -c.base.period),
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
    """The round number of s or Hz that a measured period (s) must mean, or itself to 9 digits."""
    for digits, within in ROUND.items():
        for value in (float(f"{measured:.{digits}g}"), 1.0 / float(f"{1.0 / measured:.{digits}g}")):
            if abs(value / measured - 1.0) < within:
                return value
    return float(f"{measured:.9g}")


def _pieces(
    clock: Clock, course: SampledColumn, max_gap: float | None
) -> list[tuple[FloatArray, FloatArray]]:
    pieces = []
    for piece in clock.base.pieces:
        there = np.isfinite(course.values[piece])
        t, y = clock.base.instants[piece][there], course.values[piece][there]
        if late := course.signal.rows:  # a value that was logged late belongs to an earlier row
            t, y = (t[:-late], y[late:]) if late > 0 else (t[-late:], y[:late])
        steps = np.diff(t)
        # a slow channel in a fast table is not full of gaps
        usual = 1.5 * float(np.median(steps)) if steps.size else 0.0
        limit = max(usual, GAP_PERIODS * clock.base.period if max_gap is None else max_gap)
        longer = (
            []
            if course.signal.hold and course.signal.events
            else (np.flatnonzero(steps > limit) + 1).tolist()
        )
        pieces += [
            (t[a:b], y[a:b])
            for a, b in zip([0, *longer], [*longer, t.size], strict=True)
            if b - a > 1 or (clock.found is None and b > a)
        ]
    return pieces


def _common(tracks: dict[str, ColumnPieces], step: float) -> list[Stretch]:
    """The stretches in which every column is there."""
    common = [(-math.inf, math.inf)]
    for track in tracks.values():
        if track.clock.found is None:
            own = [(float(t[0]), math.inf) for t, _ in track.pieces[:1]]
        else:
            last = step if track.course.signal.hold else 0.0
            own = [(float(t[0]), float(t[-1]) + last) for t, _ in track.pieces]
        common = _overlap(common, own)
    return common


def _overlap(items: list[Stretch], other: list[Stretch]) -> list[Stretch]:
    """Intersection of two ordered lists of stretches."""
    both, i, j = [], 0, 0
    while i < len(items) and j < len(other):
        begin, end = max(items[i][0], other[j][0]), min(items[i][1], other[j][1])
        if begin < end:
            both.append((begin, end))
        if items[i][1] < other[j][1]:
            i += 1
        else:
            j += 1
    return both


def _recording(
    tracks: dict[str, ColumnPieces],
    lead: Clock,
    start: float,
    end: float,
    period: float,
    stretch: float,
) -> MadeRecording:
    """All columns between start and end (s, by the log's clock), on the samples of the leading
    clock."""
    step, instants = period * stretch, lead.base.instants
    first = min(int(np.searchsorted(instants, start - 1e-6 * step)), instants.size - 1)
    begin = max(float(instants[first]), start - 1e-6 * step)
    count = max(int(math.floor((end - begin) / step + 1e-6)) + 1, 0)
    base: FloatArray = begin + np.arange(count, dtype=np.float64) * step
    columns = {column: _on(base, step, track) for column, track in tracks.items()}
    return MadeRecording(
        np.arange(count, dtype=np.float64) * period, columns, begin, int(lead.rows.keep[first])
    )


def _on(base: FloatArray, step: float, track: ColumnPieces) -> FloatArray:
    """A column at the samples `base`, from the piece of it that covers them."""
    if not base.size:
        return base
    begun = bisect_right(track.pieces, base[0] + 0.5 * step, key=lambda piece: float(piece[0][0]))
    return (hold if track.course.signal.hold else smooth)(*track.pieces[begun - 1], base, step)
