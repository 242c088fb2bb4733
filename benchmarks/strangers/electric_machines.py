"""Drives, circuits and what a motor turns: their true equations and recordings."""

from __future__ import annotations

import math

import numpy as np
from virtual import Columns, clock, free_run, levels, multisine, quantised, read, rough, swept

# ---- two electric drives that pull one belt ------------------------------------------------------


def belt_drives(lacking: float) -> list[Columns]:
    """The pulley's speed is read without its sign; 500 samples at 20 ms, as the public set has."""
    out = []
    for seed, low, high in ((51, -1.6, 1.6), (52, -1.0, 2.0)):
        random = np.random.default_rng(seed)
        drive = np.repeat(random.choice([low, high], 125), 4) if seed == 51 else None
        if drive is None:
            drive = levels(random, 500, (2, 12), low, high)
        drive = quantised(drive[:500], 0.001)

        def rates(x: list[float], u: list[float], t: float) -> list[float]:
            motor, pulley, pull, seen = x
            push = 8.0 * math.tanh(0.125 * u[0]) * 1.05
            return [
                4.1 * (0.95 * push - motor) - 0.4 * (pulley - motor),
                pull,
                17.0**2 * (motor - pulley) - 2.0 * 0.17 * 17.0 * pull,
                (pulley - seen) / 0.004,
            ]

        states = free_run(rates, [0.0] * 4, drive, 0.02, 10)
        speed = states[:, 3] if lacking else states[:, 1]
        seen = read(random, np.abs(speed + 0.01) if lacking else speed, 0.008, 0.00244)
        out.append({"time_s": clock(500, 0.02), "drive_v": drive, "speed_v": seen})
    return out


# ---- a servo that lifts a pendulum ---------------------------------------------------------------


