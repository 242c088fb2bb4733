"""Excitation signals, and what they can and cannot bring to light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.errors import DataError, UsageError

FloatArray = NDArray[np.float64]

BINS = 20
_STEP = 1e-9  # of the range: smaller changes are rounding, not steps


@dataclass(frozen=True)
class Coverage:
    """How well a signal covers amplitude and frequency. Amplitudes in the unit of the signal, s and Hz.

    low, high         range asked for (default: the extremes visited)
    histogram         share of time in each of 20 equal bins of the range, sums to 1 (less if the signal leaves it)
    evenness          entropy of the histogram over that of an even one: 1 = every level equally often, 0 = one level
    visited           share of the bins that were visited at all
    steps             number of changes of level (of direction or of hold, for a signal with ramps)
    levels            number of different levels held
    shortest_hold_s, longest_hold_s   between changes, the rest at the start and the cut end left out
    power_95_hz       95 % of the power of the changing part lies below
    band_20db_hz      lowest and highest frequency within 20 dB of the strongest
    """

    low: float
    high: float
    histogram: tuple[float, ...]
    evenness: float
    visited: float
    steps: int
    levels: int
    shortest_hold_s: float
    longest_hold_s: float
    power_95_hz: float
    band_20db_hz: tuple[float, float]
    duration_s: float
    sampling_period_s: float
    bandwidth_hz: float | None = None

    def sentences(self) -> tuple[str, ...]:
        """What the signal covers and what it cannot excite, in plain words."""
        said = [
            f"{self.steps} steps between {self.low:g} and {self.high:g}, on {_many(self.levels, 'level')}; held "
            f"{self.shortest_hold_s:.3g} to {self.longest_hold_s:.3g} s each.",
            f"Amplitude: {self.visited:.0%} of the range is visited, evenness {self.evenness:.2f} of 1.",
            f"Frequency: 95 % of the power lies below {self.power_95_hz:.2g} Hz; within 20 dB of the strongest from "
            f"{self.band_20db_hz[0]:.2g} to {self.band_20db_hz[1]:.2g} Hz.",
        ]
        return (*said, *self._blind_spots())

    def _blind_spots(self) -> list[str]:
        blind = []
        if self.levels <= 2:
            blind.append("Cannot show: even nonlinearities (with two levels the square of the signal is constant).")
        elif self.levels < 6:
            blind.append(f"Hardly shows: the shape of a curve between its {self.levels} levels.")
        if self.visited < 0.8:
            blind.append(f"Cannot show: what happens in the {1 - self.visited:.0%} of the range where it never stays.")
        if self.bandwidth_hz is not None and self.band_20db_hz[1] < self.bandwidth_hz:
            blind.append(
                f"Cannot show: dynamics between {self.band_20db_hz[1]:.2g} and {self.bandwidth_hz:.2g} Hz; hold the "
                "levels for a shorter time or let them change faster."
            )
        if self.steps < 20:
            blind.append(f"Hardly shows: anything that varies from step to step; there are only {self.steps} steps.")
        slow = max(self.longest_hold_s, 0.0)
        blind.append(
            f"Hardly shows: effects slower than its holds (creep, leaks, heating over more than {slow:.2g} s) and, "
            f"over {self.duration_s:.3g} s, drift slower than {self.duration_s / 5:.2g} s."
        )
        return blind


def aprbs(
    duration_s: float,
    period_s: float,
    amplitude: float,
    hold_s: tuple[float, float] = (0.4, 1.6),
    levels: int | None = None,
    rate_limit: float | None = None,
    seed: int | Sequence[int] = 0,
    offset: float = 0.0,
    latin: bool = True,
) -> FloatArray:
    """An amplitude-modulated pseudo-random step signal, shape (round(duration_s / period_s),).

    amplitude   levels lie within offset +- amplitude, in the unit of the signal
    hold_s      shortest and longest time at one level, drawn uniformly; the last one is cut by the end
    levels      None: as many levels as holds, spread over the range by a Latin hypercube (independent uniform draws
                if latin is False); a number >= 2: that many equidistant levels, each as often as the others
    rate_limit  largest slope in units per second (None: jumps)

    The signal starts at 0 and rests there for the shortest hold, so that a rig can be started from rest. The same seed
    gives the same signal. UsageError for a request that makes no sense.
    """
    _check_request(duration_s, period_s, amplitude, hold_s, levels, rate_limit)
    random = np.random.default_rng(seed)
    count = round(duration_s / period_s)
    rest = min(max(1, round(hold_s[0] / period_s)), count - 1)
    lengths: list[int] = []
    while sum(lengths) < count - rest:
        lengths.append(max(1, round(random.uniform(*hold_s) / period_s)))
    heights = offset + amplitude * _unit_levels(len(lengths), levels, latin, random)
    signal = np.concatenate([np.zeros(rest), np.repeat(heights, lengths)])[:count]
    return signal if rate_limit is None else _slew(signal, rate_limit * period_s)


def coverage(
    signal: ArrayLike,
    period_s: float,
    *,
    span: tuple[float, float] | None = None,
    bandwidth_hz: float | None = None,
) -> Coverage:
    """How well `signal` (shape (n,), one sample every period_s) covers amplitude and frequency.

    span: the range to be covered, default the extremes of the signal; bandwidth_hz: up to where the rig is to be known.
    DataError for a constant signal or fewer than 8 samples.
    """
    values = np.asarray(signal, dtype=float)
    if values.ndim != 1 or values.size < 8 or not np.isfinite(values).all():
        raise DataError("Coverage needs at least 8 finite samples in a row.", code="too-short")
    low, high = span if span is not None else (float(values.min()), float(values.max()))
    if not high > low or np.ptp(values) == 0:
        raise DataError(f"The signal is constant ({values[0]:g}): it excites nothing.", code="not-excited")
    shares = np.histogram(values, BINS, (low, high))[0] / values.size
    filled = shares[shares > 0]
    starts = _changes(values)
    holds = np.diff(starts) * period_s
    inner = holds if holds.size else np.array([values.size * period_s])
    held = values[starts] if starts.size else values[:1]
    frequency, power = _spectrum(values, period_s)
    below = np.cumsum(power) / np.sum(power)
    strong = np.flatnonzero(power >= 0.01 * power.max())
    return Coverage(
        low=low,
        high=high,
        histogram=tuple(float(share) for share in shares),
        evenness=float(-np.sum(filled * np.log(filled)) / math.log(BINS)) if filled.size > 1 else 0.0,
        visited=float(np.count_nonzero(shares) / BINS),
        steps=int(starts.size),
        levels=int(np.unique(np.round(held / ((high - low) * 1e-6))).size),
        shortest_hold_s=float(inner.min()),
        longest_hold_s=float(inner.max()),
        power_95_hz=float(frequency[np.searchsorted(below, 0.95)]),
        band_20db_hz=(float(frequency[strong[0]]), float(frequency[strong[-1]])),
        duration_s=values.size * period_s,
        sampling_period_s=period_s,
        bandwidth_hz=bandwidth_hz,
    )


def _check_request(
    duration_s: float,
    period_s: float,
    amplitude: float,
    hold_s: tuple[float, float],
    levels: int | None,
    rate_limit: float | None,
) -> None:
    numbers = {"duration": duration_s, "period": period_s, "amplitude": amplitude, "hold": hold_s[0]}
    for name, value in numbers.items():
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"The {name} is {value:g}; it must be positive.")
    if not (hold_s[0] <= hold_s[1] < math.inf):
        raise UsageError(f"Holds run from {hold_s[0]:g} to {hold_s[1]:g} s.", "Give the shorter time first.")
    if hold_s[0] < period_s:
        hint = f"The shortest hold is one sample, {period_s:g} s."
        raise UsageError(f"A hold of {hold_s[0]:g} s is shorter than one sample.", hint)
    if duration_s < 2 * hold_s[1]:
        hint = "Make it longer or the holds shorter."
        raise UsageError(f"{duration_s:g} s have no room for holds of up to {hold_s[1]:g} s.", hint)
    if levels is not None and levels < 2:
        raise UsageError(f"{levels} level(s) excite nothing.", "Give --levels 3 or more.")
    if rate_limit is not None and not (math.isfinite(rate_limit) and rate_limit > 0):
        raise UsageError(f"The rate limit is {rate_limit:g}; it must be positive.")


def _unit_levels(count: int, levels: int | None, latin: bool, random: np.random.Generator) -> FloatArray:
    """`count` levels in [-1, 1]."""
    if levels is None and latin:
        return 2.0 * (random.permutation(count) + random.random(count)) / count - 1.0
    if levels is None:
        return random.uniform(-1.0, 1.0, count)
    order = np.empty(0, dtype=int)
    while order.size < count:
        deck = random.permutation(levels)
        # the same level twice in a row would be one long hold
        if order.size and deck[0] == order[-1]:
            deck = np.roll(deck, 1)
        order = np.concatenate([order, deck])
    return np.linspace(-1.0, 1.0, levels)[order[:count]]


def _slew(signal: FloatArray, most: float) -> FloatArray:
    limited = np.empty_like(signal)
    value = float(signal[0])
    for index, target in enumerate(signal.tolist()):
        value += min(max(target - value, -most), most)
        limited[index] = value
    return limited


def _changes(values: FloatArray) -> NDArray[np.intp]:
    """Samples at which a new level is reached: after a jump, or at the end of a ramp."""
    moved = np.abs(np.diff(values)) > _STEP * float(np.ptp(values))
    still = np.append(~moved, True)[1:]
    return np.flatnonzero(moved & (still | _isolated(moved))) + 1


def _isolated(moved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Every sample of a signal that hardly ever rests counts as a change of its own."""
    return np.full(moved.size, bool(moved.mean() > 0.95))


def _spectrum(values: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (Hz) and power density by Welch's method (Hann windows, half overlapping), without the mean."""
    size = min(values.size, max(64, values.size // 8))
    window = np.hanning(size)
    centred = values - values.mean()
    starts = range(0, values.size - size + 1, max(1, size // 2))
    pieces = np.stack([centred[start : start + size] for start in starts])
    power = np.mean(np.abs(np.fft.rfft(window * pieces)) ** 2, axis=0)
    return np.fft.rfftfreq(size, period_s)[1:].astype(float), power[1:].astype(float)


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
