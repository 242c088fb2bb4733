"""The time base of a log. It is diagnosed before it is repaired, because two faults look alike and
need opposite repairs.

*Late stamps*: sampling is even, and a host writes each stamp with a variable delay. Repair: the
even clock, through the earliest of the stamps. *Jittered sampling*: the samples themselves are
taken unevenly and the stamps are true. Repair: resample by the stamps. The wrong repair is about a
hundred times worse than the right repair.

A moving signal distinguishes them. Let d be the deviation of a stamp from an even clock and y' the
slope of a signal. If sampling jitters, a sample deviates from the local course of its neighbours by
y' d; if only the stamp is late, by nothing. With R y = y minus its local polynomial (Savitzky and
Golay 1964, Analytical Chemistry 36(8)), the roughness of the signal, the regression
    R y = c R(y' d) + noise,   c = sum(R y R(y' d)) / sum(R(y' d)^2)
gives c = 1 for jittered sampling and c = 0 for late stamps. Its standard error is that of a
delete-one-part jackknife (Tukey 1958) over JACKKNIFE_PARTS parts of the log, since the errors of
neighbouring samples are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pamid.base.arrays import Array
from pamid.base.schemas.ingest_file import ClockRepair, ClockWitness
from pamid.intake.logs.stamps import (
    IntArray,
    Rows,
    count_samples,
    fit_clock,
    follow_rows,
    rough_period,
)
from pamid.recording.file_checks import HUGE, UNIFORM_TO
from pamid.recording.noise import noise_level

Cure = Literal["none", "late-stamps", "jittered-sampling"]
LEAST_VISIBLE = 0.5  # resolutions of a signal: a smaller change does not show
State = Literal["even", "rounded", "blocks", "late-stamps", "jittered-sampling", "undecided"]

LEAST_LATENCY_QUANTILE = 0.01  # quantile of the latency that stands for none
# slopes are those of parabolas, the local course that of quartics, through 2 * HALF + 1 samples
HALF = 5
# standard deviation that white noise of 1 keeps in R y: sqrt(1 - 143/429), where 143/429 is the
# middle coefficient of the quartic smoother over 11 samples (Savitzky and Golay)
ROUGH = 0.816
MOVING = 4.0  # factor by which a slope must exceed its noise
# decided: the coefficient is this close to 0 or 1, and its standard error so small that the other
# value is at least four of them away: (1 - 0.3) / 0.17
CLEAR, COEFFICIENT_ERROR = 0.3, 0.17
LEAST_MOVING_SAMPLES = 200  # samples of a moving signal, at least
JACKKNIFE_PARTS = 20  # parts of the log over which the standard error is taken
# largest deviation of the earliest stamps from an even clock, periods; beyond it there is none
MOST_WANDER = 3.0
# s: decimal prints, and 1/64 s, the default tick of Windows
TICKS = (1.0, 0.1, 0.015625, 0.01, 0.001, 1e-4, 1e-5, 1e-6)
# a gap splits the recording if it is longer than this many periods, unless the mapping sets it
GAP_PERIODS = 10


@dataclass(frozen=True)
class StampDiagnosis:
    """Condition of the stamps of a clock.

    cure is None if the data do not decide; why is a sentence with the numbers; numbers has the same
    for scripts (s, ppm, dimensionless). witnesses: for each moving signal the coefficient of y' d
    (0 late stamps, 1 jittered sampling), and its roughness if samples were even, over that if the
    stamps were true.
    """

    state: State
    cure: Cure | None
    why: str
    period: float  # s, by the log's clock
    numbers: dict[str, float] = field(default_factory=dict)
    witnesses: tuple[ClockWitness, ...] = ()


@dataclass(frozen=True)
class TimeBase:
    """Sampling instants (n,) of the rows, s of the log's clock, and pieces between gaps."""

    instants: Array
    pieces: tuple[slice, ...]
    period: float
    repairs: tuple[ClockRepair, ...] = ()


