"""Dampers, suspensions, pendulums and links: their true equations and recordings."""

from __future__ import annotations

import math

import numpy as np
from virtual import Columns, clock, free_run, levels, multisine, quantised, read, rough, swept

# ---- a damper with a magnetised fluid on a test bench --------------------------------------------


def fluid_damper(lacking: float) -> list[Columns]:
    """A sine of varying amplitude; the fluid's yield force follows the coil's voltage."""
    out = []
    for seed in (111, 112):
        random = np.random.default_rng(seed)
        samples, period = 3500, 0.005
        time = clock(samples, period)
        swell = np.interp(time, np.arange(0.0, 20.0, 1.5), random.uniform(2.0, 14.0, 14))
        hertz = 1.5 if seed == 111 else 2.1
        moved = swell * np.sin(2.0 * np.pi * hertz * time)
        speed = np.gradient(moved, period)
        volts = np.round(levels(random, samples, (160, 520), 0.0, 2.5), 1)

        def rates(x: list[float], u: list[float], t: float) -> list[float]:
            z, field = x
            v = u[0]
            return [24.0 * v - 22.0 * abs(v) * z - 2.0 * v * abs(z), (u[1] - field) / 0.025]

        states = free_run(rates, [0.0, 0.0], np.column_stack([speed, volts]), period, 20, False)
        z, field = states.T
        level = 62.0 + 205.0 * field - 16.0 * field**2
        force = (1.25 + 0.12 * lacking * field) * speed + 1.9 * moved + lacking * level * z + 14.0
        # the cell's amplifier lags by 2 ms
        shown = np.interp(time - 0.002 * lacking, time, force)
        out.append(
            {
                "time_s": time,
                "displacement_mm": read(random, moved, 0.01, 0.005),
                "velocity_mm_per_s": read(random, speed, 0.6, 0.1),
                "coil_v": volts,
                "force_n": read(random, shown, 2.0, 0.5, drift=3.0),
            }
        )
    return out


# ---- a quarter of a car --------------------------------------------------------------------------


