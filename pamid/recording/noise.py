"""Noise and quantisation step of a channel, estimated from its samples.

Noise is estimated from differences (Gasser, Sroka and Jennen-Steinmetz 1986, Biometrika 73(3)):
those of order k take away what a polynomial of degree k - 1 follows, and of white noise of
deviation sigma they have variance binomial(2k, k) sigma^2. Of a motion at w rad per sample they
leave (2 sin(w/2))^k, which grows slower with k than that of the noise: every order gives at most
too much, and the least of them is nearest (Hall, Kay and Titterington 1990, Biometrika 77(3), on
the order). Their median absolute value over 0.6745 is the robust estimate of their deviation
(Hampel 1974, JASA 69). Rounding to steps adds the deviation of a
uniform variable, step/sqrt(12). Both results are in the channel's unit: the same samples in another
unit give the same answer, scaled.

Under a controller the noise of a sensor enters the inputs, and these move the machine at the rate
of the samples. Such motion looks like noise to every order of differences. It is linear in the
latest inputs, so that least squares on their differences remove it. They remove the noise of a
sensor that is fed back as well: more than the rig states is taken for such motion, less is not.

A reading that repeats to the last digit is not a new reading: the sensor rests, clings, is at its
limit, or was filled in. Differences over such repeats measure no noise and are left out. A reading
that clings while the machine moves lags behind by up to the leap h that follows. The error grows
from 0 to h during the hold, which is h/sqrt(3) root mean square (`hold_error`). It is correlated
over the hold, so that averaging does not reduce it. A converter with regular steps does not cling:
its error is centred, step/sqrt(12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import SAME_DIGITS, motion

ALIKE_GAPS = 0.2  # of the smallest gap between levels: gaps this close to it are a single step
MOST_LEVELS = 20000  # levels looked at, those in the middle
# steps to the next level: over wider gaps an error of the step adds up
NEAR_STEPS = 20.0
LAGS = (1, 2, 4, 8, 16, 32)  # levels that gaps reach over; beyond, a converter's bend shows
# steps by which gaps miss a whole number, on average; 0.25 where there is no step
OFF = 0.1
FEW_GAPS, OFF_OF_FEW_GAPS = 10, 0.02  # of so few gaps each has to be whole to this
# with so many gaps, parts of the smallest are tried: no two neighbouring levels may be met
MANY_GAPS, FINEST = 30, 16
STRAIGHT = 0.8  # of all moves: more of them like the move before are a line, not steps
BLOCK = 40  # samples over which differences are squared
FEW_MOVING = 80  # samples: fewer show no noise by their differences
# share of a channel's readings that repeat: beyond it, the error of a reading is not independent
REPEATING = 0.1
# leaps after a hold from which a lag is measured, and share of the samples that they have to span
FEW_LEAPS, LAGGING = 20, 0.1
DRIVEN_HOLD = 0.5  # of a hold: the inputs have to move for so long before a rest counts as clinging
OTHER_NOISE = 2.0  # ratio of observed and stated noise beyond which they contradict each other
LEAST_BELIEVED = 1e-6  # of the standard deviation: less noise than this is not believed
# of the noise: a model that is off by less is not separated from an exact model. Noise that is read
# from a recording may be several times too large, but not a hundred times.
NEGLIGIBLE_ERROR = 0.01
MAY_BE_NOISE = 1.5 * LEAST_BELIEVED  # more than this may be noise
INPUT_LAGS, INPUT_ORDER = 4, 4  # latest inputs, and the order of the differences that are fitted
UNIFORM = 1.0 / np.sqrt(12.0)  # standard deviation of what rounding to steps adds, in steps
LAG = 1.0 / np.sqrt(3.0)  # root mean square of an error that grows from 0 to 1
# plateaus further apart than the recorder's steps: cycles of their spacing in the span of a
# channel, and the share of its samples that must lie on them for it to be believed
HISTOGRAM_BINS, PADDED, LEAST_PLATEAUS, ON_PLATEAUS = 1 << 15, 8, 5, 0.8
PLATEAUS_APART = 6.0  # recorder's steps, or plateaus' widths, to the next plateau
#: order of the differences -> their standard deviation in white noise of 1
ORDERS = {k: math.sqrt(math.comb(2 * k, k)) for k in (4, 6, 8, 12)}
MEDIAN = 0.6745  # median absolute value of a normal variable of deviation 1: its upper quartile


def quantisation_step(values: Array) -> float:
    """The step of which all differences between the levels of a channel, shape (n,), are multiples;
    0 where there is none. Levels may be off by a third of a step (counts printed with few
    decimals), and most may never be met."""
    levels = np.unique(values)
    levels = levels[max(0, levels.size - MOST_LEVELS) // 2 :][:MOST_LEVELS]
    gaps = np.diff(levels)
    distinct = gaps > SAME_DIGITS * float(np.abs(levels).max(initial=0.0))
    levels, gaps = levels[np.concatenate([[True], distinct])], gaps[distinct]
    if gaps.size < 2:
        return float(gaps.sum())
    # the mean of all gaps of a step: each is off by the digits of the file
    smallest = float(np.quantile(gaps, 0.02, method="lower"))
    usual = float(gaps[np.abs(gaps - smallest) < ALIKE_GAPS * smallest].mean())
    for finer in range(1, FINEST + 1 if gaps.size >= MANY_GAPS else 2):
        if step := _lattice(levels, usual / finer):
            # a line without any steps mostly moves by as many as the sample before
            moves = np.round(np.diff(values) / step)
            alike = np.sum((moves[1:] == moves[:-1]) & (moves[1:] != 0.0))
            return 0.0 if alike > STRAIGHT * np.count_nonzero(moves) else step
    return 0.0


def _lattice(levels: Array, step: float) -> float:
    """The step near this step of which the levels, in order, are multiples; 0 where they are not.
    Over ever wider gaps: what levels are off by does not add up, a smooth motion that only seems to
    go in steps is found out."""
    for lag in LAGS:
        if lag > 1 and levels.size < 4 * lag:
            break
        gaps = levels[lag:] - levels[:-lag]
        for most in (NEAR_STEPS / 4.0, NEAR_STEPS):
            near = gaps[gaps < most * lag * step]
            # least squares of gaps = counts x step, the counts by the step known so far
            counts = np.maximum(np.round(near / step), 1.0)
            step = float(near @ counts / (counts @ counts)) if near.size else step
        off = np.abs(near / step - np.maximum(np.round(near / step), 1.0))
        if near.size <= 0.5 * gaps.size or (
            off.mean() > OFF if off.size > FEW_GAPS else off.max() > OFF_OF_FEW_GAPS
        ):
            return 0.0
    return step


def plateaus(values: Array) -> tuple[float, float]:
    """Spacing of the plateaus on which a channel, shape (n,), rests although its step is finer,
    and the plateau that is nearest to the middle of what was recorded: the zero of a scale, in
    kelvin or gauge pressure, need not be a plateau. Both 0 where there are none.

    Something on the way to the recorder rounds, and something after it adds noise: no recorder's
    step, whose readings are exact. The levels are lines of the characteristic function
    |mean exp(2 pi i f x)|: 1 at f = 1/spacing where every sample lies on a level, and
    exp(-2 (pi w f)^2) where plateaus have the width w (standard deviation); its phase tells where
    the levels are.
    """
    low, span, step = float(values.min()), motion(values), quantisation_step(values)
    if not span > 0.0:
        return 0.0, 0.0
    counts = np.histogram(values, HISTOGRAM_BINS, (low, low + span))[0]
    # padded: a line between two cycles is seen, too
    lines = np.abs(np.fft.rfft(counts, PADDED * HISTOGRAM_BINS)) / values.size
    lines = lines[: PADDED * HISTOGRAM_BINS // 8]
    cycles = np.arange(lines.size) / PADDED
    far = PADDED * LEAST_PLATEAUS
    coarser = np.where(cycles * PLATEAUS_APART * step <= span, lines, 0.0)[far:]
    strong = np.flatnonzero(coarser > ON_PLATEAUS)
    if not strong.size:
        return 0.0, 0.0
    # the best of the coarsest, none of them of half another's spacing: what rests on a few clean
    # levels is strong at many of the finer ones, too
    first = far + int(strong[0])
    best = first + int(np.argmax(lines[first : 2 * first - PADDED // 2]))
    # a channel that mostly rests is strong everywhere
    if lines[PADDED:best].min() > ON_PLATEAUS:
        return 0.0, 0.0
    # near the line of the histogram, the spacing at which the line of the samples is strongest
    near = (cycles[best] + np.linspace(-1.0, 1.0, 41) / PADDED) / span
    strength = [abs(np.exp(2j * np.pi * f * values).mean()) for f in near]
    spacing = float(1.0 / near[np.argmax(strength)])
    # from the middle: what the spacing is off by adds up over the levels to a far zero
    middle = float(np.median(values))
    off = (values - middle) / spacing
    phase = float(np.angle(np.mean(np.exp(2j * np.pi * off)))) / (2.0 * np.pi)
    off -= phase
    width = float(np.median(np.abs(off - np.round(off)))) / MEDIAN
    if PLATEAUS_APART * width >= 1.0:
        return 0.0, 0.0
    return spacing, middle + phase * spacing


def noise_level(y: Array) -> Array:
    """Noise of every channel of y (samples x channels): its white noise, at least that of its step,
    at least 1e-6 of the spread."""
    return _noise_and_steps(y)[0]


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of the channels of recordings made with the same sensors, in the channels' unit.

    used    standard deviation that fits and floors use
    white   standard deviation of white noise and steps
    lag     error of readings that stand still and leap while the machine moves (`hold_error`)
    stated  standard deviation from the rig, 0 where it states none
    """

    used: Array
    white: Array
    lag: Array
    stated: Array

    @property
    def contradicts(self) -> NDArray[np.bool_]:
        """Where the noise used is far from the stated noise, because the samples show another."""
        ratio = self.used / np.where(self.stated > 0.0, self.stated, self.used)
        return np.asarray((ratio > OTHER_NOISE) | (ratio < 1.0 / OTHER_NOISE))


