"""Excitation signals, and what they can and cannot bring to light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError
from pamid.base.metrics import motion

BINS = 20
MOST_SAMPLES = 20_000_000  # of an excitation: more than two days at 10 ms
CELLS = 4  # sizes and paces of changes are each separated into so many classes
_STEP = 1e-9  # of the range: smaller changes are rounding, not steps
_RESTLESS = 0.95  # of the samples: a signal that moves longer is read from turn to turn
_RIPPLE = 0.05  # of the range: turns of a moving signal by less are part of a larger change
# factor within which sizes or paces count as the same; share of time that counts as never
_ALIKE, _SELDOM = 1.5, 0.01
_SINGULAR, _POOR, _NO_EVEN = 1e8, 30.0, 10.0  # condition numbers


@dataclass(frozen=True, eq=False)
class Changes:
    """Amplitude against frequency: the changes of a signal by size and by pace.

    A change runs from where the signal sets out to where it sets out again, a hold at its end
    included; the last change, cut by the end, is left out. Its pace is that of the sine that goes
    up in the same time, 1/(2 time).

    size, pace_hz   of the changes, shape (n,); size as a share of the range
    edges_hz        of the classes of pace, all of the same ratio, shape (5,); those of size are
                    quarters of the range
    share           of time by size (rows, smallest first) and pace (slowest first), shape (4, 4),
                    sums to 1
    """

    size: Array
    pace_hz: Array
    edges_hz: Array
    share: Array

    @property
    def most(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Between these lie sizes, and paces in Hz, in nine tenths of the time."""
        return _most(self.size, 1.0 / self.pace_hz), _most(self.pace_hz, 1.0 / self.pace_hz)

    def missing(self) -> list[str]:
        """Small or large, slow or fast changes that do not occur, where both kinds of each do."""
        half = CELLS // 2
        there = self.share.reshape(2, half, 2, half).sum(axis=(1, 3)) > _SELDOM
        words, missing = ("small", "large"), []
        missing += [size for size, row in zip(words, there, strict=True) if not row.any()]
        for size, row in zip(words, there, strict=True):
            paces = zip(("slow", "fast"), row, strict=True)
            missing += [f"{size} {p}" for p, present in paces if row.any() and not present]
        return missing