def diagnose_stamps(rows: Rows, signals: Mapping[str, Array]) -> StampDiagnosis:
    """Diagnose the stamps and choose their repair.

    signals: measured signals at the usable rows, (n,) each, NaN for missing values.
    """
    clock = _even_clock(rows, None)
    samples, pieces, period, late = clock.samples, clock.pieces, clock.period, clock.late
    steps = np.concatenate([np.diff(rows.stamps[p]) for p in pieces])
    counts = np.concatenate([np.diff(samples[p]) for p in pieces])
    rounding = 2.0 * float(np.spacing(np.abs(rows.stamps).max()))
    centred = late - late.mean()
    spread = float(np.sqrt(np.mean(centred**2)))
    numbers = {
        "period_s": period,
        "earliest_s": float(late.min()),
        "latest_s": float(late.max()),
        "spread_s": float(late.std()),
        "skewness": float(np.mean(centred**3)) / spread**3 if spread else 0.0,
    }
    if np.abs(steps - counts * period).max(initial=0.0) <= UNIFORM_TO * period + rounding:
        why = "the stamps are even to 1 % of a period"
        return StampDiagnosis("even", "none", why, period, numbers)
    if rows.blocks:
        share = float(np.mean(steps == 0.0))
        why = (
            f"{share:.0%} of the rows have the stamp of the row before, but other values: the "
            "stamps are those of blocks or of a slow clock, with samples between them"
        )
        numbers["shared_stamps"] = share
        return StampDiagnosis("blocks", "late-stamps", why, period, numbers)
    # time of which all stamps are whole multiples; 0 if there is none that matters
    tick, positive = 0.0, steps[steps > rounding]
    for candidate in TICKS if positive.size else ():
        multiples = (rows.stamps - rows.stamps[0]) / candidate
        off = np.abs(multiples - np.round(multiples)).max()
        matters = candidate < 2.5 * float(np.median(positive))
        if matters and off <= max(1e-6, 4.0 * rounding / candidate):
            tick = candidate
            break
    if tick and np.ptp(late) <= 1.05 * tick + rounding:
        why = (
            f"the stamps are whole multiples of {_time(tick)} and deviate from an even clock by "
            "no more than that"
        )
        numbers["tick_s"] = tick
        return StampDiagnosis("rounded", "late-stamps", why, period, numbers)
    return _by_signals(rows, signals, period, late, numbers)


def reconstructed_time_base(
    rows: Rows, diagnosis: StampDiagnosis, cure: Cure, max_gap: float | None
) -> TimeBase:
    """Sampling instants of the rows after a repair, split at gaps longer than max_gap (s, default
    ten periods).

    "late-stamps" and "none" give the even clock, or a clock along the earliest stamps if the
    sampling is not even. "jittered-sampling" gives the stamps.
    """
    clock = _even_clock(rows, max_gap)
    samples, pieces, period, late = clock.samples, clock.pieces, clock.period, clock.late
    lost = sum(int((np.diff(samples[p]) - 1).sum()) for p in pieces)
    if cure == "jittered-sampling":
        limit = GAP_PERIODS * period if max_gap is None else max_gap
        pieces = _between_gaps(rows, np.diff(rows.stamps), limit)
        # sampling with cumulative errors has no even clock, so the steps show missing samples
        steps = sum(
            int(np.maximum(np.round(np.diff(rows.stamps[p]) / period) - 1.0, 0.0).sum())
            for p in pieces
        )
        lost = steps if clock.wanders else min(lost, steps)
        repairs = _repairs(rows.stamps, pieces, rows.starts, lost)
        return TimeBase(rows.stamps, tuple(pieces), diagnosis.period, repairs)
    even = rows.stamps - late
    instants = even.copy()
    for piece in pieces:
        if clock.wanders:
            instants[piece] += _earliest(late[piece], follow_rows(rows.stamps[piece]))
        elif cure == "late-stamps":
            instants[piece] += float(np.quantile(late[piece], LEAST_LATENCY_QUANTILE))
    repairs = _repairs(instants, pieces, rows.starts, lost)
    if clock.wanders:
        instants = np.maximum.accumulate(instants) + 1e-9 * period * samples
        detail = "the sampling rate varies: the clock follows the earliest stamps"
        repairs = (ClockRepair(what="clock-followed", count=len(pieces), detail=detail), *repairs)
    return TimeBase(instants, tuple(pieces), period, repairs)


@dataclass(frozen=True)
class _EvenClock:
    """Even clock behind the stamps.

    samples   sample index of each row
    late      delay of each stamp relative to an even clock of this period, s
    wanders   whether the sampling rate varies, so that there is no even clock; the period is then
              the mean period, and missing samples are not counted, because a longer step does not
              show them
    """

    samples: IntArray
    pieces: list[slice]
    period: float
    late: Array
    wanders: bool = False


