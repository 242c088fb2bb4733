"""Signals to send: shapes of time for the experiments of the menu, and excitations with settings,
for several columns.

An excitation keeps within a rate limit: steps are slowed down to it, a smooth signal that would be
bent is refused. Columns with random signals are sent together, each with a separate seed; with
the others they take turns, the rest of them waiting at the offset, so that what answers is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import UsageError, nearest
from pamid.simulation.excitation.aprbs import aprbs, check_request, crest, slew

FASTEST_HZ = 15.0  # of the menu's multisine, and at most a tenth of the sampling rate
PULSES_S, GAP_S = (0.03, 0.06, 0.12, 0.25, 0.5), 1.5
# of the nested loops: seconds, and slope in highest values per second
LOOPS_S, STEEPEST = 14.0, 0.5
SMALLEST_DUTY = 1.0 / 15.0  # of a staircase: its first step over its last
LONGEST_ORDER = 20  # of a PRBS: a million levels
# of a multisine: how often; where, over the peak, first and last
CLIPPINGS, CLIP = (100, 1000), (0.75, 0.99)
CLIPPED = 2**26  # samples that all clippings together may take

BAND_HZ = (0.1, 10.0)  # usual; its upper end at most a tenth of the sampling rate
# golden section: parts of a pass at which shapes of several columns begin never meet
APART = 0.5 * (3.0 - 5.0**0.5)

#: signal -> the settings it takes, with their usual values
SIGNAL_SETTINGS: dict[str, dict[str, Any]] = {
    "aprbs": {"duration_s": 200.0, "hold_s": (0.4, 1.6), "levels": None},
    "prbs": {"duration_s": 200.0, "hold_s": (0.1, 1.0)},
    "multisine": {"duration_s": 200.0, "band_hz": BAND_HZ, "periods": 2},
    "chirp": {"duration_s": 200.0, "band_hz": BAND_HZ, "sweep": "log"},
    "steps": {"duration_s": 200.0, "hold_s": (2.0, 2.0)},
    "staircase": {"hold_s": (1.0, 1.0), "levels": 8},
    "torque-loops": {"duration_s": 0.0},
}
IN_TURN = ("chirp", "steps", "staircase", "torque-loops")
SMOOTH = ("multisine", "chirp", "torque-loops")


# ---- shapes ------------------------------------------------------------------------------------


def through(t: Array, *knots: tuple[float, float]) -> Array:
    """Straight lines through (seconds from the knot before, value), from 0 at 0; the last value
    stays."""
    times = np.cumsum([0.0, *(wait for wait, _ in knots)])
    return np.interp(t, times, [0.0, *(value for _, value in knots)])


def odd_multisine(t: Array, seed: int = 11) -> Array:
    """Odd harmonics with random phases, a period in half the length, highest value 0.75."""
    n = len(t) // 2
    top = min(FASTEST_HZ, 0.1 / (t[1] - t[0])) * n * (t[1] - t[0])
    lines = np.unique(2 * (np.geomspace(1.0, max(top, 3.0), 40).astype(int) // 2) + 1)
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, lines.size)
    wave = np.sin(2.0 * np.pi * np.outer(np.arange(len(t)), lines) / n + phases).sum(axis=1)
    return np.asarray(0.75 * wave / np.abs(wave).max())


def slow_reversals(t: Array) -> Array:
    """Triangles nested in each other, with stops."""
    waits = (1.5, 0.5, 3.0, 0.5, 2.0, 1.5, 0.5, 1.5, 1.0, 0.5, 0.5)
    values = (1.0, 1.0, -1.0, -1.0, 0.5, -0.5, -0.5, 0.25, -0.25, -0.25, 0.0)
    return through(t, *zip(waits, values, strict=True))


def speed_runs(t: Array) -> Array:
    """There and back at 4, 0.8, 0.4 and 0.08 of the half range per second."""
    fast = [(0.25, 1.0), (0.5, -1.0), (0.25, 0.0), (0.5, 0.0)]
    middle = [(1.25, 1.0), (2.5, -1.0), (1.25, 0.0)]
    return through(t, *fast, *middle, (1.0, 0.4), (1.0, 0.0), (2.5, 0.2), (2.5, 0.0))


def amplitude_sweep(t: Array) -> Array:
    """Three swings of 1 s each at 5, 10, 25, 50 and 100 % of the half range."""
    height = np.array([0.05, 0.1, 0.25, 0.5, 1.0])[np.minimum((t / 3.0).astype(int), 4)]
    return np.asarray(height * np.sin(2.0 * np.pi * t))


def pulses(t: Array, every: float, each: list[tuple[float, float]]) -> Array:
    """(length s, height) in sequence, a pulse every so many seconds."""
    out = np.zeros(len(t))
    for k, (length, height) in enumerate(each):
        begin = every * (k + 0.25)
        out[(t >= begin) & (t < begin + length)] = height
    return out


def paired_pulses(t: Array) -> Array:
    """There and back for 30 to 500 ms each, a pulse every 1.5 s, over 15 s."""
    return pulses(t, GAP_S, [(length, height) for length in PULSES_S for height in (1.0, -1.0)])


def nested_loops(t: Array) -> Array:
    """Up and down within 14 s: a loop of 3/8, then a loop of 1 with a smaller loop inside."""
    waits = (1.0, 2.0, 1.0, 2.0, 1.0, 1.0, 4.0, 2.0)
    values = (0.375, -0.375, 0.0, 1.0, 0.5, 1.0, -1.0, 0.0)
    return through(t, *zip(waits, values, strict=True))


def washed_out(wave: Array, share: float) -> Array:
    """A wave (samples,) less its running mean over this share of its length, as if it were at rest
    before and after, and less what mean that leaves; within +-1 as before.

    What is left of a slow part falls with the square of its frequency, so that even the second
    integral, the way of a mass that is pushed, stays about where it was.
    """
    half = max(round(0.5 * share * len(wave)), 1)
    total = np.concatenate([np.zeros(half + 1), np.cumsum(wave)])
    total = np.concatenate([total, np.full(half, total[-1])])
    left = wave - (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    left = left - left.mean()
    highest = float(np.abs(left).max())
    return left / highest if highest > 1.0 else left


# ---- signals with settings ---------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """A signal and its settings, as the functions below take them; `plan_for` gives those not named
    their usual values.

    duration_s  of all columns, those that take turns share it; 0: as long as a pass takes
    rate_limit  largest slope in units of a column per second (None: jumps)
    """

    signal: str
    period_s: float
    duration_s: float = 0.0
    hold_s: tuple[float, float] = (0.0, 0.0)
    levels: int | None = None
    band_hz: tuple[float, float] = (0.0, 0.0)
    sweep: str = "log"
    periods: int = 2
    rate_limit: float | None = None
    offset: float = 0.0
    rest: float = 0.0
    seed: int = 0

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that this kind of signal uses, by name."""
        return {name: getattr(self, name) for name in SIGNAL_SETTINGS[self.signal]}


