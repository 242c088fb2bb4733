"""Compiled parts of the machines behind the starter rigs: changes of a signal on its path, and
forces against a motion.

`f` is what is planted at a port, a record with the fields of `starter_faults`; `z` the memory of
such a port. The forms are other than those of the catalogue: bundles of many stops, bristles,
soft knees, filters of second order. All functions live in this file: the compiler's cache looks
no further than the file it compiles.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit

BUNDLE = 16  # elements of a bundle
OUTBOARD_RATIO = 0.03  # damping ratio of what hangs behind a spring
BRISTLE, LOOP, PLASTIC, ROUND = range(4)
SPREAD = ROUND + BUNDLE
FORCE_MEMORY = SPREAD + BUNDLE  # of the forces at a port


@njit(cache=True)
def bundle(z: Array, step: float, reach: float, decades: float) -> float:
    """Share (-1 to 1) of the force limit of a bundle of elastic stops after a step; their widths
    cover many decades about `reach`, and wide ones are weaker."""
    total = weights = 0.0
    for j in range(BUNDLE):
        width = reach * 10.0 ** (decades * (j / (BUNDLE - 1) - 0.7))
        weight = np.exp(-width / reach)
        z[j] = min(max(z[j] + step, -width), width)
        total += weight * z[j] / width
        weights += weight
    return total / weights


@njit(cache=True)
def swallowed(z: Array, step: float, reach: float) -> float:
    """Part of a signal that plays of even widths absorb in a step; wide plays weigh less."""
    total = weights = 0.0
    for j in range(BUNDLE):
        width = 3.0 * reach * (j + 0.5) / BUNDLE
        weight = np.exp(-width / reach)
        z[j] = min(max(z[j] + step, -width), width)
        total += weight * z[j]
        weights += weight
    return total / weights


@njit(cache=True)
def soft_limit(value: float, most: float) -> float:
    """A limit with a round shoulder; most: 1/limit, 0 for none."""
    if most <= 0.0:
        return value
    return value / (1.0 + (most * abs(value)) ** 6) ** (1.0 / 6.0)


@njit(cache=True)
def worn_band(value: float, half: float) -> float:
    """A band about zero whose edges are worn: the slope rises from 0 to 1."""
    return value - half * np.tanh(value / half) if half > 0.0 else value


@njit(cache=True)
def passed_on(signal: Array, f: Any, h: float) -> Array:
    """A signal, a value per h seconds, after the effects planted in its path."""
    out = np.empty_like(signal)
    stops = np.zeros(BUNDLE)
    before, follower, smooth, slope = signal[0], signal[0], signal[0], 0.0
    pulse, share = -1.0, 0.0
    late = int(round(f.delay_s / h))
    for k in range(len(signal)):
        v = signal[max(k - late, 0)]
        if f.half_gap > 0.0:  # a follower dragged through grease, once the gap is closed
            beyond = v - follower
            beyond -= min(max(beyond, -f.half_gap), f.half_gap)
            follower += beyond * (1.0 - np.exp(-h / f.gap_s))
            v = follower
        if f.swallowed > 0.0:
            step, before = v - before, v
            v -= f.swallowed * swallowed(stops, step, f.swallowed_reach)
        v = worn_band(v, f.band_up if v > 0.0 else f.band_down)
        v = soft_limit(v, f.cap_up if v > 0.0 else f.cap_down)
        if f.blocked > 0.0:  # negative values pass only in part
            v += f.blocked * 0.5 * (np.sqrt(v * v + f.knee * f.knee) - v)
        if f.unsigned > 0.0:
            v += f.unsigned * (np.sqrt(v * v + f.knee * f.knee) - f.knee - v)
        if f.coarse > 0.0:  # steps that are not quite even
            level = np.floor(v / f.coarse + 0.5)
            v = f.coarse * (level + 0.1 * np.sin(2.4 * level))
        if f.pulse_s > 0.0:  # the share of a pulse is settled as it begins
            turn = k * h / f.pulse_s
            if np.floor(turn) != pulse:
                pulse = np.floor(turn)
                share = np.floor(abs(v) / f.full * f.ticks + 0.5) / f.ticks
            v = np.sign(v) * f.full if turn - pulse < share else 0.0
        if f.lag_s > 0.0:
            corner = 1.4 / f.lag_s
            slope += h * corner * (corner * (v - smooth) - 1.4 * slope)
            smooth += h * slope
            v = smooth
        t = k * h
        warm = 1.0 - 0.6 * np.exp(-t / f.warm_s) - 0.4 * np.exp(-4.0 * t / f.warm_s)
        v *= 1.0 + f.warming * warm
        v *= 1.0 + f.gain * (1.0 - 0.15 * min(abs(v) / f.full, 1.0))
        out[k] = v + f.zero * (1.0 + 0.1 * warm)
    return out


@njit(cache=True)
def bristles(v: float, load: float, level: float, z: Array, f: Any, h: float) -> float:
    """Dry friction of contacts that bend before they slide, at velocity v; load, level: normal load
    of the surfaces, in the unit of the sizes."""
    force = 0.0
    friction = (
        f.dahl + f.load_share * abs(load) + f.level_share * level * level / (level + f.level_knee)
    )
    friction += f.forward if z[BRISTLE] > 0.0 else f.backward  # at rest, too, as it was left
    if friction > 0.0:
        y = z[BRISTLE]
        yielding = 1.0 - y * np.sign(v)
        y += h * v / f.dahl_reach * abs(yielding) ** 1.5 * np.sign(yielding)
        z[BRISTLE] = min(max(y, -1.0), 1.0)
        force += friction * z[BRISTLE]
    if f.spread > 0.0:
        force += f.spread * bundle(z[SPREAD:], h * v, f.spread_reach, 2.0)
    if f.rounded > 0.0:
        force += f.rounded * bundle(z[ROUND:SPREAD], h * v, f.rounded_reach, 1.0)
    if f.loop > 0.0:
        old = z[LOOP]
        bend = f.loop_shape * abs(v) * abs(old) * old + (1.0 - f.loop_shape) * v * old * old
        z[LOOP] = min(max(old + h * (v - bend) / f.loop_reach, -1.0), 1.0)
        force += f.loop * z[LOOP]
    if f.plastic > 0.0:
        top = f.plastic * (1.0 + f.plastic_peak / (1.0 + (v / f.plastic_speed) ** 2))
        stiffness = f.plastic / f.plastic_reach
        y, most = z[PLASTIC], top / stiffness
        slip = 0.0
        if y * v > 0.0 and abs(y) > 0.7 * most:  # purely elastic below: it does not creep
            slip = 0.5 + 0.5 * np.sin(np.pi * (min(abs(y) / most, 1.0) - 0.85) / 0.3)
        z[PLASTIC] = min(max(y + h * v * (1.0 - slip * abs(y) / most), -most), most)
        force += stiffness * z[PLASTIC]
    return force


@njit(cache=True)
def resisted(
    q: float, v: float, pressed: tuple[float, float], z: Array, f: Any, clock: float, h: float
) -> float:
    """All forces that are planted against a motion, but for the true stick; q: position; pressed:
    normal load, and the level of a current or pressure."""
    force = bristles(v, pressed[0], pressed[1], z, f, h)
    force += f.grease * v / (1.0 + 0.2 * abs(v) / f.speed)
    force += f.damping_forward * max(v, 0.0)
    force += f.square_drag * np.sign(v) * (abs(v) / f.speed) ** 1.9
    bent = 2.0 * v / f.speed
    force += f.steep_drag * (np.sinh(min(max(bent, -8.0), 8.0)) - bent)
    away = 2.0 * q / f.travel
    force += f.harden * away**3 / (1.0 + 0.5 * away * away)
    force += f.tether * np.tanh(away)
    deep = abs(q) - f.stop_at
    if f.stop_stiffness > 0.0 and deep > 0.0:  # a buffer that pushes and never pulls
        push = f.stop_stiffness * deep * (1.0 + 0.3 * np.sign(q) * v / f.speed)
        force += np.sign(q) * max(0.0, push)
    force += f.weight * np.sin(q + f.weight_at) + f.pull * (1.0 + 0.1 * np.cos(away))
    turn = 2.0 * np.pi * q / f.pitch
    force += f.detent * (
        np.sin(turn + f.detent_at) + 0.3 * np.sin(2.0 * turn) + 0.1 * np.cos(3.0 * turn)
    )
    beat = 2.0 * np.pi * f.shake_hz * clock + f.shake_at
    return force + f.shake * (np.sin(beat) + 0.25 * np.sin(2.0 * beat + 1.0))


@njit(cache=True)
def stick(v: float, f: Any) -> float:
    """Level of the dry friction that stops a mass, with an exponential fall."""
    return f.stick * (1.0 + f.stick_peak * np.exp(-abs(v) / f.stick_speed))


@njit(cache=True)
def arrested(free: float, v: float, f: Any, h: float, mass: float) -> float:
    """The speed `free` that a mass would have after a step, with the stick as an impulse: it stops
    the mass or slows it, never turns it round."""
    if f.stick <= 0.0:
        return free
    return np.sign(free) * max(0.0, abs(free) - h * stick(v, f) / mass)


@njit(cache=True)
def turned(
    x: Array, push: float, damped: float, inertia: float, f: Any, link: Any, h: float
) -> None:
    """A step of a shaft, in place: angle, speed, and those of a share of the inertia behind a
    spring with play. Damping by the trapezoidal rule, so that the error of a step is of second
    order; f: forces on the shaft, link: sizes of the spring."""
    angle, speed = x[0], x[1]
    if link.outboard > 0.0:
        load = inertia * link.outboard
        swing = 2.0 * np.pi * link.outboard_hz
        twist = angle - x[2]
        beyond = twist - min(max(twist, -link.play), link.play)
        pull = load * swing * swing * beyond * (1.0 + (beyond / 0.3) ** 2)
        if beyond != 0.0:
            pull += 2.0 * OUTBOARD_RATIO * load * swing * (speed - x[3])
        push -= pull
        x[3] += h * pull / load
        x[2] += h * x[3]
    inertia *= 1.0 - link.outboard
    c = 0.5 * h * damped / inertia
    free = (speed * (1.0 - c) + h * push / inertia) / (1.0 + c)
    x[1] = arrested(free, speed, f, h, inertia)
    x[0] += 0.5 * h * (speed + x[1])


@njit(cache=True)
def sliding(v: float, f: Any) -> float:
    """The same dry friction where the motion is imposed, and nothing can be stopped."""
    return stick(v, f) * np.tanh(20.0 * v / f.stick_speed)


@njit(cache=True)
def rough(waves: Array, s: float) -> float:
    """Relative error of a map at s; waves: (amplitude, angular wave number, phase)."""
    error = 0.0
    for k in range(waves.shape[0]):
        error += waves[k, 0] * np.cos(waves[k, 1] * s + waves[k, 2])
    return error