def _even_clock(rows: Rows, max_gap: float | None) -> _EvenClock:
    """Even clock behind the stamps, over pieces between longer gaps."""
    period = rough_period(rows)
    # gaps depend on the period, and the period on the pieces between gaps
    for _ in range(2):
        limit = GAP_PERIODS * period if max_gap is None else max_gap
        samples = np.concatenate([count_samples(rows.stamps[p], period) for p in rows.pieces()])
        split = _between_gaps(rows, np.diff(samples) * period, limit)
        period, begins = fit_clock(rows.stamps, samples, split)
    late = np.concatenate(
        [rows.stamps[p] - period * samples[p] - b for p, b in zip(split, begins, strict=True)]
    )
    # a late host returns to the even clock; sampling at a lower rate does not
    wander = max(float(np.ptp(_earliest(late[p], follow_rows(rows.stamps[p])))) for p in split)
    if wander <= MOST_WANDER * period:
        return _EvenClock(samples, split, period, late)
    split = _between_gaps(rows, np.diff(rows.stamps), limit)
    spans = [rows.stamps[piece.stop - 1] - rows.stamps[piece.start] for piece in split]
    period = float(sum(spans)) / max(1, rows.stamps.size - len(split))
    samples = np.arange(rows.stamps.size, dtype=np.int64)
    late = rows.stamps - period * samples
    for piece in split:
        late[piece] -= np.median(late[piece])
    return _EvenClock(samples, split, period, late, wanders=True)


def _earliest(late: Array, window: int) -> Array:
    """Delay (s) of the earliest stamps around each row."""
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    window = min(window, late.size)
    lowest = minimum_filter1d(late, window, mode="nearest")
    return np.asarray(uniform_filter1d(lowest, window, mode="nearest"))


def _by_signals(
    rows: Rows,
    signals: Mapping[str, Array],
    period: float,
    late: Array,
    numbers: dict[str, float],
) -> StampDiagnosis:
    """Diagnosis by the moving signals; undecided if no signal moves."""
    every = (_witness(name, rows, values, period) for name, values in signals.items())
    heard = [witness for witness in every if witness is not None]
    skew = numbers["skewness"]
    low, high = np.quantile(late, [0.01, 0.99])
    tail = ": only late, as from a busy host" if skew > 1.0 else ""
    shape = (
        f"they deviate from an even clock of {_time(period)} by {_time(low)} to {_time(high)} (1 % "
        f"to 99 %, skewness {skew:.1f}{tail})"
    )
    if not heard:
        why = f"{shape}; no signal moves enough to separate late stamps from jittered sampling"
        return StampDiagnosis("undecided", None, why, period, numbers)
    # weights are inverse variances, with a floor of 0.02 on the error. Signals of a log share its
    # disturbances, so their mean is not more certain than the most certain of them.
    weights = np.array([1.0 / max(w.error, 0.02) ** 2 for w in heard])
    coefficient = float(weights @ [w.coefficient for w in heard] / weights.sum())
    error = float(max(1.0 / math.sqrt(weights.sum()), min(w.error for w in heard)))
    best = max(heard, key=lambda w: 1.0 / max(w.error, 0.02))
    numbers = {**numbers, "coefficient": coefficient, "coefficient_error": error}
    numbers["roughness_ratio"] = best.roughness_ratio
    correlations = (
        f"{coefficient:.2f} +- {error:.2f} by {len(heard)} moving "
        f"signal{'s' if len(heard) > 1 else ''} "
        "(0: late stamps on even sampling, 1: jittered sampling)"
    )
    sure = error <= COEFFICIENT_ERROR
    cure: Literal["late-stamps", "jittered-sampling"] | None = None
    why = f"{shape}; the signals do not decide: {correlations}"
    if sure and abs(coefficient) <= CLEAR:
        cure = "late-stamps"
        why = (
            f"{shape}, and the signals do not follow that: {correlations}; at the stamps "
            f"{best.signal} is {1.0 / best.roughness_ratio:.1f} times rougher than at even instants"
        )
    elif sure and abs(coefficient - 1.0) <= CLEAR:
        cure = "jittered-sampling"
        why = (
            f"{shape}, and the signals follow that: {correlations}; at even instants "
            f"{best.signal} is {best.roughness_ratio:.1f} times rougher than at the stamps"
        )
    elif _immaterial(signals.values(), float(high - low), period):
        cure = "late-stamps"
        why = f"{shape}, in which no signal changes by more than its resolution"
    return StampDiagnosis(cure or "undecided", cure, why, period, numbers, tuple(heard))


def _immaterial(signals: Iterable[Array], spread: float, period: float) -> bool:
    """Do all signals change by less than their resolution in the time by which stamps stray? Then
    it does not matter how they are read."""
    for values in signals:
        changes = np.abs(np.diff(values[np.isfinite(values)]))
        moves = changes[changes > 0.0]
        if not moves.size:
            continue
        noise = float(noise_level(values[np.isfinite(values)][:, None])[0])
        resolution = max(float(moves.min()), noise)
        if math.sqrt(float(np.mean(changes**2))) / period * spread > LEAST_VISIBLE * resolution:
            return False
    return True