def sensor_noise(
    parts: Sequence[Array], stated: Array, inputs: Sequence[Array] | None = None
) -> SensorNoise:
    """Noise per channel of recordings made with the same sensors.

    White noise or steps that the samples show replace the data sheet's figure, even a larger
    figure: a sensor may be better than that. Where neither shows, or where readings repeat,
    differences from sample to sample do not measure the error of a reading. Then the stated figure
    is the least. Without a stated figure, the lag of readings that cling counts as noise.

    parts: each samples x channels. stated: standard deviation per channel from the rig, 0 where it
    states none. inputs: the inputs of each part, samples x inputs. While all inputs rest, the
    machine may rest, too, and a channel that stands still does not cling.
    """
    y = np.concatenate(parts)
    noise, steps = _noise_and_steps(y)
    if len(parts) > 1:  # each may have different steps
        squares = [[quantisation_step(c) ** 2 for c in part.T] for part in parts]
        steps = np.sqrt(np.mean(squares, axis=0))
        noise = np.maximum(noise, UNIFORM * steps)
    given = [None] * len(parts) if inputs is None else inputs
    excess = np.flatnonzero((stated > 0.0) & (steps == 0.0) & (noise > stated))
    if inputs is not None and excess.size:
        still = [_without_inputs(part[:, excess], u) for part, u in zip(parts, inputs, strict=True)]
        without = np.maximum(_noise_and_steps(np.concatenate(still))[0], stated[excess])
        noise[excess] = np.minimum(noise[excess], without)
    holds = [[hold_error(c, u) for c in part.T] for part, u in zip(parts, given, strict=True)]
    # a converter's steps explain repeats by themselves
    lag = np.where(steps > 0.0, 0.0, np.sqrt(np.mean(np.square(holds), axis=0)))
    least = MAY_BE_NOISE * y.std(axis=0)
    white = [n > shown and is_white(c) for c, n, shown in zip(y.T, noise, least, strict=True)]
    # share of the readings that repeat
    repeating = np.array([np.mean(_readings(c)[1] > 1) for c in y.T])
    repeats = (steps == 0.0) & (repeating > REPEATING)
    shows = ((UNIFORM * steps > least) | white) & ~repeats
    # whoever states a noise knows the sensor; what a reading clings by is an estimate
    used = np.where(stated > 0.0, np.maximum(noise, stated), np.hypot(noise, lag))
    return SensorNoise(np.where(shows, noise, used), noise, lag, stated)


