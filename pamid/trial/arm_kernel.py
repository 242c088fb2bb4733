"""Time stepping of the trial's joint and arm: one or two joints of two muscles each, semi-implicit
Euler at a tenth of a millisecond, compiled.

Order within a step: valves, air, pulls, motion, sensor filters; each part uses what the parts
before it have just set. `a` is the record of the moving parts (of the joint `inertia` and
`viscous`, of the arm that of `two_link.ArmSpecimen.body`), `m[j]` the machine of joint j, `f` what
is planted: of n joints f[0] to f[2 n - 1] in their muscles, f[2 n] to f[3 n - 1] in the joints,
f[3 n] in what all share.

The links of the arm are described by their angles against the vertical, u_1 and u_2 their speeds,
from Newton's equations of the two bodies: with the pull of link 2 on the elbow eliminated they are

    a u_1' + b cos(p_2 - p_1) u_2' = b sin(p_2 - p_1) u_2^2 - w_1 sin p_1 + (what acts on link 1)
    b cos(p_2 - p_1) u_1' + c u_2' = -b sin(p_2 - p_1) u_1^2 - w_2 sin p_2 + (what acts on link 2)

A torque of joint 2 acts on link 2 and, the other way round, on link 1; with a flexible joint it
acts on the wheel, and what spring or play pass on acts on the link.

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

READINGS = 7  # per joint: an angle; contractions, gauge pressures and forces of two muscles


@njit
def advance_joint(x: Array, a: Any, f: Any, torque: Array, h: float) -> None:
    """Speed, then angle, of a single joint under `torque`, in place; a part attached behind the
    joint reacts."""
    inertial, push, state, planted = a.inertia, torque[0], x[0], f[2]
    push -= bristles(state, planted, h)
    if planted.outboard > 0.0:
        load = planted.outboard * a.inertia
        inertial -= load
        twist, turning = state[ANGLE] - state[LOAD_ANGLE], state[SPEED] - state[LOAD_SPEED]
        link = link_torque(twist, turning, load, planted)
        push -= link
        state[LOAD_SPEED] += h * link / load
        state[LOAD_ANGLE] += h * state[LOAD_SPEED]
    free = (state[SPEED] + h * push / inertial) / (1.0 + h * a.viscous / inertial)
    # dry friction as an impulse: it stops the arm or slows it, never turns it round
    if planted.stick_nm > 0.0:
        slowed = abs(free) - h * sticking(state[SPEED], planted) / inertial
        free = np.sign(free) * max(0.0, slowed)
    state[SPEED] = free
    state[ANGLE] += h * free


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
        planted = f[4 + j]
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
        if f[4 + j].stick_nm > 0.0:
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
            most = h * sticking(x[j, SPEED], f[4 + j])
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
    n = len(x)
    for j in range(n):
        wound = winding(x[j], m[j], f[2 * n + j])[0]
        smoothed(y[j], x[j, ANGLE], m[j].filter_lag + f[2 * n + j].angle_lag_s, h)
        for i in range(2):
            k = 2 * j + i
            gauge, lag = s[j, i, PRESSURE] - ATMOSPHERE, m[j].filter_lag + f[k].pressure_lag_s
            smoothed(y[n + k], m[j].contraction_0 + (1 - 2 * i) * wound, m[j].filter_lag, h)
            smoothed(y[3 * n + k], gauge, lag, h)
            smoothed(y[5 * n + k], s[j, i, PULL], m[j].filter_lag, h)


@njit
def run(advance: Any, machine: Any, waves: Array, control: Any, clock: Any, logged: Any) -> None:
    """Fill `logged`: readings (samples x 7 n, SI, before noise) and commands (n x samples).

    advance: `advance_joint` or `advance_arm`; machine: a, m and f; waves: (joint, muscle, wave, 3);
    control: references in deg or the commands themselves (n x samples), whether the loop is closed,
    the controller, noise of the angles in deg; clock: sampling period and steps in it.
    """
    (a, m, f), (readings, commands), (period, steps) = machine, logged, clock
    reference, closed, controller, noise_deg = control
    h, (n, samples) = period / steps, reference.shape
    x, s, z = (
        np.zeros((n, JOINT_STATES)),
        np.zeros((n, 2, MUSCLE_STATES)),
        np.zeros((n, 2, 2, HYSTERESIS_ELEMENTS)),
    )
    y, memory, torque = np.zeros((READINGS * n, 2)), np.zeros((n, 2)), np.zeros(n)
    for j in range(n):
        x[j, SUPPLY] = m[j].supply_pressure
        at_rest(s[j], m[j])
    for k in range(-HANGING, samples):
        if k >= 0:
            readings[k] = y[:, 0]
            for j in range(n):
                readings[k, j] = moved_zero(y[j, 0], f[2 * n + j])
                commands[j, k] = reference[j, k]
                if closed:
                    angle_deg = np.degrees(readings[k, j]) + noise_deg[j, k]
                    commands[j, k] = command_of(
                        memory[j], k, reference[j, k], angle_deg, m[j], controller, period
                    )
        for step in range(steps):
            at = k * steps + step
            if k >= 0:  # before a recording begins, pressures are kept where they are
                drawn = 0.0
                for j in range(n):
                    drive = driven(x[j], m[j], f[2 * n + j], commands[j], at, steps, period)
                    drawn += pair_air(x[j], s[j], m[j], f[2 * j], f[2 * j + 1], drive, h)
                x[:, SUPPLY] = supply_after(x[0, SUPPLY], drawn, m[0], f[3 * n], h)
            for j in range(n):
                faults = f[2 * n + j], f[2 * j], f[2 * j + 1]
                force_map = waves[j], max(k, 0) / samples
                torque[j] = place_torque(x[j], f[2 * n + j], at * h)
                torque[j] += pair_torque(x[j], (s[j], z[j]), m[j], faults, force_map, h)
            advance(x, a, f, torque, h)
            read(y, x, s, m, f, h)
