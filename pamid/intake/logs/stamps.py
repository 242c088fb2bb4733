"""Repair of a log's stamps: repeats, steps of the clock, dropped samples and gaps.

This module counts the faults; `pamid.intake.logs.time_base` draws the conclusions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError
from pamid.base.metrics import runs_of
from pamid.base.schemas.ingest_file import ClockRepair
from pamid.recording.recording import MIN_SAMPLES

IntArray = NDArray[np.int64]

AGES = 1e12  # s, above every clock
FASTEST = 1e-8  # s, below every sampling period
# rows after which a fall of the stamps is a step of the clock, not rows out of order
OUT_OF_ORDER = 5
MANY_STEPS = 20  # steps back in a log, from which on the channel is not a clock
# share of differing rows with equal stamps above which stamps are blocks or ticks, not errors
BLOCK_SHARE = 0.02
ROWS_OF_SLOPE = 4  # rows before and behind rows with equal stamps that give the slope there
MOVING = 4.0  # factor by which a slope must exceed its noise
FEWEST_ADVANCES = 5  # slopes needed to separate samples from readings of an instant
LATE_WINDOW = 100  # rows ahead that separate a dropped sample from a late stamp
FOLLOW = 0.02  # share of a deviation by which the even clock follows it, per row
LAST = 5  # rows at the end in which a late stamp cannot be distinguished from a missing stamp
ROWS_AROUND_STEP = 20  # rows before and behind a step back that show whether the clock was set back
LACKING = 0.7  # of a period: smallest fall of their level if it was
DROPPED = 0.7  # of a period: the level of the stamps rises by this where a sample is missing


@dataclass(frozen=True)
class Rows:
    """Usable rows in the order of their stamps.

    keep      rows of the log, (n,)
    stamps    s, (n,), not falling; a clock that was set back continues
    starts    first rows of the pieces: 0, and wherever the clock was set back
    blocks    whether several different samples share a stamp, because of buffers or a clock slower
              than the sampling
    """

    keep: IntArray
    stamps: Array
    starts: tuple[int, ...]
    blocks: bool
    repairs: tuple[ClockRepair, ...]

    def pieces(self) -> list[slice]:
        """Rows between two settings of the clock."""
        ends = (*self.starts[1:], self.stamps.size)
        return [slice(start, end) for start, end in zip(self.starts, ends, strict=True)]


def usable_rows(stamps: Array, signals: Sequence[Array], place: str) -> Rows:
    """Sort the rows of a log and drop repeated ones.

    stamps: s, (n,). signals: (n,) each; they show whether rows with equal stamps are several
    samples. place: name of the channel in errors. Raises FileError if the channel is not a clock,
    DataError if too few rows have a stamp.
    """
    # rows whose stamp is a time, and the repair of the others
    keep, repairs = np.flatnonzero(np.abs(stamps) < AGES), []
    if lost := stamps.size - keep.size:
        detail = f"{lost} rows without a stamp were left out"
        repairs.append(ClockRepair(what="rows-without-stamp", count=lost, detail=detail))
    if keep.size < MIN_SAMPLES:
        message = f"{place}: {keep.size} rows have a stamp, at least {MIN_SAMPLES} are needed."
        raise DataError(message, code="too-short")
    keep, stamps, starts, more = _rising(keep, stamps, signals, place)
    repairs += more
    twice = np.flatnonzero(np.diff(stamps[keep]) == 0.0)
    if not twice.size:
        return Rows(keep, stamps[keep], tuple(starts), False, tuple(repairs))
    # rows that equal the next row, of the same stamp, in every signal were written twice
    same = np.ones(twice.size, dtype=bool)
    for values in signals:
        before, after = values[keep[twice]], values[keep[twice + 1]]
        same &= (before == after) | (np.isnan(before) & np.isnan(after))
    differing = int(np.count_nonzero(~same))
    if differing and _are_samples(stamps[keep], [values[keep] for values in signals], twice):
        if differing > BLOCK_SHARE * keep.size:
            return Rows(keep, stamps[keep], tuple(starts), True, tuple(repairs))
        detail = (
            f"{differing} samples have the stamp of the sample before and got one between the "
            "neighbours"
        )
        repairs.append(ClockRepair(what="stamps-shared", count=differing, detail=detail))
        return Rows(keep, _spread(stamps[keep]), tuple(starts), False, tuple(repairs))
    # last row of every stamp
    if equal := twice.size - differing:
        detail = f"{equal} rows were repeated and were dropped"
        repairs.append(ClockRepair(what="rows-repeated", count=equal, detail=detail))
    if differing:
        detail = (
            f"{differing} stamps were repeated, with values of the same instant: the later row is "
            "kept"
        )
        repairs.append(ClockRepair(what="stamps-repeated", count=differing, detail=detail))
    stay = np.ones(keep.size, dtype=bool)
    stay[twice] = False
    if stay.sum() < MIN_SAMPLES:
        raise DataError(
            f"{place}: {stay.sum()} rows have different stamps, at least {MIN_SAMPLES} are needed.",
            code="too-short",
        )
    moved_starts = tuple(int(stay[:start].sum()) for start in starts)
    return Rows(keep[stay], stamps[keep[stay]], moved_starts, False, tuple(repairs))


def _rising(
    written: IntArray, stamps: Array, signals: Sequence[Array], place: str
) -> tuple[IntArray, Array, list[int], list[ClockRepair]]:
    """(rows in order of rising stamps, corrected stamps, first rows of pieces, repairs).

    Either the rows are sorted or, if the signals show that the rows are in order, the late stamps
    are corrected.
    """
    repairs = []
    keep, starts, moved = _in_order(written.copy(), stamps, place)
    if moved and _runs_smoothly(written, keep, signals):
        # lowered until all rise by at least a thousandth of a period, since a sample is older than
        # the stamp of any later sample
        keep = written
        lowered, least = stamps.copy(), 1e-3 * float(np.median(np.diff(stamps[keep])))
        for start, end in zip(starts, [*starts[1:], keep.size], strict=True):
            piece, rise = keep[start:end], least * np.arange(end - start)
            lowered[piece] = np.minimum.accumulate((stamps[piece] - rise)[::-1])[::-1] + rise
        stamps = lowered
        detail = (
            f"{moved} stamps are below the one before; the signals are smooth in the order of the "
            "rows, so the stamps were late"
        )
        repairs.append(ClockRepair(what="stamps-out-of-order", count=moved, detail=detail))
    elif moved:
        detail = f"{moved} rows were written out of order and sorted"
        repairs.append(ClockRepair(what="rows-out-of-order", count=moved, detail=detail))
    if len(starts) > 1:
        back = stamps[keep[list(starts[1:])]] - stamps[keep[np.array(starts[1:]) - 1]]
        steps_back = ", ".join(f"{step:.4g} s" for step in back[:3])
        # stamps with every piece after the last, since the size of the step is unknown
        shifted, pause = stamps.copy(), 10.0 * float(np.median(np.diff(stamps[keep])))
        for start, end in zip(starts[1:], [*starts[2:], keep.size], strict=True):
            rows = keep[start:end]
            shifted[rows] += shifted[keep[start - 1]] + pause - stamps[rows[0]]
        stamps = shifted
        detail = (
            f"the clock was set back {len(back)} times ({steps_back}): the recording is split there"
        )
        repairs.append(ClockRepair(what="clock-set-back", count=len(back), detail=detail))
    return keep, stamps, starts, repairs


def _are_samples(stamps: Array, signals: Sequence[Array], twice: IntArray) -> bool:
    """Whether rows with the stamp of the next row (at these places) are separate samples, a period
    apart, and not readings of the same instant.

    A smooth signal advances from sample to sample by its slope. The steps between such rows are
    regressed on the steps expected from the rows around, c = sum(step due) / sum(due^2), with the
    standard error of White (1980), Econometrica 48(4). c is 1 for samples and 0 for readings of the
    same instant. If no signal moves enough, rows are samples if most rows share their stamp, as in
    blocks, or if the stamps around leave enough time for so many samples.
    """
    parts = [_advance(values, twice) for values in signals]
    step, due = (np.concatenate([np.zeros(0), *(part[i] for part in parts)]) for i in (0, 1))
    if step.size >= FEWEST_ADVANCES:
        weight = float(due @ due)
        coefficient = float(step @ due) / weight
        error = float(np.sqrt(np.sum((due * (step - coefficient * due)) ** 2))) / weight
        if abs(coefficient - 0.5) > 2.0 * error:
            return coefficient > 0.5
    if 2 * twice.size > stamps.size:
        return True
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0]))
    first, last = runs_of(steps == 0.0)
    inner = (first > 0) & (last < steps.size)
    first, last = first[inner], last[inner]
    if not first.size:
        return False
    spare = (steps[first - 1] + steps[last] - 2.0 * usual) / ((last - first) * usual)
    return float(np.median(spare)) >= 0.5


def _advance(values: Array, twice: IntArray) -> tuple[Array, Array]:
    """(step to the row with the same stamp, step expected from the rows around), relative to the
    usual step, at places where the signal moves visibly and in a constant direction."""
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


def _spread(stamps: Array) -> Array:
    """Stamps with shared ones moved apart by at most a period, to the side with more time."""
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
    """Sampling period (s) of most of the log, accurate to a few per mille and robust against gaps
    and late stamps. Raises DataError if the stamps have none."""
    steps = np.concatenate([np.diff(rows.stamps[piece]) for piece in rows.pieces()])
    middle = float(np.median(steps)) if steps.size else 0.0
    # a late stamp makes a step longer and the next shorter: leave out both or none
    single = steps[np.abs(steps - middle) < 0.7 * middle]
    if (
        rows.blocks
        or middle <= 0.0
        or abs(float(single.mean()) - middle) > 0.002 * middle
        or np.mean(np.abs(single - middle) <= 0.05 * middle) <= 0.5
    ):
        # period (s) over many rows, for variable steps
        longest = max(rows.pieces(), key=lambda piece: piece.stop - piece.start)
        stamps = rows.stamps[longest]
        runs = np.diff(np.flatnonzero(np.diff(stamps) > 0.0), prepend=-1)
        lag = min(max(50, 20 * int(runs.max(initial=1))), max(stamps.size // 2, 1))
        period = float(np.median(stamps[lag:] - stamps[:-lag])) / lag
        middle = period if rows.blocks or period <= FASTEST else _sharpest(stamps, period)
    if not FASTEST < middle < AGES / 1e3 or steps.sum() > AGES * middle:
        raise DataError(
            f"The stamps have no sampling period: most rows are {middle:.3g} s apart.",
            "Check that this is the channel with the time, and its unit.",
            code="time-base",
        )
    return middle


def follow_rows(stamps: Array) -> int:
    """Number of rows after which late stamps have returned to the clock."""
    runs = np.diff(np.flatnonzero(np.diff(stamps) > 0.0), prepend=-1)
    return max(LATE_WINDOW, 4 * int(np.median(runs)) if runs.size else 1)


def count_samples(stamps: Array, period: float) -> IntArray:
    """Sample index on an even clock of each row, (n,), from 0; missing samples are counted.

    After a late stamp later rows return to the even clock. After a missing sample all rows stay
    late by whole periods. Therefore the lowest of the stamps ahead is compared with the even clock,
    which follows it slowly, because the period (s) has an error.
    """
    from scipy.ndimage import minimum_filter1d

    n = stamps.size
    window = min(follow_rows(stamps), n)
    residual = stamps / period - np.arange(n)
    lowest_ahead = minimum_filter1d(residual, window, mode="nearest", origin=-(window // 2))
    # no later rows show whether the last ones are late or follow a missing sample
    end = n - LAST if float(np.quantile(residual - lowest_ahead, 0.995)) > 0.3 else n
    missing = np.zeros(n, dtype=np.int64)
    # `base` is the even clock: it falls at once to any earlier stamp, rises slowly with drift, and
    # by whole periods where samples are missing. These are missing where the stamp itself jumps.
    level, base = lowest_ahead.tolist(), float(lowest_ahead[0])
    steps = np.diff(residual, prepend=residual[0])
    for i in range(1, end):
        above = level[i] - base
        if above >= DROPPED:
            lost = int(above + 1.0 - DROPPED)
            missing[i if steps[i] >= DROPPED else i + int(np.argmax(steps[i : i + 10]))] += lost
            base += lost
        else:
            base += FOLLOW * above if above > 0.0 else above
    return np.asarray(np.arange(n) + np.cumsum(missing), dtype=np.int64)


def fit_clock(stamps: Array, samples: IntArray, pieces: Sequence[slice]) -> tuple[float, Array]:
    """(period in s, start of each piece in s) of the even clock through the middle of the stamps.

    The fit is least squares without the latest twentieth of the stamps. Of rows with equal stamps
    only the last counts, because it waited least.
    """
    use = last = np.append(np.diff(stamps) != 0.0, True)
    period, begins = 0.0, np.zeros(len(pieces))
    # a common slope for all pieces, each about its mean; a pass gives the next latest twentieth
    for _ in range(3):
        above = below = 0.0
        for piece in pieces:
            k, t = samples[piece][use[piece]].astype(float), stamps[piece][use[piece]]
            if k.size:
                above += float((k - k.mean()) @ (t - t.mean()))
                below += float((k - k.mean()) @ (k - k.mean()))
        if above <= 0.0:
            raise DataError(
                "The stamps follow no even clock: no rows have consecutive stamps.",
                "Check that this is the channel with the time, and its unit.",
                code="time-base",
            )
        period = above / below
        begins = np.array([float(np.median(stamps[p] - period * samples[p])) for p in pieces])
        late = np.concatenate(
            [stamps[p] - period * samples[p] - b for p, b in zip(pieces, begins, strict=True)]
        )
        use = last & (late <= np.quantile(late[last], 0.95))
    return period, begins


def _sharpest(stamps: Array, period: float) -> float:
    """Period (s) within 4 % of `period` at which the phases of the stamps agree best, over
    stretches of 256 rows. Missing samples do not change a phase."""
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
            float(np.mean(np.abs(np.exp(2j * np.pi / candidate * blocks).mean(axis=1)) ** 2))
            for candidate in trial
        ]
    )
    best = int(np.argmax(power))
    return float(trial[best]) if power[best] > 3.0 * np.median(power) else period


def _in_order(rows: IntArray, stamps: Array, place: str) -> tuple[IntArray, list[int], int]:
    """(rows in order of their stamps, rows at which the clock was set back, number of rows out of
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
                f"{place}: the stamps go back {len(starts)} times or more.",
                "It is probably not a clock. Name the channel with the time in [time] source.",
                code="stamps-unsorted",
            )


def _is_step(times: Array, first: int, last: int, usual: float) -> bool:
    """Whether the clock was set back at the rows first to last, whose stamps fall.

    Relative to an even clock of the usual period (s), all later rows are then earlier than those
    before. Rows out of order and late stamps have normal rows soon after.
    """
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


def _runs_smoothly(written: IntArray, sorted_rows: IntArray, signals: Sequence[Array]) -> bool:
    """Whether the signals have smaller second differences in the written order of the rows than in
    the order of their stamps."""
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
