"""Time stepping of the trial's arm: two links, four muscles, semi-implicit Euler at a tenth of a
millisecond, compiled.

The links are described by their angles against the vertical, u_1 and u_2 their speeds, from
Newton's equations of the two bodies: with the pull of link 2 on the elbow eliminated they are

    a u_1' + b cos(p_2 - p_1) u_2' = b sin(p_2 - p_1) u_2^2 - w_1 sin p_1 + (what acts on link 1)
    b cos(p_2 - p_1) u_1' + c u_2' = -b sin(p_2 - p_1) u_1^2 - w_2 sin p_2 + (what acts on link 2)

A torque of joint 2 acts on link 2 and, the other way round, on link 1; with a flexible joint it
acts on the wheel, and what spring or play pass on acts on the link. `a` is the arm's record (fields
of `arm.ArmBody`), `m[j]` the machine of joint j, `f[i]` what is planted in muscle i (0 to 3), f[4 +
j] in joint j, f[6] in what all share.

Compiled once per process (seconds), not cached: the compiler's cache would not see a change in
`kernel`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.kernel import (
    ANGLE,
    ATMOSPHERE,
    HANGING,
    HYSTERESIS_ELEMENTS,
    JOINT_STATES,
    LOAD_ANGLE,
    LOAD_SPEED,
    MUSCLE_STATES,
    PRESSURE,
    PULL,
    SPEED,
    SUPPLY,
    at_rest,
    bristles,
    command_of,
    driven,
    link_torque,
    moved_zero,
    pair_air,
    pair_torque,
    place_torque,
    smoothed,
    sticking,
    supply_after,
    winding,
)

JOINT, SHARED = 4, 6  # in f
READINGS = 14  # two angles; contractions, gauge pressures and forces of four muscles


@njit
def wheel_inertia(j: int, a: Any, f: Any) -> float:
    """Inertia (kg m2) before a flexible joint's spring: a share, with the arm stretched."""
    felt = (
        a.inertia_1 - a.coupling**2 / a.inertia_2
        if j == 0
        else a.inertia_2
        - ((a.inertia_2 + a.coupling) ** 2 / (a.inertia_1 + a.inertia_2 + 2.0 * a.coupling))
    )
    return (1.0 - f.outboard) * felt


@njit
def advance_arm(x: Array, a: Any, f: Any, torque: Array, h: float) -> None:
    """Angles and speeds of both joints a step later, in place; torque: N m at each joint, by
    muscles and places.

    Of joint j `x[j]` holds angle and speed of its wheel against the link before it, and those of
    link j against the vertical as load.
    """
    bend = x[1, LOAD_ANGLE] - x[0, LOAD_ANGLE]
    m_11, m_12, m_22 = a.inertia_1, a.coupling * np.cos(bend), a.inertia_2
    spin = a.coupling * np.sin(bend)
    on = np.array(
        [
            spin * x[1, LOAD_SPEED] ** 2 - a.weight_1 * np.sin(x[0, LOAD_ANGLE]),
            -spin * x[0, LOAD_SPEED] ** 2 - a.weight_2 * np.sin(x[1, LOAD_ANGLE]),
        ]
    )
    along = np.zeros((2, 2))  # shares of a torque of joint j that act on the links
    along[1, 0] = -1.0
    wheel, turning = np.zeros(2), np.zeros(2)  # inertia and speed of the wheels of flexible joints
    for j in range(2):
        planted = f[JOINT + j]
        push = (
            torque[j]
            - bristles(x[j], planted, h)
            - (a.viscous_1 if j == 0 else a.viscous_2) * x[j, SPEED]
        )
        if planted.outboard > 0.0:
            wheel[j] = wheel_inertia(j, a, planted)
            turning[j] = x[j, SPEED] + (x[0, LOAD_SPEED] if j == 1 else 0.0)
            twist = x[j, ANGLE] + (x[0, LOAD_ANGLE] if j == 1 else 0.0) - x[j, LOAD_ANGLE]
            load = planted.outboard / (1.0 - planted.outboard) * wheel[j]
            link = link_torque(twist, turning[j] - x[j, LOAD_SPEED], load, planted)
            on[j] += link
            turning[j] += h * (push - link) / wheel[j]
        else:
            along[j, j] = 1.0
        on += push * along[j]
    m_11 -= wheel[0]
    m_22 -= wheel[1]
    det = m_11 * m_22 - m_12 * m_12
    ease = np.array([[m_22, -m_12], [-m_12, m_11]]) / det
    speed = np.array([x[0, LOAD_SPEED], x[1, LOAD_SPEED]])
    speed += h * np.array(
        [ease[0, 0] * on[0] + ease[0, 1] * on[1], ease[1, 0] * on[0] + ease[1, 1] * on[1]]
    )
    for j in range(2):
        # an impulse that stops the joint or slows it, never turns it round
        if f[JOINT + j].stick_nm > 0.0:
            gives = np.array(
                [
                    ease[0, 0] * along[j, 0] + ease[0, 1] * along[j, 1],
                    ease[1, 0] * along[j, 0] + ease[1, 1] * along[j, 1],
                ]
            )
            slip = along[j, 0] * speed[0] + along[j, 1] * speed[1]
            mobility = along[j, 0] * gives[0] + along[j, 1] * gives[1]
            if wheel[j] > 0.0:
                slip += turning[j]
                mobility += 1.0 / wheel[j]
            most = h * sticking(x[j, SPEED], f[JOINT + j])
            impulse = min(max(-slip / mobility, -most), most)
            speed += impulse * gives
            if wheel[j] > 0.0:
                turning[j] += impulse / wheel[j]
    for j in range(2):
        x[j, LOAD_SPEED] = speed[j]
        x[j, LOAD_ANGLE] += h * speed[j]
        rate = turning[j] if wheel[j] > 0.0 else speed[j]
        x[j, SPEED] = rate - (speed[0] if j == 1 else 0.0)
        x[j, ANGLE] += h * x[j, SPEED]


