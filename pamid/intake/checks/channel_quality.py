"""Measurement quality of a channel: clipped, frozen, filled in, spiked, coarse, noisy, or dead.

Machines rest, turn and creep, so that a channel may well repeat its value. A repeat is only a fault
if the channel should have continued. Its motion then has a corner there or leaps on behind it, or
its white noise stops and returns (`has_noise_around`). With white noise of deviation sigma, two
readings fall on the same step q with probability P = q/(2 sqrt(pi) sigma). A run of n repeats by
chance is rarer than CHANCE from n = 1 + log(CHANCE)/log(P) on (`shortest_repeat`).

    finding   statistic and threshold
    clipped   runs at the extreme value, longer than chance, at least SHORTEST_CLIP samples: two of
              them with corners sharper than CORNER_STEPS steps, CORNER_NOISE sigma and CORNER_SPAN
              of the span
    frozen    run of repeats while others move, at least SHORTEST_FREEZE: twice as long as chance
              and surrounded by noise, where repeats are as rare as chance elsewhere; or a stretch
              that ends with a step JUMP times the largest step nearby
    bridged   second differences below 0.02 sigma over SHORTEST_LINE samples, surrounded by noise
    spikes    a sample or two beyond both neighbours by SPIKE_NOISE sigma, SPIKE_SPAN of the
              span and SPIKE_BEND times the 98 % quantile of second differences
    dead      standard deviation below ONLY_NOISE sigma, or a span of a single step
    coarse    step, or spacing of plateaus, above COARSE_STEP of the span
    noisy     sigma above NOISY of the standard deviation and twice what the sensor is known for
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import motion, runs_of
from pamid.intake.checks.findings import QualityIssue, issue, share_words, unit_after
from pamid.recording.file_checks import HUGE, TINY
from pamid.recording.noise import MAY_BE_NOISE, is_white, noise_level, plateaus, quantisation_step
from pamid.recording.recording import SIGNIFICANT_DIGITS

Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

MOST_WINDOWS = 60
SHORTEST_CLIP = 3  # samples at the very extreme
SHORTEST_FREEZE = 10  # samples
MORE_REPEATS = 3.0  # times as many short repeats as noise makes: readings are not independent
SHORTEST_LINE = 12  # samples on a straight line, where noise should be
CHANCE = 1e-4  # of a false alarm per channel, for what noise could do
CORNER_STEPS, CORNER_NOISE, CORNER_SPAN = 12.0, 4.0, 1e-3
# samples on either side of a stretch in which noise has to show, and the share of it that has to
AROUND, NOISE_AROUND = 12, 0.4
JUMP = 8.0  # over the largest step nearby: how a frozen channel goes on
SPIKE_NOISE, SPIKE_SPAN, SPIKE_BEND = 12.0, 0.02, 4.0
COARSE_STEP = 0.01  # of the span
# share of repeats of a signal that goes in steps; plateaus that a channel crosses for each of these
# steps at most, if they are levels of the machine
STEPPED, CROSSINGS = 0.8, 2.0
# number of changes that determine a grain, and the tolerance of the largest change, in grains
GRAIN_CHANGES, OFF_GRAIN = 50, 0.05
NOISY = 0.2  # of the standard deviation
ONLY_NOISE = 1.5  # times the noise
PLUGGED = "Check that the sensor is connected and that the channel is the right one."
#: share of a recording: a shorter standstill is usual before an experiment or after a step
LONG_STANDSTILL = 0.4
# of the runs are equally long: the channel is sampled more slowly and held
HELD_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class CheckedSignal:
    """A column with its step and noise; numbers in the column's unit.

    sent    commands and references: they may stand still, jump and sit at their limits
    step    quantisation step, 0 if there is none, or for a command
    noise   standard deviation of the part that changes from sample to sample
    white   True if sensor noise exceeds the step
    grain   common divisor of all changes from sample to sample: an encoder that is faster than its
            counts has levels too far apart for a step; 0 if there is none
    """

    name: str
    time: Array
    values: Array
    sent: bool
    span: float
    step: float
    noise: float
    white: bool
    grain: float = 0.0

    @property
    def unit(self) -> str:
        return unit_after(self.name)

    @cached_property
    def still(self) -> Mask:
        """Mask of the samples that equal the sample before."""
        return np.concatenate([[False], self.values[1:] == self.values[:-1]])

    @cached_property
    def still_share(self) -> float:
        return float(self.still.mean())


def signal_of(name: str, time: Array, values: Array, sent: bool = False) -> CheckedSignal:
    """Measure step and noise of a column; all are 0 if it is constant or not `measurable`.

    time, values: stamps (s) and readings (n,). sent: True for a command or a reference.
    """
    span = motion(values) if measurable(values) else 0.0
    if span == 0.0:
        return CheckedSignal(name, time, values, sent, 0.0, 0.0, 0.0, False)
    step = 0.0 if sent else quantisation_step(values)
    noise = float(noise_level(values[:, None])[0])
    noise = noise if noise > MAY_BE_NOISE * float(values.std()) else 0.0
    last_digit = 10.0 ** (math.floor(math.log10(np.abs(values).max())) + 1 - SIGNIFICANT_DIGITS)
    white = noise > max(step, last_digit) and is_white(values)
    grain = 0.0 if sent else grain_of(values)
    return CheckedSignal(name, time, values, sent, span, step, noise, white, grain)


def grain_of(values: Array) -> float:
    """Smallest change from sample to sample, if all others are multiples of it; else 0."""
    d = np.abs(np.diff(values))
    d = d[d > float(np.abs(values).max()) * 10.0**-SIGNIFICANT_DIGITS]
    if d.size < GRAIN_CHANGES:
        return 0.0
    counts = d / d.min()
    return float(d.min()) if np.abs(counts - np.round(counts)).max() < OFF_GRAIN else 0.0


def measurable(values: Array) -> bool:
    """True if a sensor could output these numbers, and if their squares are finite."""
    most = float(np.abs(values).max())
    return most == 0.0 or TINY < most < HUGE


# ---- stretches ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stretches:
    """Intervals [start, stop) of samples, in order."""

    time: Array
    starts: Places
    stops: Places

    @classmethod
    def of(cls, time: Array, mask: Mask) -> Stretches:
        return cls(time, *runs_of(mask))

    def only(self, chosen: Mask | slice) -> Stretches:
        return Stretches(self.time, self.starts[chosen], self.stops[chosen])

    def each(self, check: Callable[[int, int], bool]) -> Mask:
        pairs = zip(self.starts.tolist(), self.stops.tolist(), strict=True)
        return np.array([check(a, b) for a, b in pairs], dtype=bool)

    @property
    def lengths(self) -> Places:
        return self.stops - self.starts

    @property
    def figures(self) -> dict[str, float]:
        longest = float(self.lengths.max())
        return {"share": float(self.mask.mean()), "longest_samples": longest}

    @property
    def mask(self) -> Mask:
        edges = np.zeros(self.time.size + 1, dtype=np.int64)
        np.add.at(edges, self.starts, 1)
        np.add.at(edges, self.stops, -1)
        return np.cumsum(edges[:-1]) > 0

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """Intervals as times. Close intervals are joined until at most 60 remain."""
        gap = 5
        while self.starts.size:
            separated = self.starts[1:] - self.stops[:-1] > gap
            first = self.starts[np.concatenate([[True], separated])]
            last = self.stops[np.concatenate([separated, [True]])] - 1
            if first.size <= MOST_WINDOWS:
                return tuple(zip(self.time[first].tolist(), self.time[last].tolist(), strict=True))
            gap *= 2
        return ()


# ---- findings ----------------------------------------------------------------------------------


def clipping(s: CheckedSignal, idle: Mask) -> tuple[list[QualityIssue], Mask]:
    """Intervals at the extreme value of a measured signal, and their mask.

    idle: mask of the samples at which the machine may rest.
    """
    issues, where = [], np.zeros(s.values.size, dtype=bool)
    for sign, word in ((1.0, "highest"), (-1.0, "lowest")):
        z = sign * s.values
        top = float(z.max())
        at_top = Stretches.of(s.time, (z >= top - 1e-9 * s.span) & ~idle)
        at_top = at_top.only(at_top.lengths >= max(SHORTEST_CLIP, shortest_repeat(s)))
        if not s.white and abs(top) <= max(2.0 * s.step, CORNER_SPAN * s.span):
            continue  # a natural end: slack, vented, shut
        least = CORNER_NOISE * s.noise if s.white else CORNER_STEPS * max(s.step, s.grain)
        least = max(least, CORNER_SPAN * s.span)
        # a corner: at the speed with which it reached or left the top, the signal would have gone
        # this far beyond it, there and back within the time at the top, with at most 20 samples
        starts, stops = at_top.starts, at_top.stops
        rise = z[starts] - z[np.maximum(starts - 3, 0)]
        fall = z[stops - 1] - z[np.minimum(stops + 2, z.size - 1)]
        corners = np.maximum(rise, fall) / 3.0 * np.minimum(stops - starts, 20) / 2.0 > least
        if corners.sum() < 2:
            # a turning point or a rest; a valve that shuts stops a pressure as sharply, but not
            # twice at the same value
            continue
        at_top = at_top if s.white else at_top.only(corners)
        where |= at_top.mask
        message = (
            f"{s.name} is clipped at its {word} value, {sign * top:.6g}{s.unit}, "
            f"{share_words(at_top.figures['share'])}"
        )
        hint = (
            "Use a wider measuring range or a smaller motion. Until then leave these stretches out."
        )
        figures = {"level": sign * top, **at_top.figures}
        issues.append(issue("clipped", s.name, message, hint, figures, at_top.windows))
    return issues, where


def sampled_slowly(s: CheckedSignal) -> int:
    """Number of samples per real change of the channel; 1 if it changes freely."""
    moved = np.flatnonzero(~s.still)
    lengths = np.diff(moved)
    if lengths.size < 30 or s.values.size < 2:
        return 1
    usual = int(np.bincount(lengths).argmax())
    jumps = np.abs(np.diff(s.values[moved]))
    beyond_a_step = float(np.mean(jumps > 1.5 * s.step)) if s.step else 1.0
    held = np.mean(lengths == usual) >= HELD_SHARE and beyond_a_step > 0.2
    return usual if held else 1


def repeat_chance(s: CheckedSignal) -> float:
    """Probability that noise alone repeats a value.

    White noise of deviation sigma falls on the same step twice in a row.
    """
    # 1 / (2 sqrt(pi)): the density at zero of the difference of two readings, N(0, 2 sigma^2)
    return min(1.0, max(0.2821 * max(s.step, s.grain) / s.noise, 1e-9)) if s.white else 1.0


def shortest_repeat(s: CheckedSignal) -> float:
    """Shortest run of equal samples that noise cannot explain.

    It is 1 without visible noise, and infinite if the noise is smaller than a step, because then
    all samples are equal.
    """
    if not s.white:
        return 1.0
    chance = repeat_chance(s)
    return 1.0 + math.log(CHANCE) / math.log(chance) if chance < 1.0 else math.inf


def independent(s: CheckedSignal, aside: Mask) -> bool:
    """True if the noise is white and readings repeat as rarely as it predicts.

    aside: samples to ignore. An encoder whose noise only shows in motion repeats at turning points
    and at rest.
    """
    if not s.white:
        return False
    lengths = Stretches.of(s.time, s.still & ~aside).lengths
    repeats = int(lengths[lengths < SHORTEST_FREEZE].sum())
    return repeats <= MORE_REPEATS * max(1.0, repeat_chance(s) * s.values.size)


def standstills(
    s: CheckedSignal, aside: Mask, liveliest: CheckedSignal | None
) -> tuple[list[QualityIssue], Mask]:
    """Intervals in which the channel stands exactly still while others move, and their mask.

    aside: mask of the samples with another explanation already. liveliest: the other channel with
    the smallest share of standstill; None without any.
    """
    still = Stretches.of(s.time, s.still & ~aside)
    chance = 2.0 * shortest_repeat(s) if independent(s, aside) else math.inf
    frozen = still.each(
        lambda a, b: (
            liveliest is not None
            and b - a >= SHORTEST_FREEZE
            and (_jumps_on(s, a, b) or (b - a >= chance and has_noise_around(s, a, b)))
            and not liveliest.still[a:b].all()
        )
    )
    still = still.only(frozen)
    if not still.starts.size:
        return [], still.mask
    message = f"{s.name} stands still while the others move, {share_words(still.figures['share'])}"
    hint = "Check its connector, bus and driver. Leave these stretches out."
    return [issue("frozen", s.name, message, hint, still.figures, still.windows)], still.mask


def _jumps_on(s: CheckedSignal, start: int, stop: int) -> bool:
    """True if the signal leaves a standstill with a step far larger than those around it."""
    if stop >= s.values.size:
        return False
    d = np.abs(np.diff(s.values[max(0, start - 22) : stop + 22]))
    at = stop - 1 - max(0, start - 22)
    neighbour = float(max(d[:at].max(initial=0.0), d[at + 1 :].max(initial=0.0)))
    return bool(d[at] > JUMP * max(neighbour, 0.5 * s.step) and d[at] > 1e-3 * s.span)


def has_noise_around(s: CheckedSignal, start: int, stop: int) -> bool:
    """True if the usual noise shows right before and right after an interval.

    If the channel rests or turns, one side at least has less noise.
    """
    before, behind = s.values[max(0, start - AROUND) : start], s.values[stop : stop + AROUND]
    # second differences: their median in white noise of deviation sigma is 0.6745 sqrt(6) sigma
    usual = 0.6745 * math.sqrt(6.0) * s.noise
    return all(
        side.size == AROUND and float(np.median(np.abs(np.diff(side, n=2)))) > NOISE_AROUND * usual
        for side in (before, behind)
    )


def interpolated_gaps(s: CheckedSignal, aside: Mask) -> list[QualityIssue]:
    """Intervals on an exact straight line, where noise should be: an interpolated gap."""
    if not s.white:
        return []
    bend = np.abs(np.diff(s.values, n=2))
    flat = np.concatenate([[False], bend < 0.02 * s.noise, [False]]) & ~aside & ~s.still
    lines = Stretches.of(s.time, flat)
    lines = lines.only(
        lines.each(lambda a, b: b - a >= SHORTEST_LINE and has_noise_around(s, a, b))
    )
    if not lines.starts.size:
        return []
    share = float(lines.lengths.sum()) / s.values.size
    message = (
        f"{s.name} follows a straight line without noise, like an interpolated gap, "
        f"{share_words(share)}"
    )
    hint = "Ingest the raw log again with a smaller max_gap_s, which splits it there."
    return [issue("bridged", s.name, message, hint, {"share": share}, lines.windows)]


def spikes(s: CheckedSignal) -> list[QualityIssue]:
    """Excursions of a sample or two."""
    y = s.values
    bend = float(np.quantile(np.abs(np.diff(y, n=2)), 0.98))
    low, high = np.quantile(y, [0.001, 0.999])
    least = max(
        SPIKE_NOISE * s.noise, SPIKE_SPAN * float(high - low), SPIKE_BEND * bend, 4.0 * s.step
    )
    out = np.zeros(y.size, dtype=bool)
    for wide in (1, 2):
        before, behind = y[: -wide - 1], y[wide + 1 :]
        inner = [y[k : k + before.size] for k in range(1, wide + 1)]
        # beyond both neighbours: a neighbour of a step lies on its level, so that a step is none
        up = np.minimum.reduce(inner) - np.maximum(before, behind) > least
        down = np.minimum(before, behind) - np.maximum.reduce(inner) > least
        for k in range(1, wide + 1):
            out[k : k + before.size] |= up | down
    places, where = np.flatnonzero(out), Stretches.of(s.time, out)
    if not places.size:
        return []
    around = y[np.maximum(places - 2, 0)] + y[np.minimum(places + 2, y.size - 1)]
    size, count = float(np.abs(y[places] - 0.5 * around).max()), where.starts.size
    message = f"{s.name} has {count} spike{'' if count == 1 else 's'} of up to {size:.3g}{s.unit}"
    hint = "Look for a loose contact or a bus error; replace these samples or leave them out."
    figures = {"count": float(count), "largest": size}
    return [issue("spikes", s.name, message, hint, figures, where.windows)]


def shows_only_noise(s: CheckedSignal) -> bool:
    return s.span <= 1.01 * s.step or s.white and float(s.values.std()) < ONLY_NOISE * s.noise


def level_issues(
    s: CheckedSignal,
    others_move: bool,
    usual_noise: float = 0.0,
    sent: Sequence[CheckedSignal] = (),
) -> list[QualityIssue]:
    """Findings on a channel that is dead, coarse or noisy throughout.

    usual_noise: typical noise of its sensor, in the column's unit; 0 if unknown. sent: commands
    that may move the machine from level to level.
    """
    y, numbers = s.values, {"step": s.step, "noise": s.noise, "span": s.span}
    low, high = np.quantile(y, [0.002, 0.998])
    if shows_only_noise(s):
        message = (
            f"{s.name} contains only noise ({max(s.noise, s.step):.2g}{s.unit}) around "
            f"{float(y.mean()):.6g}{s.unit} while the others move"
        )
        return [issue("dead", s.name, message, PLUGGED, numbers)] if others_move else []
    spacing, level = (0.0, 0.0) if s.sent else plateaus(y)
    if spacing:
        # a command that mostly rests, and changes as often: the machine was sent to these levels
        crossings = np.count_nonzero(np.diff(np.round((y - level) / spacing)))
        changes = [np.count_nonzero(~o.still) - 1 for o in sent if o.still_share > STEPPED]
        spacing = 0.0 if any(crossings <= CROSSINGS * n for n in changes) else spacing
    if (step := spacing or s.step) > COARSE_STEP * float(high - low) > 0.0:
        finer = (
            "; the value is rounded before the logger, which has a finer resolution"
            if spacing
            else ""
        )
        message = (
            f"{s.name} has a resolution of {step:.3g}{s.unit}, only "
            f"{float(high - low) / step:.0f} steps over its range{finer}"
        )
        hint = (
            "Use a smaller range of the converter, a finer sensor, or a larger excitation. An "
            "effect smaller than a step cannot be seen."
        )
        return [issue("coarse", s.name, message, hint, numbers)]
    if s.noise > max(NOISY * float(y.std()), 2.0 * usual_noise):
        message = (
            f"{s.name} has a noise of {s.noise:.2g}{s.unit} (rms) in a signal of "
            f"{float(y.std()):.2g}{s.unit}"
        )
        hint = "Check the shielding, the earthing and the filter."
        return [issue("noisy", s.name, message, hint, numbers)]
    return []


def standstill(
    measured: Sequence[CheckedSignal], sent: Sequence[CheckedSignal]
) -> list[QualityIssue]:
    """Longest stretch in which every measured channel repeats its value, if it is long.

    Repeats carry no information. They are fitted and held out like motion, and a model at rest is
    exact there. A channel that is constant throughout is another finding.
    """
    moving = [s for s in measured if s.span > 0.0]
    if not moving:
        return []
    time = moving[0].time
    still = Stretches.of(time, np.logical_and.reduce([s.still for s in moving]))
    if not still.starts.size:
        return []
    longest = int(np.argmax(still.lengths))
    # from the value that is repeated
    first, stop = int(still.starts[longest]) - 1, int(still.stops[longest])
    share = (stop - first) / time.size
    if share < LONG_STANDSTILL:
        return []
    driven = [s.name for s in sent if s.span > 0.0 and not s.still[first + 1 : stop].all()]
    resting = [s.name for s in (*moving, *sent) if s.span > 0.0 and s.name not in driven]
    message = (
        f"{' and '.join(resting)} {'stands' if len(resting) == 1 else 'stand'} still"
        f"{f' while {driven[0]} moves' if driven else ''} {share_words(share)}"
    )
    look = "Check the sensor and the logger there, and cut" if driven else "Cut"
    hint = f"{look} the recording to the part that moves."
    figures = {"share": share, "longest_samples": float(stop - first)}
    window = (float(time[first]), float(time[stop - 1]))
    return [issue("standstill", tuple(resting), message, hint, figures, [window])]