def _without_inputs(y: Array, inputs: Array) -> Array:
    """Channels (samples x channels) less what is linear in the latest inputs (samples x inputs),
    by least squares on the differences of both."""
    rows = np.maximum(np.arange(len(y))[:, None] - np.arange(INPUT_LAGS), 0)
    latest = inputs[rows].reshape(len(y), -1)
    changes = np.diff(latest, n=INPUT_ORDER, axis=0)
    if len(changes) <= FEW_MOVING + changes.shape[1] or not changes.any():
        return y
    response = np.linalg.lstsq(changes, np.diff(y, n=INPUT_ORDER, axis=0), rcond=None)[0]
    return np.asarray(y - latest @ response)


def hold_error(values: Array, inputs: Array | None = None) -> float:
    """Root mean square error of the readings of a channel, shape (n,), that clings: stands still
    while the machine moves, and leaps on; 0 where it does not.

    inputs: samples x inputs; a hold counts while any of them moves, each hold if none ever does.
    """
    start, length = _readings(values)
    held = length > 1
    if held.sum() <= FEW_LEAPS:
        return 0.0
    start, length = start[held], length[held]
    leap, way = np.abs(np.diff(values[start])), np.diff(start)
    # a leap takes less time than the hold before it; otherwise the channel moved on
    counts = way < 2 * length[:-1]
    if inputs is not None and inputs.size and np.ptp(inputs, axis=0).any():
        moves = np.concatenate([[0], np.cumsum((np.diff(inputs, axis=0) != 0.0).any(axis=1))])
        during = moves[start + length - 1] - moves[start]
        counts &= (during >= DRIVEN_HOLD * (length - 1))[:-1]
    if counts.sum() < FEW_LEAPS or way[counts].sum() < LAGGING * values.size:
        return 0.0
    return float(LAG * np.sqrt(way[counts] @ leap[counts] ** 2 / way[counts].sum()))