@dataclass(frozen=True)
class Coverage:
    """How well a signal covers amplitude and frequency. Amplitudes in the unit of the signal, s and
    Hz.

    low, high          requested range (default: the extremes visited)
    histogram          share of time in each of 20 equal bins of the range, sums to 1 (less if the
                       signal leaves it)
    evenness           entropy of the histogram over that of an even histogram: 1 every level
                       equally often, 0 a single level
    visited            share of the bins that were visited at all
    steps              number of changes of level (of direction or of hold, for a signal with ramps)
    levels             number of different levels held
    shortest_hold_s, longest_hold_s
                       between changes, the rest at the start and the cut end left out
    power_95_hz        95 % of the power of the changing part lies below
    band_20db_hz       lowest and highest frequency within 20 dB of the strongest
    moving             never at rest: its steps are then turns, its holds the times between them
    crest              highest deviation from the mean over the rms: 1 two levels, 1.41 a sine
    library_condition  how well 1, v, v^2 and v^3 (v: the signal over its half range) are separated:
                       condition number of these columns at unit length, without the rest at
                       the start; None where they are not
    even_condition     the same of 1 and v^2 alone
    changes            sizes and paces of the changes; None if there are fewer than two
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
    moving: bool
    crest: float
    library_condition: float | None
    even_condition: float | None
    changes: Changes | None

    def sentences(self) -> tuple[str, ...]:
        """Coverage and blind spots of the signal, as sentences."""
        texts = [
            f"{self.steps} turns between {self.low:g} and {self.high:g}, "
            f"{self.shortest_hold_s:.3g} to "
            f"{self.longest_hold_s:.3g} s apart; crest factor {self.crest:.3g}."
            if self.moving
            else f"{self.steps} steps between {self.low:g} and {self.high:g}, on "
            f"{self.levels} level{'' if self.levels == 1 else 's'}; held "
            f"{self.shortest_hold_s:.3g} to {self.longest_hold_s:.3g} s each.",
            f"Amplitude: {self.visited:.0%} of the range is visited, evenness {self.evenness:.2f} "
            "of 1.",
            f"Frequency: 95 % of the power lies below {self.power_95_hz:.2g} Hz; within 20 dB of "
            f"the strongest from {self.band_20db_hz[0]:.2g} to {self.band_20db_hz[1]:.2g} Hz.",
        ]
        if self.changes is not None:
            (small, large), (slow, fast) = self.changes.most
            texts.append(
                f"Changes: mostly by {small:.0%} to {large:.0%} of the range at {slow:.2g} to "
                f"{fast:.2g} Hz; {np.count_nonzero(self.changes.share)} of {CELLS**2} combinations "
                "of size and pace occur."
            )
        if self.library_condition is not None:
            texts.append(
                f"Curvature: condition number {self.library_condition:.2g} of 1, u, u², u³."
            )
        return (*texts, *self.blind_spots())

    def blind_spots(self) -> list[str]:
        """Effects that the signal cannot show, then those it hardly shows, a sentence each."""
        blind = []
        if self.even_condition is None or self.even_condition > _NO_EVEN:
            blind.append(
                "Cannot show: even nonlinearities (with two levels the square of the signal is "
                "constant)."
            )
        elif not self.moving and self.levels < 6:
            blind.append(f"Hardly shows: the shape of a curve between its {self.levels} levels.")
        elif self.library_condition is None or self.library_condition > _POOR:
            blind.append(
                "Hardly shows: the shape of a curve; the signal stays too much at a few levels."
            )
        if self.changes is not None:
            (small, large), (slow_hz, fast_hz) = self.changes.most
            missing = " and ".join(self.changes.missing())
            if large < _ALIKE * small:
                blind.append(
                    "Cannot show: what depends on the size of a change; nearly all are "
                    f"{large:.0%} of the range."
                )
            elif fast_hz >= _ALIKE * slow_hz and missing:
                blind.append(
                    f"Cannot show: {missing} changes (large: above half of the range; fast: above "
                    f"{self.changes.edges_hz[CELLS // 2]:.2g} Hz)."
                )
        if self.visited < 0.8:
            blind.append(
                "Cannot show: effects in the "
                f"{1 - self.visited:.0%} of the range that the signal does not visit."
            )
        if self.steps < 20:
            blind.append(
                "Hardly shows: anything that varies from step to step; there are only "
                f"{self.steps} steps."
            )
        what = "swings" if self.moving else "holds"
        slow = max(self.longest_hold_s, 0.5 / self.band_20db_hz[0] if self.moving else 0.0)
        blind.append(
            f"Hardly shows: effects slower than its {what} (creep, leaks, heating over more than "
            f"{slow:.2g} "
            f"s) and, over {self.duration_s:.3g} s, drift slower than {self.duration_s / 5:.2g} s."
        )
        return sorted(blind, key=lambda spot: spot.startswith("Hardly"))


def aprbs(
    duration_s: float,
    period_s: float,
    amplitude: float,
    hold_s: tuple[float, float] = (0.4, 1.6),
    levels: int | None = None,
    rate_limit: float | None = None,
    seed: int | Sequence[int] = 0,
    offset: float = 0.0,
    rest: float = 0.0,
) -> Array:
    """Amplitude-modulated pseudo-random binary signal (APRBS).

    Parameters
    ----------
    duration_s, period_s
        Duration and sampling period, s.
    amplitude, offset
        Levels lie within offset +- amplitude, in the unit of the signal.
    hold_s
        Shortest and longest time at a level, s, drawn uniformly; the end cuts the last hold.
    levels
        Number of equidistant levels (2 or more), each as often as the others. None: as many levels
        as holds, spread by a Latin hypercube.
    rate_limit
        Largest slope, units per second. None: jumps.
    seed
        The same seed gives the same signal.
    rest
        Level at which the signal starts and stays for the shortest hold.

    Returns
    -------
    Array
        Signal of shape (round(duration_s / period_s),).

    Raises
    ------
    UsageError
        The request is contradictory.

    References
    ----------
    Nelles (2001), Nonlinear System Identification, Springer.
    """
    check_request(duration_s, period_s, amplitude, hold_s, levels, rate_limit)
    random = np.random.default_rng(seed)
    count = round(duration_s / period_s)
    begin = min(max(1, round(hold_s[0] / period_s)), count - 1)
    lengths, filled = [], begin
    while filled < count:
        lengths.append(max(1, round(random.uniform(*hold_s) / period_s)))
        filled += lengths[-1]
    holds = len(lengths)
    if levels is not None:
        order = np.empty(0, dtype=int)
        while order.size < holds:
            deck = random.permutation(levels)
            # the same level twice in a row would be a single long hold
            if order.size and deck[0] == order[-1]:
                deck = np.roll(deck, 1)
            order = np.concatenate([order, deck])
        heights = np.linspace(-1.0, 1.0, levels)[order[:holds]]
    else:
        # a level in each of `holds` equal parts of the range, in random order (McKay, Beckman and
        # Conover 1979, Technometrics 21(2)): even a short signal leaves no part of the range out
        heights = 2.0 * (random.permutation(holds) + random.random(holds)) / holds - 1.0
    values = np.repeat(offset + amplitude * heights, lengths)
    signal = np.concatenate([np.full(begin, rest), values])[:count]
    return signal if rate_limit is None else slew(signal, rate_limit * period_s)


def coverage(
    signal: ArrayLike,
    period_s: float,
    *,
    span: tuple[float, float] | None = None,
) -> Coverage:
    """Coverage of amplitude and frequency by a signal.

    Parameters
    ----------
    signal
        Samples of shape (n,).
    period_s
        Sampling period, s.
    span
        Range to cover. Default: the extremes of the signal.

    Raises
    ------
    DataError
        The signal is constant or has fewer than 8 samples.
    """
    values = np.asarray(signal, dtype=float)
    if values.ndim != 1 or values.size < 8 or not np.isfinite(values).all():
        raise DataError("Coverage needs at least 8 finite samples in a row.", code="too-short")
    low, high = span if span is not None else (float(values.min()), float(values.max()))
    if not high > low or motion((low, high)) == 0.0 or motion(values) == 0.0:
        raise DataError(
            f"The signal is constant ({values[0]:g}): it excites nothing.", code="not-excited"
        )
    shares = np.histogram(values, BINS, (low, high))[0] / values.size
    filled = shares[shares > 0]
    entropy = float(-np.sum(filled * np.log(filled)))
    evenness = entropy / math.log(BINS) if filled.size > 1 else 0.0
    # samples at which a level is reached: after a jump, at the end of a ramp, at a turn
    moved = np.abs(np.diff(values)) > _STEP * float(np.ptp(values))
    moving = bool(moved.mean() > _RESTLESS)
    turns = _turns(values, moving)
    starts = turns[1:] if moving else np.flatnonzero(moved & np.append(~moved, True)[1:]) + 1
    holds = np.diff(starts) * period_s
    inner = holds if holds.size else np.array([values.size * period_s])
    held = values[starts] if starts.size else values[:1]
    frequency, power = spectrum(values, period_s)
    below = np.cumsum(power) / np.sum(power)
    strong = np.flatnonzero(power >= 0.01 * power.max())  # 20 dB
    excited = values[int(starts[0]) if starts.size else 0 :]
    library = np.vander((2.0 * excited - low - high) / (high - low), 4, increasing=True)
    changes = None
    if turns.size >= 3:
        size, times = np.abs(np.diff(values[turns])) / (high - low), np.diff(turns) * period_s
        pace = 0.5 / times
        slow, fast = _most(pace, times)
        ratio = max(math.sqrt(fast / slow), 2.0)  # a single pace is a single class, not all
        edges = math.sqrt(slow * fast) * np.geomspace(1.0 / ratio, ratio, CELLS + 1)
        row = np.clip((CELLS * size).astype(int), 0, CELLS - 1)
        column = np.clip(np.searchsorted(edges, pace, side="right") - 1, 0, CELLS - 1)
        share = np.zeros((CELLS, CELLS))
        np.add.at(share, (row, column), times / times.sum())
        changes = Changes(size, pace, edges, share)
    return Coverage(
        low=low,
        high=high,
        histogram=tuple(map(float, shares)),
        evenness=evenness,
        visited=float(np.count_nonzero(shares) / BINS),
        steps=int(starts.size),
        levels=int(np.unique(np.round(held / ((high - low) * 1e-6))).size),
        shortest_hold_s=float(inner.min()),
        longest_hold_s=float(inner.max()),
        power_95_hz=float(frequency[np.searchsorted(below, 0.95)]),
        band_20db_hz=(float(frequency[strong[0]]), float(frequency[strong[-1]])),
        duration_s=values.size * period_s,
        moving=moving,
        crest=crest(values),
        library_condition=_condition(library),
        even_condition=_condition(library[:, ::2]),
        changes=changes,
    )


def crest(signal: Array) -> float:
    """Highest deviation from the mean over the root mean square of the deviations."""
    changing = signal - signal.mean()
    return float(np.abs(changing).max() / np.sqrt(np.mean(changing**2)))


def check_request(
    duration_s: float,
    period_s: float,
    amplitude: float,
    hold_s: tuple[float, float],
    levels: int | None = None,
    rate_limit: float | None = None,
) -> None:
    """UsageError for a signal with holds that makes no sense; arguments as those of `aprbs`."""
    names = ("duration", "period", "amplitude", "hold")
    for name, value in zip(names, (duration_s, period_s, amplitude, hold_s[0]), strict=True):
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"The {name} is {value:g}; it must be positive.")
    if duration_s / period_s > MOST_SAMPLES:
        raise UsageError(
            f"{duration_s:g} s are more than {MOST_SAMPLES:g} samples.", "Make several excitations."
        )
    if not (hold_s[0] <= hold_s[1] < math.inf):
        raise UsageError(
            f"Holds run from {hold_s[0]:g} to {hold_s[1]:g} s.", "Give the shorter time first."
        )
    if hold_s[0] < period_s:
        raise UsageError(
            f"A hold of {hold_s[0]:g} s is shorter than a sample, {period_s:g} s.",
            "Make it longer.",
        )
    if duration_s < 2 * hold_s[1]:
        raise UsageError(
            f"{duration_s:g} s have no room for holds of up to {hold_s[1]:g} s.",
            "Make it longer or the holds shorter.",
        )
    if levels is not None and levels < 2:
        raise UsageError(f"{levels} level(s) excite nothing.", "Give --levels 3 or more.")
    if rate_limit is not None and not (math.isfinite(rate_limit) and rate_limit > 0):
        raise UsageError(f"The rate limit is {rate_limit:g}; it must be positive.")


def slew(signal: Array, most: float) -> Array:
    """The signal with no change above `most` from sample to sample."""
    limited = np.empty_like(signal)
    value = float(signal[0])
    for index, target in enumerate(signal.tolist()):
        value += min(max(target - value, -most), most)
        limited[index] = value
    return limited


def _turns(values: Array, moving: bool) -> NDArray[np.intp]:
    """Samples from which a signal sets out, from rest or back; of a moving signal without its
    ripple."""
    step = np.diff(values)
    way = np.where(np.abs(step) > _STEP * float(np.ptp(values)), np.sign(step), 0.0)
    begins = np.flatnonzero((way != 0.0) & (way != np.append(0.0, way[:-1])))
    if not moving:
        return begins
    turns: list[int] = []
    for turn in begins.tolist():
        # a turn that goes on the same way takes the place of the last turn; a turn that comes back
        # by less than a ripple is passed over
        if (
            len(turns) > 1
            and (values[turn] - values[turns[-1]]) * (values[turns[-1]] - values[turns[-2]]) > 0.0
        ):
            turns[-1] = turn
        elif not turns or abs(values[turn] - values[turns[-1]]) >= _RIPPLE * np.ptp(values):
            turns.append(turn)
    return np.array(turns)


def _most(values: Array, weights: Array) -> tuple[float, float]:
    order = np.argsort(values)
    below = np.cumsum(weights[order]) / weights.sum()
    low, high = np.searchsorted(below, [0.05, 0.95])
    return float(values[order][low]), float(values[order][high])


def _condition(library: Array) -> float | None:
    """Condition number of columns at unit length, so that it does not depend on their units; None
    if they cannot be separated."""
    length = np.maximum(np.linalg.norm(library, axis=0), np.finfo(float).tiny)
    singular = np.linalg.svd(library / length, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] * _SINGULAR > singular[0] else None


def spectrum(values: Array, period_s: float) -> tuple[Array, Array]:
    """Frequencies (Hz) and power density, up to a factor, by Welch's method (1967; Hann windows,
    half overlapping), without the mean."""
    size = min(values.size, max(64, values.size // 8))
    window = np.hanning(size)
    centred = values - values.mean()
    starts = range(0, values.size - size + 1, max(1, size // 2))
    pieces = np.stack([centred[start : start + size] for start in starts])
    power = np.mean(np.abs(np.fft.rfft(window * pieces)) ** 2, axis=0)
    return np.fft.rfftfreq(size, period_s)[1:].astype(float), power[1:].astype(float)