def _witness(name: str, rows: Rows, values: Array, period: float) -> ClockWitness | None:
    """The regression of the module's head for a single signal; None if it hardly moves.

    Deviation and slope are local (against a parabola through 2 * HALF + 1 rows), so that it does
    not matter whether a clock drifts or the errors of a sampling add up. Windows with a missing
    sample or a stamp late by a period are left out.
    """
    from scipy.signal import savgol_filter

    width = 2 * HALF + 1
    parts = []
    for piece in rows.pieces():
        if piece.stop - piece.start < 2 * width:
            continue
        t, y = rows.stamps[piece], values[piece]
        bad = ~(np.abs(y) <= HUGE)  # a nan is as bad
        y = np.where(bad, 0.0, y)
        pace = savgol_filter(t, width, 2, deriv=1)
        stray = t - savgol_filter(t, width, 2)
        slope = savgol_filter(y, width, 2, deriv=1) / np.maximum(pace, 0.1 * period)
        bad[1:] |= np.diff(t) > 1.7 * period  # a sample is missing between
        bad |= np.abs(stray) > period
        if bad.all() or np.std(stray[~bad]) < UNIFORM_TO * period / 10.0:
            continue
        clean = np.convolve(bad, np.ones(2 * width), mode="same") == 0.0
        rough, due = (x - savgol_filter(x, width, 4) for x in (y, slope * stray))
        parts.append(np.stack([rough, due, slope, clean])[:, width:-width])
    if not parts:
        return None
    rough, due, slope, clean = np.concatenate(parts, axis=1)
    use = clean > 0.0
    if use.sum() < LEAST_MOVING_SAMPLES:
        return None
    noise = float(np.median(np.abs(rough[use]))) / 0.6745 / ROUGH
    noise = max(noise, 8.0 * float(np.spacing(np.abs(values[np.abs(values) <= HUGE]).max())))
    # from noise of a sample to that of a parabola's slope: over sqrt(sum of k^2) for k from -HALF
    # to HALF, which is sqrt(HALF (HALF + 1) (2 HALF + 1) / 3)
    noise /= period * math.sqrt(HALF * (HALF + 1) * width / 3.0)
    use &= np.abs(slope) > MOVING * noise
    if use.sum() < LEAST_MOVING_SAMPLES or not np.ptp(due[use]) > 0.0:
        return None
    rough, due = rough[use], due[use]
    pieces = [np.array_split(x, JACKKNIFE_PARTS) for x in (rough, due)]
    top, bottom = (
        np.array([float(a @ b) for a, b in zip(parts, pieces[1], strict=True)]) for parts in pieces
    )
    if not (bottom.sum() > bottom).all():  # a single part gives no standard error
        return None
    # delete-one jackknife: variance (n - 1)/n sum((c_without_i - mean)^2)
    coefficient = top.sum() / bottom.sum()
    without = (top.sum() - top) / (bottom.sum() - bottom)
    error = math.sqrt(
        (JACKKNIFE_PARTS - 1) / JACKKNIFE_PARTS * float(((without - without.mean()) ** 2).sum())
    )
    even, stamped = (max(float(np.std(x)), 1e-9 * float(np.std(due))) for x in (rough, rough - due))
    return ClockWitness(
        signal=name,
        coefficient=float(coefficient),
        error=error,
        roughness_ratio=even / stamped,
    )


def _repairs(
    instants: Array, pieces: list[slice], starts: tuple[int, ...], lost: int
) -> tuple[ClockRepair, ...]:
    repairs = []
    if lost:
        detail = f"{lost} single samples are missing and were filled"
        repairs.append(ClockRepair(what="samples-missing", count=lost, detail=detail))
    if gaps := [p.start for p in pieces if p.start not in starts]:
        longest = max(float(instants[i] - instants[i - 1]) for i in gaps)
        detail = f"{len(gaps)} gaps (the longest {longest:.4g} s): the recording is split there"
        repairs.append(ClockRepair(what="gaps", count=len(gaps), detail=detail))
    return tuple(repairs)


def _between_gaps(rows: Rows, steps: Array, limit: float) -> list[slice]:
    """Pieces between settings of the clock and steps longer than the limit (s)."""
    cuts = sorted({*rows.starts, *(np.flatnonzero(steps > limit) + 1).tolist()})
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], rows.stamps.size], strict=True)]


def _time(seconds: float) -> str:
    """A short time with a suitable unit."""
    for factor, name in ((1.0, "s"), (1e3, "ms")):
        if abs(seconds) * factor >= 1.0:
            return f"{seconds * factor:.4g} {name}"
    return f"{seconds * 1e6:.4g} us"
