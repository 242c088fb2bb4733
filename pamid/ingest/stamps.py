"""The stamps of a log made usable: repeats, steps of the clock, dropped samples, gaps. Nothing is
judged here; what was found is counted, and `pamid.ingest.time_base` decides what it means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError, FileError
from pamid.base.metrics import FloatArray, runs_of
from pamid.recording.recording import MIN_SAMPLES

IntArray = NDArray[np.int64]

AGES = 1e12  # s: no clock counts so far
FASTEST = 1e-8  # s: no two samples of a rig are so close
# rows: a stamp that comes back later than this is a step of the clock, not a row out of order
OUT_OF_ORDER = 5
MANY_STEPS = 20  # steps back in one log: then the channel is no clock
# share of differing rows with one stamp above which stamps are blocks or ticks, not errors
BLOCK_SHARE = 0.02
ROWS_OF_SLOPE = 4  # rows before and behind rows with one stamp that give the slope there
MOVING = 4.0  # slopes count that exceed their noise by this factor
FEWEST_ADVANCES = 5  # of them that tell samples from readings of one instant
LATE_WINDOW = 100  # rows ahead that are looked at to tell a dropped sample from a late stamp
FOLLOW = 0.02  # share of a deviation by which the even clock follows it, per row
LAST = 5  # rows at the end in which a late stamp cannot be distinguished from a missing one
ROWS_AROUND_STEP = 20  # rows before and behind a step back that tell whether the clock was set back
LACKING = 0.7  # of a period: they lie so much earlier behind it then
DROPPED = 0.7  # of a period: the level of the stamps rises by this where a sample is missing


@dataclass(frozen=True)
class Repair:
    """One kind of thing that was mended: a stable word, how often, and a sentence."""

    what: str
    count: int
    detail: str


@dataclass(frozen=True)
class Rows:
    """The rows that stay, in the order of their stamps.

    keep      rows of the log, (n,)
    stamps    s, (n,), not falling; a clock that was set back runs on
    starts    where pieces begin: 0, and wherever the clock was set back
    blocks    several differing samples share a stamp: buffers, or a clock that ticks slower than
              the sampling
    """

    keep: IntArray
    stamps: FloatArray
    starts: tuple[int, ...]
    blocks: bool
    repairs: tuple[Repair, ...]

    def pieces(self) -> list[slice]:
        """The rows between two settings of the clock."""
        ends = (*self.starts[1:], self.stamps.size)
        return [slice(start, end) for start, end in zip(self.starts, ends, strict=True)]


def usable_rows(stamps: FloatArray, signals: Sequence[FloatArray], place: str) -> Rows:
    """Order and thin the rows of a log. stamps s, (n,); signals (n,) each, which show whether rows
    that share a stamp are several samples or several readings of one; `place` names the channel in
    errors.

    FileError where the channel is no clock; DataError where too few rows have a stamp.
    """
    keep, repairs = _rows_with_stamp(stamps, place)
    keep, stamps, starts, more = _rising(keep, stamps, signals, place)
    repairs += more
    twice = np.flatnonzero(np.diff(stamps[keep]) == 0.0)
    if not twice.size:
        return Rows(keep, stamps[keep], tuple(starts), False, tuple(repairs))
    differing = int(np.count_nonzero(~_written_twice(keep, twice, signals)))
    if differing and _are_samples(stamps[keep], [values[keep] for values in signals], twice):
        if differing > BLOCK_SHARE * keep.size:
            return Rows(keep, stamps[keep], tuple(starts), True, tuple(repairs))
        repairs.append(
            Repair(
                "stamps-shared",
                differing,
                f"{differing} samples share the stamp of the one before and got one between its "
                "neighbours",
            )
        )
        return Rows(keep, _spread(stamps[keep]), tuple(starts), False, tuple(repairs))
    return _one_row_per_stamp(keep, stamps, starts, (twice, differing), repairs, place)


def _one_row_per_stamp(
    keep: IntArray,
    stamps: FloatArray,
    starts: list[int],
    shared: tuple[IntArray, int],
    repairs: list[Repair],
    place: str,
) -> Rows:
    """The last row of every stamp. shared: rows that share their stamp with the next one, and how
    many of them differ from it."""
    twice, differing = shared
    if equal := twice.size - differing:
        repairs.append(
            Repair("rows-repeated", equal, f"{equal} rows stood there twice and were dropped")
        )
    if differing:
        repairs.append(
            Repair(
                "stamps-repeated",
                differing,
                f"{differing} stamps stood there twice, with values of the same instant: the later "
                "row is kept",
            )
        )
    stay = np.ones(keep.size, dtype=bool)
    stay[twice] = False
    if stay.sum() < MIN_SAMPLES:
        raise DataError(
            f"{place}: {stay.sum()} rows have a stamp of their own, at least {MIN_SAMPLES} are "
            "needed.",
            code="too-short",
        )
    moved_starts = tuple(int(stay[:start].sum()) for start in starts)
    return Rows(keep[stay], stamps[keep[stay]], moved_starts, False, tuple(repairs))


def _rows_with_stamp(stamps: FloatArray, place: str) -> tuple[IntArray, list[Repair]]:
    """The rows whose stamp is a time, and a word on the others."""
    finite = np.flatnonzero(np.abs(stamps) < AGES)
    repairs = []
    if finite.size < stamps.size:
        lost = stamps.size - finite.size
        repairs.append(
            Repair("rows-without-stamp", lost, f"{lost} rows without a stamp were left out")
        )
    if finite.size < MIN_SAMPLES:
        raise DataError(
            f"{place}: {finite.size} rows have a stamp, at least {MIN_SAMPLES} are needed.",
            code="too-short",
        )
    return finite, repairs


def _rising(
    written: IntArray, stamps: FloatArray, signals: Sequence[FloatArray], place: str
) -> tuple[IntArray, FloatArray, list[int], list[Repair]]:
    """(rows in an order in which stamps do not fall, the stamps that they then have, where pieces
    begin, what was mended). Either the rows are put back in order or, where the signals say that
    the rows are in order, the late stamps are corrected."""
    repairs = []
    keep, starts, moved = _in_order(written.copy(), stamps, place)
    if moved and _runs_smoothly(written, keep, signals):
        keep, stamps = written, _caught_up(stamps, written, starts)
        repairs.append(
            Repair(
                "stamps-out-of-order",
                moved,
                f"{moved} stamps fall behind the one before; the signals "
                "run smoothly in the order of the rows, so it is the stamps that are late",
            )
        )
    elif moved:
        repairs.append(
            Repair(
                "rows-out-of-order", moved, f"{moved} rows were written out of order and put back"
            )
        )
    if len(starts) > 1:
        back = stamps[keep[list(starts[1:])]] - stamps[keep[np.array(starts[1:]) - 1]]
        steps_back = ", ".join(f"{step:.4g} s" for step in back[:3])
        stamps = _running_on(stamps, keep, starts)
        repairs.append(
            Repair(
                "clock-set-back",
                len(back),
                f"the clock was set back {len(back)} times ({steps_back}): the recording is split "
                "there",
            )
        )
    return keep, stamps, starts, repairs


def _written_twice(
    keep: IntArray, twice: IntArray, signals: Sequence[FloatArray]
) -> NDArray[np.bool_]:
    """Whether a row that shares its stamp with the next one (at these places) equals it in every
    signal."""
    same = np.ones(twice.size, dtype=bool)
    for values in signals:
        before, after = values[keep[twice]], values[keep[twice + 1]]
        same &= (before == after) | (np.isnan(before) & np.isnan(after))
    return same


def _are_samples(stamps: FloatArray, signals: Sequence[FloatArray], twice: IntArray) -> bool:
    """Are rows that share a stamp with the next one (at these places) samples of their own, a
    period apart, or readings of one instant?

    A smooth signal advances from sample to sample by its slope: the steps between such rows are
    regressed on those due by the rows around, c = sum(step due) / sum(due^2), with the standard
    error of White (1980), Econometrica 48(4). c is 1 for samples and 0 for readings of one
    instant. Where no signal moves enough, samples need time: rows that take none are no samples,
    unless most rows share their stamp, as in blocks.
    """
    parts = [_advance(values, twice) for values in signals]
    step, due = (np.concatenate([np.zeros(0), *(part[i] for part in parts)]) for i in (0, 1))
    if step.size >= FEWEST_ADVANCES:
        weight = float(due @ due)
        coefficient = float(step @ due) / weight
        error = float(np.sqrt(np.sum((due * (step - coefficient * due)) ** 2))) / weight
        if abs(coefficient - 0.5) > 2.0 * error:
            return coefficient > 0.5
    return 2 * twice.size > stamps.size or _take_time(stamps)


def _advance(values: FloatArray, twice: IntArray) -> tuple[FloatArray, FloatArray]:
    """(step to the row with the same stamp, step that is due by the rows around), both in units of
    what the signal usually moves, where it moves visibly and the same way on both sides."""
    around = ROWS_OF_SLOPE
    at = twice[(twice > around) & (twice + around + 2 < values.size)]
    bends = np.abs(np.diff(values, 2))
    bends = bends[np.isfinite(bends)]
    if not bends.size:
        return np.zeros(0), np.zeros(0)
    noise = float(np.median(bends)) / 0.6745 / np.sqrt(6.0)  # white noise of 1 bends by sqrt(6)
    before = (values[at - 1] - values[at - 1 - around]) / around
    after = (values[at + 2 + around] - values[at + 2]) / around
    step, due = values[at + 1] - values[at], 0.5 * (before + after)
    moves = (before * after > 0.0) & (np.abs(due) > MOVING * noise / around) & np.isfinite(step)
    step, due = step[moves], due[moves]
    size = float(np.sqrt(np.mean(due**2))) if due.size else 1.0
    return step / size, due / size


def _take_time(stamps: FloatArray) -> bool:
    """Are the stamps around rows that share one as far apart as so many samples need?"""
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0]))
    first, last = runs_of(steps == 0.0)
    inner = (first > 0) & (last < steps.size)
    first, last = first[inner], last[inner]
    if not first.size:
        return False
    spare = (steps[first - 1] + steps[last] - 2.0 * usual) / ((last - first) * usual)
    return float(np.median(spare)) >= 0.5


def _spread(stamps: FloatArray) -> FloatArray:
    """Stamps of samples that share one, moved apart to the side on which there is time, by a period
    at most."""
    spread, steps = stamps.copy(), np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0]))
    for first, last in zip(*runs_of(steps == 0.0), strict=True):
        before = steps[first - 1] if first else 0.0
        after = steps[last] if last < steps.size else 0.0
        apart = min(max(before, after) / (last - first + 1), usual)
        offsets = apart * np.arange(last - first + 1)
        spread[first : last + 1] += offsets if after > before else offsets - offsets[-1]
    return spread


def rough_period(rows: Rows) -> float:
    """The sampling period (s) that most of the log shows, right to a few per mille; gaps and late
    stamps do not move it. DataError if the stamps tell none."""
    steps = np.concatenate([np.diff(rows.stamps[piece]) for piece in rows.pieces()])
    middle = float(np.median(steps)) if steps.size else 0.0
    # a late stamp makes one step longer and the next shorter: leave out both or none
    single = steps[np.abs(steps - middle) < 0.7 * middle]
    if (
        rows.blocks
        or middle <= 0.0
        or abs(float(single.mean()) - middle) > 0.002 * middle
        or np.mean(np.abs(single - middle) <= 0.05 * middle) <= 0.5
    ):
        middle = _period_by_stretches(rows)
    if not FASTEST < middle < AGES / 1e3 or steps.sum() > AGES * middle:
        raise DataError(
            f"The stamps tell no sampling period: most rows are {middle:.3g} s apart.",
            "Is it the channel with the time, and in the right unit?",
            code="time-base",
        )
    return middle


def _period_by_stretches(rows: Rows) -> float:
    """The period (s) over many rows, for steps that vary."""
    longest = max(rows.pieces(), key=lambda piece: piece.stop - piece.start)
    stamps = rows.stamps[longest]
    runs = np.diff(np.flatnonzero(np.diff(stamps) > 0.0), prepend=-1)
    lag = min(max(50, 20 * int(runs.max(initial=1))), max(stamps.size // 2, 1))
    period = float(np.median(stamps[lag:] - stamps[:-lag])) / lag
    return period if rows.blocks or period <= FASTEST else _sharpest(stamps, period)


def count_samples(stamps: FloatArray, period: float) -> IntArray:
    """Which sample of an even clock each row is, (n,), from 0: one more per row, and more where
    samples are missing.

    A late stamp is caught up by later rows; behind a missing sample all rows stay late by whole
    periods. So the lowest of the stamps ahead is held against the even clock, which follows slowly
    for the error of the period (s).
    """
    from scipy.ndimage import minimum_filter1d

    n = stamps.size
    runs = np.diff(np.flatnonzero(np.diff(stamps) > 0.0), prepend=-1)
    window = min(max(LATE_WINDOW, 4 * int(np.median(runs)) if runs.size else 1), n)
    residual = stamps / period - np.arange(n)
    lowest_ahead = minimum_filter1d(residual, window, mode="nearest", origin=-(window // 2))
    # the last rows have nothing behind them that could catch up: where stamps are late at times,
    # they may be late too
    end = n - LAST if float(np.quantile(residual - lowest_ahead, 0.995)) > 0.3 else n
    missing = np.zeros(n, dtype=np.int64)
    # `base` is the even clock: it falls at once to any earlier stamp, rises slowly with drift, and
    # by whole periods where samples are missing. These are missing where the stamp itself jumps.
    level, base, steps = (
        lowest_ahead.tolist(),
        float(lowest_ahead[0]),
        np.diff(residual, prepend=residual[0]),
    )
    for i in range(1, end):
        above = level[i] - base
        if above >= DROPPED:
            lost = int(above + 1.0 - DROPPED)
            missing[i if steps[i] >= DROPPED else i + int(np.argmax(steps[i : i + 10]))] += lost
            base += lost
        else:
            base += FOLLOW * above if above > 0.0 else above
    return np.asarray(np.arange(n) + np.cumsum(missing), dtype=np.int64)


def fit_clock(
    stamps: FloatArray, samples: IntArray, pieces: Sequence[slice]
) -> tuple[float, FloatArray]:
    """(period in s, start of each piece in s) of the even clock through the middle of the stamps,
    by least squares without the latest twentieth of them. Of rows that share a stamp only the last
    counts: it waited least."""
    use = last = np.append(np.diff(stamps) != 0.0, True)
    period, begins = 0.0, np.zeros(len(pieces))
    # one slope for all pieces, each about its own means; which stamps are the latest twentieth is
    # known from the pass before
    for _ in range(3):
        above = below = 0.0
        for piece in pieces:
            k, t = samples[piece][use[piece]].astype(float), stamps[piece][use[piece]]
            if k.size:
                above += float((k - k.mean()) @ (t - t.mean()))
                below += float((k - k.mean()) @ (k - k.mean()))
        if above <= 0.0:
            raise DataError(
                "The stamps follow no even clock: nowhere do rows come one after the other.",
                "Is it the channel with the time, and in the right unit?",
                code="time-base",
            )
        period = above / below
        begins = np.array([float(np.median(stamps[p] - period * samples[p])) for p in pieces])
        late = np.concatenate(
            [stamps[p] - period * samples[p] - b for p, b in zip(pieces, begins, strict=True)]
        )
        use = last & (late <= np.quantile(late[last], 0.95))
    return period, begins


def _sharpest(stamps: FloatArray, period: float) -> float:
    """The period (s) within 4 % of `period` at which the stamps' phases agree best, over stretches
    of 256 rows: samples that are missing do not move a phase."""
    stretch = 256
    count = min(stamps.size // stretch, 40)
    if count == 0:
        return period
    begins = np.linspace(0, stamps.size - stretch, count).astype(int)
    blocks = stamps[begins[:, None] + np.arange(stretch)]
    blocks = blocks - blocks[:, :1]
    trial = period * (1.0 + np.arange(-0.04, 0.04, 0.25 / stretch))
    # squared mean of the phases 2 pi t / T as points on the unit circle: 1 where all stamps of a
    # stretch are multiples of T, about 1/256 where they are scattered
    power = np.array(
        [
            float(np.mean(np.abs(np.exp(2j * np.pi / one * blocks).mean(axis=1)) ** 2))
            for one in trial
        ]
    )
    best = int(np.argmax(power))
    return float(trial[best]) if power[best] > 3.0 * np.median(power) else period


def _in_order(rows: IntArray, stamps: FloatArray, place: str) -> tuple[IntArray, list[int], int]:
    """(rows in order of their stamps, where the clock was set back, how many rows were out of
    order)."""
    times = stamps[rows]
    starts, moved, begin = [0], 0, 0
    usual = float(np.median(np.diff(times)))
    while True:
        tail = times[begin:]
        behind = tail < np.maximum.accumulate(tail)
        steps = (
            int(first)
            for first, last in zip(*runs_of(behind), strict=True)
            if _is_step(tail, int(first), int(last), usual)
        )
        end = begin + next(steps, tail.size)
        order = np.argsort(times[begin:end], kind="stable")
        moved += int(np.count_nonzero(np.diff(times[begin:end]) < 0.0))
        rows[begin:end], times[begin:end] = rows[begin:end][order], times[begin:end][order]
        if end == times.size:
            return rows, starts, moved
        starts.append(end)
        begin = end
        if len(starts) > MANY_STEPS:
            raise FileError(
                f"{place}: the stamps run to and fro ({len(starts)} times and more).",
                "It seems to be no clock: name the channel with the time in [time] source.",
                code="stamps-unsorted",
            )


def _running_on(stamps: FloatArray, keep: IntArray, starts: Sequence[int]) -> FloatArray:
    """The stamps with every piece behind the one before it: how far the clock was set back is not
    known."""
    shifted, pause = stamps.copy(), 10.0 * float(np.median(np.diff(stamps[keep])))
    for start, end in zip(starts[1:], [*starts[2:], keep.size], strict=True):
        rows = keep[start:end]
        shifted[rows] += shifted[keep[start - 1]] + pause - stamps[rows[0]]
    return shifted


def _is_step(times: FloatArray, first: int, last: int, usual: float) -> bool:
    """Was the clock set back where the stamps of rows first to last fall behind? Then, against an
    even clock of the usual period (s), all rows that follow lie earlier than those before; rows out
    of order and late stamps are soon followed by rows that do not."""
    if last - first > OUT_OF_ORDER:
        return True
    begin = max(first - ROWS_AROUND_STEP, 0)
    level = times[begin : first + ROWS_AROUND_STEP] - usual * np.arange(
        begin, min(first + ROWS_AROUND_STEP, times.size)
    )
    before, after = (
        float(np.quantile(part, 0.2)) for part in (level[: first - begin], level[first - begin :])
    )
    return before - after > LACKING * usual


def _runs_smoothly(written: IntArray, sorted_rows: IntArray, signals: Sequence[FloatArray]) -> bool:
    """Whether the signals bend less in the order in which the rows were written than in that of
    their stamps."""
    places = np.flatnonzero(written != sorted_rows)
    near = np.unique(np.clip(places[:, None] + np.arange(-1, 2), 1, written.size - 2))
    votes = [0.0]
    for values in signals:
        bends = [
            np.abs(values[rows[near - 1]] - 2.0 * values[rows[near]] + values[rows[near + 1]])
            for rows in (written, sorted_rows)
        ]
        as_written, as_sorted = (float(np.nansum(bend)) for bend in bends)
        if as_written + as_sorted > 0.0:
            votes.append((as_sorted - as_written) / (as_sorted + as_written))
    return sum(votes) > 0.0


def _caught_up(stamps: FloatArray, rows: IntArray, starts: Sequence[int]) -> FloatArray:
    """Late stamps lowered until all rise, by a thousandth of a period at least: a sample was taken
    before any later sample got its stamp."""
    restored, least = stamps.copy(), 1e-3 * float(np.median(np.diff(stamps[rows])))
    for start, end in zip(starts, [*starts[1:], rows.size], strict=True):
        piece, rise = rows[start:end], least * np.arange(end - start)
        restored[piece] = np.minimum.accumulate((stamps[piece] - rise)[::-1])[::-1] + rise
    return restored