def _readings(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First sample and number of samples of every reading; repeats are a single reading."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
    return edges[:-1], np.diff(edges)


def is_white(values: Array) -> bool:
    """Do differences of some order look like white noise throughout (and not like curvature that
    comes and goes)?"""
    for order in ORDERS:
        d = np.diff(values, n=order)
        if d.size < FEW_MOVING:
            continue
        # median of each of 40 parts as of np.array_split, which have two lengths at most
        length, longer = divmod(d.size, 40)
        long, short = np.split(np.abs(d), [longer * (length + 1)])
        tables = long.reshape(longer, length + 1), short.reshape(-1, length)
        sizes = np.concatenate([np.median(table, axis=1) for table in tables])
        usual = float(np.median(sizes))
        if 0.0 < 0.3 * usual < float(np.quantile(sizes, 0.25)):
            # a spike has no information on the colour
            bounded = np.clip(d, -6.0 * usual, 6.0 * usual)
            # the autocorrelation of differences of white noise at lag 1: -0.8 of fourth ones
            alone = -order / (order + 1.0)
            if float(bounded[1:] @ bounded[:-1]) < 0.75 * alone * float(bounded @ bounded):
                return True
    return False


def _noise_and_steps(y: Array) -> tuple[Array, Array]:
    # in units of the white noise that would show such differences
    every = [np.abs(np.diff(y, n=k, axis=0)) / gain for k, gain in ORDERS.items()]
    sigma = np.min([np.median(d, axis=0) for d in every], axis=0) / MEDIAN
    # where more than half of the samples rest the median is zero: the mean square then, of all but
    # the largest tenth, which are the motion
    pooled = np.min(
        [np.mean(np.minimum(d, np.quantile(d, 0.9, axis=0)) ** 2, axis=0) for d in every], axis=0
    )
    noise = np.where(sigma > 0.0, sigma, np.sqrt(pooled))
    steps = np.array([quantisation_step(c) for c in y.T])
    for c in np.flatnonzero(sigma < steps):
        # of squares of differences: their median takes few values below a step; the median over
        # blocks passes over jumps
        blocks = (np.array_split(d[:, c], max(1, len(d) // BLOCK)) for d in every)
        squares = [np.median([np.mean(part**2) for part in parts]) for parts in blocks]
        noise[c] = max(float(np.sqrt(min(squares))), UNIFORM * steps[c])
    for c in np.flatnonzero(steps == 0.0):
        # A sensor that is off or at its limit repeats its value, and so do filled gaps. Differences
        # over exact repeats would bring the median next to zero, and every error of a model would
        # be large against such noise.
        moved = y[1:, c] != y[:-1, c]
        if moved.all():
            continue
        sums, levels = np.concatenate([[0], np.cumsum(moved)]), []
        for order, gain in ORDERS.items():
            d = np.abs(np.diff(y[:, c], n=order)[sums[order:] - sums[:-order] == order])
            if d.size >= FEW_MOVING:
                levels.append(float(np.median(d)) / (gain * MEDIAN))
        noise[c] = min(levels, default=noise[c])
    return np.maximum(noise, LEAST_BELIEVED * y.std(axis=0) + 1e-300), steps