def quarter_car(lacking: float) -> list[Columns]:
    """The damper is three times as stiff in rebound as in bump, and digressive; 200 Hz."""
    out = []
    for seed, samples in ((121, 4000), (122, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.005)
        road = 0.0075 * multisine(random, time, 0.4, 12.0, 90) + 0.01 * levels(
            random, samples, (150, 400), -1.0, 1.0
        )
        road = np.convolve(road, np.ones(7) / 7.0, "same")  # as wide as a tyre's patch

        def rates(x: list[float], u: list[float], t: float) -> list[float]:
            body, body_rate, wheel, wheel_rate = x
            stretch, rate = body - wheel, body_rate - wheel_rate
            damping = 1270.0 + lacking * (630.0 if rate > 0.0 else -630.0)
            damper = damping * rate / (1.0 + 0.12 * lacking * abs(rate))
            strut = -17800.0 * stretch - 60000.0 * stretch**3 - damper
            tyre = -172000.0 * (wheel - u[0]) - 90.0 * lacking * wheel_rate
            return [body_rate, strut / 288.0, wheel_rate, (tyre - strut) / 39.0]

        states = free_run(rates, [0.0] * 4, road, 0.005, 5, held=False)
        slopes = np.array(
            [rates(x, [u], 0.0) for x, u in zip(states.tolist(), road.tolist(), strict=True)]
        )
        out.append(
            {
                "time_s": time,
                "road_mm": read(random, 1e3 * road, 0.02, 0.01),
                "travel_mm": read(random, 1e3 * (states[:, 0] - states[:, 2]), 0.15, 0.05),
                "body_m_per_s2": read(random, slopes[:, 1] + 0.03 * lacking, 0.04, 0.005),
            }
        )
    return out


# ---- a link behind a coupling --------------------------------------------------------------------


def coupled_link(lacking: float) -> list[Columns]:
    """A motor turns a wheel by a springy coupling that has 1.6 degrees of play; 500 Hz."""
    out = []
    for seed, samples in ((131, 4000), (132, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.002)
        wanted = levels(random, samples, (60, 240), -1.0, 1.0) + 0.3 * swept(time, 0.5, 8.0)
        half = math.radians(0.8) * lacking

        def rates(x: list[float], u: list[float], t: float, half=half) -> list[float]:
            motor, motor_rate, wheel, wheel_rate = x
            twist = motor - wheel
            past = twist - half if twist > half else twist + half if twist < -half else 0.0
            touch = 1.0 if past else 0.15
            shaft = 26.0 * past * (1.0 + 0.5 * abs(past)) + touch * 0.05 * (motor_rate - wheel_rate)
            turned = u[0] * (1.0 + 0.015 * math.sin(7.0 * motor))
            return [
                motor_rate,
                (turned - shaft - 0.021 * motor_rate) / 0.0062,
                wheel_rate,
                (shaft - 0.009 * wheel_rate) / 0.0115,
            ]

        def control(row: list[float], x: list[float]) -> list[float]:
            sent = 1.6 * (row[0] - x[0]) - 0.07 * x[1]
            return [round(min(max(sent, -2.5), 2.5) / 0.005) * 0.005]

        states = free_run(rates, [0.0] * 4, wanted, 0.002, 6, control=control)
        out.append(
            {
                "time_s": time,
                "torque_n_m": wanted,
                "motor_deg": read(random, np.degrees(states[:, 0]), 0.005, 0.02),
                "wheel_deg": read(random, np.degrees(states[:, 2]), 0.005, 0.02),
            }
        )
    return out


# ---- a pendulum with a propeller -----------------------------------------------------------------


def aero_pendulum(lacking: float) -> list[Columns]:
    """A wide paddle swings in air, whose drag grows with the square of speed; 100 Hz."""
    out = []
    for seed, samples in ((141, 4500), (142, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.01)
        duty = levels(random, samples, (60, 300), -0.9, 0.9)
        duty[(time % 15.0) > 10.0] = 0.0  # left to swing freely
        duty = quantised(duty, 1.0 / 255.0)
        thrust = rough(np.random.default_rng(1410), -1.0, 1.0, 0.02)

        def rates(x: list[float], u: list[float], t: float, thrust=thrust) -> list[float]:
            angle, speed, blown = x
            push = 0.62 * blown * thrust(blown)
            drag = 0.0105 * lacking * speed * abs(speed)
            torque = push - 0.83 * math.sin(angle) - 0.0042 * speed - drag
            return [speed, torque / 0.0235, (u[0] - blown) / 0.06]

        angle = free_run(rates, [0.0] * 3, duty, 0.01, 5)[:, 0]
        out.append(
            {
                "time_s": time,
                "duty": duty,
                "angle_deg": read(random, np.degrees(angle) + 0.3 * lacking, 0.03, 0.18),
            }
        )
    return out


# ---- a mass between two pairs of springs ---------------------------------------------------------


def shaker_mass(lacking: float) -> list[Columns]:
    """The base of a mass on springs rubs dryly against a guide; force by a shaker, 1 kHz."""
    out = []
    for seed, samples in ((151, 4000), (152, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.001)
        force = 14.0 * multisine(random, time, 1.0, 30.0, 60) * (0.4 + 0.6 * (time < 2.2))
        strong = rough(np.random.default_rng(1510), -0.01, 0.01, 0.02)

        def rates(x: list[float], u: list[float], t: float, strong=strong) -> list[float]:
            position, speed, late = x
            spring = 11900.0 * position * strong(position)
            rubbed = 5.2 * lacking * math.tanh(speed / 0.0015)
            return [speed, (late - spring - 11.0 * speed - rubbed) / 1.12, (u[0] - late) / 0.0003]

        moved = free_run(rates, [0.0] * 3, force, 0.001, 8, held=False)[:, 0]
        out.append(
            {
                "time_s": time,
                "force_n": read(random, force, 0.05, 0.02),
                "position_mm": read(random, 1e3 * moved, 0.004, 0.002),
            }
        )
    return out