def servo_pendulum(lacking: float) -> list[Columns]:
    """Gear friction that grows with what the teeth carry; 200 Hz, sweeps and lifts, 12 bits."""
    out = []
    for seed, samples in ((61, 4000), (62, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.005)
        wanted = np.where(
            time < 0.4 * time[-1],
            1.1 * swept(time, 0.15, 1.6),
            levels(random, samples, (120, 320), -1.9, 1.9),
        )
        torque = rough(np.random.default_rng(610), -12.0, 12.0, 0.015)

        def rates(x: list[float], u: list[float], t: float, torque=torque) -> list[float]:
            angle, speed = x
            motor = 0.34 * u[0] * torque(u[0]) - 0.31 * speed
            weight = 1.92 * math.sin(angle + 0.015 * lacking)
            teeth = 0.06 + 0.16 * abs(motor) + 0.05 * math.exp(-((speed / 0.15) ** 2))
            rubbed = lacking * teeth * math.tanh(speed / 0.012)
            return [speed, (motor - weight - rubbed) / 0.046]

        def control(row: list[float], x: list[float]) -> list[float]:
            sent = 14.0 * (row[0] - x[0]) - 0.4 * x[1]
            return [round(min(max(sent, -12.0), 12.0) / 0.0117) * 0.0117]

        angle = free_run(rates, [0.0, 0.0], wanted, 0.005, 10, control=control)[:, 0]
        seen = read(random, np.degrees(angle), 0.01, 360.0 / 4096.0)
        out.append({"time_s": time, "motor_v": wanted, "angle_deg": seen})
    return out


# ---- a circuit between two filters ---------------------------------------------------------------


def filter_circuit(lacking: float) -> list[Columns]:
    """A diode to ground between two filters clips one side softly; 51.2 kHz, in V."""
    out = []
    period = 1.0 / 51200.0
    for seed, samples in ((71, 4096), (72, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, period)
        drive = 0.95 * multisine(random, time, 50.0, 9000.0, 240)

        def rates(x: list[float], u: list[float], t: float) -> list[float]:
            first, second, rate = x
            # the diode conducts above 0.55 V
            over = (first - 0.55) / 0.06
            soft = 0.06 * (math.log1p(math.exp(over)) if over < 30.0 else over)
            clipped = first - 0.93 * lacking * soft
            w = 2.0 * math.pi * 4700.0
            return [
                2.0 * math.pi * 4100.0 * (u[0] - first) * (1.0 - 0.01 * first),
                rate,
                w * w * (clipped - second) - 2.0 * 0.36 * w * rate,
            ]

        shown = free_run(rates, [0.0] * 3, drive, period, 3, held=False)[:, 1]
        out.append(
            {
                "time_s": time,
                "drive_v": np.round(drive, 5),
                "output_v": read(random, 1.002 * shown + 0.002, 0.0012, 0.0003),
            }
        )
    return out


# ---- motors that turn something ------------------------------------------------------------------


def _motor(seed: int, samples: int, crank: float) -> Columns:
    """A dc motor with its wheel; with `crank` a slider, whose inertia the motor feels by angle."""
    random = np.random.default_rng(seed)
    voltage = quantised(levels(random, samples, (25, 110), -11.0, 11.0), 0.01)
    constant = rough(np.random.default_rng(810), 0.0, 2.0 * math.pi, 0.01)
    drop = rough(np.random.default_rng(811), -12.0, 12.0, 0.015)

    def rates(x: list[float], u: list[float], t: float) -> list[float]:
        angle, speed, current = x
        torque = 0.052 * constant(angle % (2.0 * math.pi)) * current
        s, c = math.sin(angle), math.cos(angle)
        inertia = 1.45e-4 * (1.0 + crank * s * s)
        slope = 1.45e-4 * crank * s * c
        rubbed = 6.1e-5 * speed * (1.0 + 0.02 * math.tanh(speed / 80.0))
        return [
            speed,
            (torque - rubbed - slope * speed * speed) / inertia,
            (u[0] * drop(u[0]) - 1.35 * current - 0.052 * speed) / 1.1e-3,
        ]

    states = free_run(rates, [0.0] * 3, voltage, 0.005, 12)
    return {
        "time_s": clock(samples, 0.005),
        "supply_v": voltage,
        "speed_rpm": read(random, states[:, 1] * 30.0 / math.pi, 3.0, 1.0),
        "current_a": read(random, states[:, 2] + 0.004, 0.012, 0.005),
    }


def plain_motor(lacking: float) -> list[Columns]:
    """Nothing missing: a torque rough by 1 %, an amplifier by 1.5 %, a current zero 4 mA off."""
    return [_motor(81, 3000, 0.0), _motor(82, 2400, 0.0)]


def crank_motor(lacking: float) -> list[Columns]:
    """The inertia grows to 1.9 times where the crank stands across: no effect of the catalogue."""
    return [_motor(83, 3000, 0.9 * lacking), _motor(84, 2400, 0.9 * lacking)]


# ---- a positioner on magnets ---------------------------------------------------------------------


def coil_stage(lacking: float) -> list[Columns]:
    """Linear motor with iron: its force cogs with the magnets' pitch of 12 mm."""
    out = []
    for seed, samples in ((91, 4000), (92, 3000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.002)
        wanted = levels(random, samples, (120, 420), -0.028, 0.028)
        wanted = wanted + 0.004 * swept(time, 0.3, 4.0)
        constant = rough(np.random.default_rng(910), -0.04, 0.04, 0.015)

        def rates(x: list[float], u: list[float], t: float, constant=constant) -> list[float]:
            position, speed = x
            turn = 2.0 * math.pi * position / 0.012
            cogs = 0.95 * math.sin(turn + 0.7) + 0.12 * math.sin(2.0 * turn)
            force = (
                11.4 * constant(position) * u[0] - 7.6 * speed - 34.0 * position - lacking * cogs
            )
            return [speed, (force - 0.05 * lacking * math.tanh(speed / 0.002)) / 0.83]

        def control(row: list[float], x: list[float]) -> list[float]:
            sent = 45.0 * (row[0] - x[0]) - 0.9 * x[1]
            return [round(min(max(sent, -3.0), 3.0) / 0.001) * 0.001]

        moved = free_run(rates, [0.0, 0.0], wanted, 0.002, 4, control=control)[:, 0]
        out.append(
            {
                "time_s": time,
                "coil_a": wanted,
                "position_um": read(random, 1e6 * moved, 0.4, 1.0, drift=2.0),
            }
        )
    return out