@njit
def read(y: Array, x: Array, s: Array, m: Any, f: Any, h: float) -> None:
    """Filters of all readings, in their order, a step later. Contractions are read where the chains
    leave the wheel."""
    for j in range(2):
        wound = winding(x[j], m[j], f[JOINT + j])[0]
        smoothed(y[j], x[j, ANGLE], m[j].filter_lag + f[JOINT + j].angle_lag_s, h)
        for i in range(2):
            k = 2 * j + i
            smoothed(y[2 + k], m[j].contraction_0 + (1 - 2 * i) * wound, m[j].filter_lag, h)
            smoothed(
                y[6 + k], s[j, i, PRESSURE] - ATMOSPHERE, m[j].filter_lag + f[k].pressure_lag_s, h
            )
            smoothed(y[10 + k], s[j, i, PULL], m[j].filter_lag, h)


@njit
def run(
    a: Any, m: Any, f: Any, waves: Array, control: Any, clock: Any, logged: tuple[Array, Array]
) -> None:
    """Fill `logged`: readings (samples x 14, SI, before noise) and commands (2 x samples).

    control: references in deg or the commands themselves (2 x samples), whether the loop is closed,
    the controller, noise of the angles in deg; clock: sampling period and steps in it; waves:
    (joint, muscle, wave, 3).
    """
    (reference, closed, controller, noise_deg), (readings, commands) = control, logged
    period, steps = clock
    h, n = period / steps, reference.shape[1]
    x, s, z = (
        np.zeros((2, JOINT_STATES)),
        np.zeros((2, 2, MUSCLE_STATES)),
        np.zeros((2, 2, 2, HYSTERESIS_ELEMENTS)),
    )
    y, memory, torque, drive = np.zeros((READINGS, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    for j in range(2):
        x[j, SUPPLY] = m[j].supply_pressure
        at_rest(s[j], m[j])
    for k in range(-HANGING, n):
        if k >= 0:
            readings[k] = y[:, 0]
            for j in range(2):
                readings[k, j] = moved_zero(y[j, 0], f[JOINT + j])
                commands[j, k] = reference[j, k]
                if closed:
                    angle_deg = np.degrees(readings[k, j]) + noise_deg[j, k]
                    commands[j, k] = command_of(
                        memory[j], k, reference[j, k], angle_deg, m[j], controller, period
                    )
        for step in range(steps):
            at = k * steps + step
            drawn = 0.0
            for j in range(2):
                if k >= 0:
                    drive[j] = driven(x[j], m[j], f[JOINT + j], commands[j], at, steps, period)
                    drawn += pair_air(x[j], s[j], m[j], f[2 * j], f[2 * j + 1], drive[j], h)
            x[:, SUPPLY] = supply_after(x[0, SUPPLY], drawn, m[0], f[SHARED], h)
            for j in range(2):
                faults = f[JOINT + j], f[2 * j], f[2 * j + 1]
                force_map = waves[j], max(k, 0) / n
                torque[j] = place_torque(x[j], f[JOINT + j], at * h)
                torque[j] += pair_torque(x[j], (s[j], z[j]), m[j], faults, force_map, h)
            advance_arm(x, a, f, torque, h)
            read(y, x, s, m, f, h)
