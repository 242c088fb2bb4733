"""Time stepping of the one-dof joint: semi-implicit Euler at a tenth of a millisecond, compiled.

Order within a step: valves, air, pulls, joint, sensor filters; each part uses what the parts before
it have just set. Compiled once per process (seconds), not cached: the compiler's cache would not
see a change in `kernel`.
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
)


@njit
def advance_joint(x: Array, m: Any, f: Any, torque: float, h: float) -> None:
    """Speed, then angle, under `torque`; a part attached behind the joint reacts."""
    inertial = m.inertia
    torque -= bristles(x, f, h)
    if f.outboard > 0.0:
        load = f.outboard * m.inertia
        inertial -= load
        link = link_torque(x[ANGLE] - x[LOAD_ANGLE], x[SPEED] - x[LOAD_SPEED], load, f)
        torque -= link
        x[LOAD_SPEED] += h * link / load
        x[LOAD_ANGLE] += h * x[LOAD_SPEED]
    free = (x[SPEED] + h * torque / inertial) / (1.0 + h * m.viscous / inertial)
    # dry friction as an impulse: it stops the arm or slows it, never turns it round
    if f.stick_nm > 0.0:
        free = np.sign(free) * max(0.0, abs(free) - h * sticking(x[SPEED], f) / inertial)
    x[SPEED] = free
    x[ANGLE] += h * free


@njit
def run(
    m: Any, f: Any, waves: Array, control: Any, clock: Any, logged: tuple[Array, Array]
) -> None:
    """Fill `logged`: readings (samples x 5, SI, before noise: angle, gauge pressures, forces) and
    commands. control: reference in deg or the command itself, whether the loop is closed, the
    controller, noise of the angle in deg; clock: sampling period and steps in it."""
    (reference, closed, controller, noise_deg), (readings, commands) = control, logged
    period, steps = clock
    h, n = period / steps, reference.shape[0]
    x, s, z, y = (
        np.zeros(JOINT_STATES),
        np.zeros((2, MUSCLE_STATES)),
        np.zeros((2, 2, HYSTERESIS_ELEMENTS)),
        np.zeros((5, 2)),
    )
    x[SUPPLY] = m.supply_pressure
    at_rest(s, m)
    memory = np.zeros(2)
    for k in range(-HANGING, n):
        if k >= 0:
            readings[k] = y[:, 0]
            readings[k, 0] = moved_zero(y[0, 0], f)
            commands[k] = reference[k]
            if closed:
                angle_deg = np.degrees(readings[k, 0]) + noise_deg[k]
                commands[k] = command_of(memory, k, reference[k], angle_deg, m, controller, period)
        for j in range(steps):
            at = k * steps + j
            if k >= 0:  # before a recording begins, pressures are kept where they are
                drive = driven(x, m, f, commands, at, steps, period)
                x[SUPPLY] = supply_after(x[SUPPLY], pair_air(x, s, m, f, f, drive, h), m, f, h)
            torque = pair_torque(x, (s, z), m, (f, f, f), (waves, max(k, 0) / n), h)
            advance_joint(x, m, f, torque + place_torque(x, f, at * h), h)
            smoothed(y[0], x[ANGLE], m.filter_lag + f.angle_lag_s, h)
            for i in range(2):
                smoothed(y[1 + i], s[i, PRESSURE] - ATMOSPHERE, m.filter_lag + f.pressure_lag_s, h)
                smoothed(y[3 + i], s[i, PULL], m.filter_lag, h)