def prbs(plan: Plan, amplitude: float, seed: int, part: float = 0.0) -> Array:
    """A pseudo-random binary sequence of greatest length, shape (round(duration_s / period_s),).

    The ratio of longest to shortest hold, rounded, is the order n of the shift register, whose
    sequence of 2^n - 1 shortest holds is repeated. `part` of that sequence by which this column
    begins later: parts of a sequence that are sent together are as good as independent, if they lie
    further apart than the rig remembers. The two levels are offset +- amplitude; it starts and
    stays at `rest` for the shortest hold, as `aprbs` does.
    """
    from scipy.signal import max_len_seq

    hold_s, period_s = plan.hold_s, plan.period_s
    check_request(plan.duration_s, period_s, amplitude, hold_s)
    order = round(hold_s[1] / hold_s[0])
    if not 2 <= order <= LONGEST_ORDER:
        raise UsageError(
            f"Holds of {hold_s[0]:g} to {hold_s[1]:g} s make a PRBS of order {order}.",
            f"The longest hold is 2 to {LONGEST_ORDER} times the shortest.",
        )
    count, clock = round(plan.duration_s / period_s), round(hold_s[0] / period_s)
    first = np.random.default_rng(seed).integers(1, 2**order)
    later = round(part * (2**order - 1))
    bits, _ = max_len_seq(
        order, state=[int(first) >> k & 1 for k in range(order)], length=later + -(-count // clock)
    )
    levels = plan.offset + amplitude * (2.0 * bits[later:] - 1.0)
    return np.concatenate([np.full(clock, plan.rest), np.repeat(levels, clock)])[:count]


def multisine(plan: Plan, amplitude: float, seed: int | list[int]) -> Array:
    """Odd harmonics of equal height within the band, shape (round(duration_s / period_s),).

    Phases are drawn and then improved by clipping, until offset +- amplitude holds as much power as
    it can: crest factor 1.41 to 1.5 for bands of a decade or more, up to 1.65 for narrow ones and
    for 10 000 harmonics and more (a sine has 1.41). What a rig answers between the odd harmonics it
    has bent itself. `periods` equal periods fill the duration; the signal begins where it is next
    to the offset.
    """
    band_hz, periods, count = plan.band_hz, plan.periods, _samples(plan, amplitude)
    if not 1 <= periods <= count // 8:
        raise UsageError(f"{count} samples are too few for {periods} periods.")
    period = count // periods
    base = 1.0 / (period * plan.period_s)
    lines = np.arange(1, period // 2, 2)
    lines = lines[
        (lines * base >= band_hz[0] * (1.0 - 1e-9)) & (lines * base <= band_hz[1] * (1.0 + 1e-9))
    ]
    if not lines.size:
        raise UsageError(
            f"Odd harmonics lie {2.0 * base:.3g} Hz apart: none from {band_hz[0]:g} to "
            f"{band_hz[1]:g} Hz.",
            "Take fewer periods, a longer signal or a wider band.",
        )
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * _flat_phases(lines, np.random.default_rng(seed)))
    wave = np.fft.irfft(spectrum, period)
    wave = np.roll(wave, -int(np.argmin(np.abs(wave))))
    return np.asarray(plan.offset + amplitude * np.resize(wave / np.abs(wave).max(), count))


def chirp(plan: Plan, amplitude: float) -> Array:
    """A sine about the offset whose frequency climbs through the band, "linear" or "log", shape
    (n,).

    Frequencies are lowered by up to a part of a cycle, so that it ends where it began, at the
    offset.
    """
    from scipy.signal import chirp as swept

    count = _samples(plan, amplitude)
    low, high = plan.band_hz
    length = count * plan.period_s
    log = plan.sweep == "log"
    cycles = length * ((high - low) / math.log(high / low) if log else 0.5 * (low + high))
    if cycles < 1.0:
        raise UsageError(
            f"{length:g} s have no room for a cycle of a sweep from {low:g} to {high:g} Hz."
        )
    whole = math.floor(cycles * (1.0 + 1e-12)) / cycles
    method, time = "logarithmic" if log else "linear", plan.period_s * np.arange(count)
    wave = swept(time, low * whole, length, high * whole, method, phi=-90)
    return np.asarray(plan.offset + amplitude * wave)


def steps(plan: Plan, amplitude: float, seed: int) -> Array:
    """Steps to offset + amplitude and offset - amplitude by turns, shape (n,), a rest at the offset
    before and after; holds are drawn uniformly."""
    check_request(plan.duration_s, plan.period_s, amplitude, plan.hold_s)
    count = round(plan.duration_s / plan.period_s)
    heights = np.resize([1.0, -1.0], math.ceil(plan.duration_s / plan.hold_s[0]))
    rest = np.zeros(max(1, round(plan.hold_s[0] / plan.period_s)))
    held = np.repeat(heights, _lengths(heights.size, plan, seed))[: count - 2 * rest.size]
    return plan.offset + amplitude * np.concatenate([rest, held, rest])


def staircase(plan: Plan, amplitude: float, seed: int) -> Array:
    """There and back at heights that grow from a fifteenth of the amplitude to all of it, each by
    the same factor; a rest at the offset before and after. Small commands weigh as much as large
    ones, and nothing drifts away."""
    levels = plan.levels or 8
    heights = np.geomspace(SMALLEST_DUTY, 1.0, max(levels, 2))
    stairs = np.concatenate([[0.0], np.stack([heights, -heights], axis=1).ravel(), [0.0]])
    seconds = stairs.size * plan.hold_s[1]
    check_request(seconds, plan.period_s, amplitude, plan.hold_s, levels)
    return plan.offset + amplitude * np.repeat(stairs, _lengths(stairs.size, plan, seed))


def _samples(plan: Plan, amplitude: float) -> int:
    low, high = plan.band_hz
    check_request(plan.duration_s, plan.period_s, amplitude, (plan.period_s, plan.period_s))
    if not 0.0 < low < high < 0.5 / plan.period_s:
        raise UsageError(
            f"The band is {low:g} to {high:g} Hz; it must rise and end below half of "
            f"the sampling rate, {0.5 / plan.period_s:g} Hz."
        )
    return round(plan.duration_s / plan.period_s)


def _lengths(count: int, plan: Plan, seed: int) -> NDArray[np.int64]:
    """Holds in samples."""
    drawn = np.random.default_rng(seed).uniform(*plan.hold_s, count)
    return np.maximum(1, np.round(drawn / plan.period_s)).astype(np.int64)


def _flat_phases(lines: NDArray[np.int64], random: np.random.Generator) -> Array:
    """Phases of these harmonics, drawn and improved by clipping the wave and taking the phases of
    what is left: van der Ouderaa, Schoukens and Renneboog (1988), with a limit that rises to the
    peak."""
    phases = random.uniform(0.0, 2.0 * np.pi, lines.size)
    grid = 2 ** math.ceil(math.log2(16 * int(lines[-1])))
    best, lowest = phases, math.inf
    for limit in np.linspace(*CLIP, int(np.clip(CLIPPED // grid, *CLIPPINGS))):
        spectrum = np.zeros(grid // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(1j * phases)
        wave = np.fft.irfft(spectrum, grid)
        if crest(wave) < lowest:
            best, lowest = phases, crest(wave)
        edge = limit * np.abs(wave).max()
        phases = np.angle(np.fft.rfft(np.clip(wave, -edge, edge))[lines])
    return best


# ---- several columns ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sent:
    """A column: samples (n,), the samples in which it is excited, its seed or the part
    of the sequence."""

    samples: Array
    turn: slice
    settings: dict[str, Any]


def plan_for(
    signal: str,
    period_s: float,
    *,
    rate_limit: float | None = None,
    offset: float = 0.0,
    seed: int = 0,
    **given: Any,
) -> Plan:
    """A plan; settings of value None count as not given. UsageError for a setting that the signal
    does not take."""
    if signal not in SIGNAL_SETTINGS:
        raise UsageError(
            f"There is no signal {signal!r}.",
            nearest(signal, SIGNAL_SETTINGS) or f"Signals: {', '.join(SIGNAL_SETTINGS)}.",
        )
    stated = {name: value for name, value in given.items() if value is not None}
    for name in stated:
        if name not in SIGNAL_SETTINGS[signal]:
            takers = " and ".join(s for s, settings in SIGNAL_SETTINGS.items() if name in settings)
            hint = f"It belongs to {takers or 'no signal'}."
            raise UsageError(f"{name} does not apply to the signal {signal}.", hint)
    if not (math.isfinite(period_s) and period_s > 0.0):
        raise UsageError(f"The period is {period_s:g}; it must be positive.")
    if rate_limit is not None and not (math.isfinite(rate_limit) and rate_limit > 0.0):
        raise UsageError(f"The rate limit is {rate_limit:g}; it must be positive.")
    fastest = min(BAND_HZ[1], 0.1 / period_s)
    usual = {**SIGNAL_SETTINGS[signal], "band_hz": (fastest * BAND_HZ[0] / BAND_HZ[1], fastest)}
    settings = {name: usual[name] for name in SIGNAL_SETTINGS[signal]} | stated
    return Plan(signal, period_s, **settings, rate_limit=rate_limit, offset=offset, seed=seed)


def draw(
    plan: Plan,
    amplitudes: Mapping[str, float],
    offsets: Mapping[str, float] = MappingProxyType({}),
    ramped: Collection[str] = (),
    rests: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Sent]:
    """The columns, each with its amplitude and its offset (else the plan's), all of equal length;
    the first of random signals is what it is alone. ramped: columns that go from level to level in
    ramps; rests: where random steps begin (else at 0)."""
    turns = len(amplitudes) if plan.signal in IN_TURN else 1
    duration = plan.duration_s / turns
    if plan.signal == "torque-loops" and not plan.duration_s:
        slowed = STEEPEST * max(amplitudes.values()) / plan.rate_limit if plan.rate_limit else 1.0
        duration = LOOPS_S * max(1.0, slowed)
    drawn = {}
    for k, (column, amplitude) in enumerate(amplitudes.items()):
        offset, settings = offsets.get(column, plan.offset), dict[str, Any]()
        if plan.signal not in ("chirp", "torque-loops"):
            several = k and plan.signal in ("aprbs", "multisine")
            settings["seed"] = [plan.seed, k] if several else plan.seed
        if plan.signal == "prbs":
            settings["part"] = k * APART % 1.0
        rest = rests.get(column, plan.rest)
        active = replace(plan, duration_s=duration, offset=offset, rest=rest)
        wave = _MAKERS[plan.signal](active, amplitude, **settings)
        if column in ramped and plan.signal not in SMOOTH:
            wave = ramps(wave)
        first = (k if turns > 1 else 0) * len(wave)
        turn = slice(first, first + len(wave))
        samples = np.full(turns * len(wave), offset, dtype=float)
        samples[turn] = wave
        if plan.rate_limit is not None:
            samples = _within(plan, column, amplitude, samples, plan.rate_limit)
        drawn[column] = Sent(samples, turn, settings)
    return drawn


def ramps(samples: Array) -> Array:
    """Steps (n,) as ramps: each level is reached where the next would begin, so that the speed
    is another from ramp to ramp."""
    begins = np.flatnonzero(np.diff(samples)) + 1
    knots = np.concatenate([[0], begins, [len(samples) - 1]])
    levels = np.concatenate([[samples[0]], samples[begins - 1], [samples[-1]]])
    return np.interp(np.arange(len(samples)), knots, levels)


def _within(plan: Plan, column: str, amplitude: float, samples: Array, limit: float) -> Array:
    if plan.signal not in SMOOTH:
        return slew(samples, limit * plan.period_s)
    fastest = float(np.abs(np.diff(samples)).max()) / plan.period_s
    if fastest > limit * (1.0 + 1e-9):
        other = "--duration longer" if plan.signal == "torque-loops" else "--band lower"
        raise UsageError(
            f"{column} moves at up to {fastest:.4g} units per s; the rate limit is {limit:g}.",
            f"Make --amplitude at most {amplitude * limit / fastest:.3g}, or {other}.",
        )
    return samples


def _torque_loops(p: Plan, amplitude: float) -> Array:
    check_request(p.duration_s, p.period_s, amplitude, (p.period_s, p.period_s))
    t = p.period_s * np.arange(round(p.duration_s / p.period_s), dtype=np.float64)
    return amplitude * nested_loops(LOOPS_S / p.duration_s * t)


_MAKERS: dict[str, Callable[..., Array]] = {
    "aprbs": lambda p, a, seed: aprbs(
        p.duration_s, p.period_s, a, p.hold_s, p.levels, seed=seed, offset=p.offset, rest=p.rest
    ),
    "prbs": prbs,
    "multisine": multisine,
    "chirp": chirp,
    "steps": steps,
    "staircase": staircase,
    "torque-loops": _torque_loops,
}
