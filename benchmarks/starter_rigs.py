"""Known faults in plain equations of the machines behind the starter rigs, and the answers:
`python benchmarks/starter_rigs.py [--only NAME]` (10 to 100 s of CPU each).

The machines are integrated with numpy and scipy alone, from equations that share nothing with a
rig's file. What is planted has the physics of the fault, not the form of the effect.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from pamid.base.arrays import Array

#: sampling period in s, and columns by name
Recorded = tuple[float, dict[str, Array]]
GRAVITY = 9.81


@dataclass(frozen=True)
class Machine:
    """rig: the starter rig; planted: the effect that it lacks; record: the sampling period in s and
    the columns by name, from a random generator."""

    rig: str
    planted: str
    record: Callable[[np.random.Generator], Recorded]


def levels(rng: np.random.Generator, count: int, hold: tuple[int, int]) -> Array:
    """Random levels within +-1, each held for a random number of samples."""
    values = np.empty(0)
    while len(values) < count:
        values = np.append(values, np.full(rng.integers(*hold), rng.uniform(-1.0, 1.0)))
    return values[:count]


def reversals(rng: np.random.Generator, count: int, hold: tuple[int, int]) -> Array:
    """The same with alternating signs: a motor goes to and fro instead of away."""
    sizes = levels(rng, count, hold)
    jumps = np.flatnonzero(np.diff(sizes, prepend=np.nan))
    turns = np.searchsorted(jumps, np.arange(count), side="right")
    return np.abs(sizes) * (-1.0) ** turns


def stepped(
    rate: Callable[[Array, float], Array], start: Array, sent: Array, period_s: float, parts: int
) -> Array:
    """States at every sample, by the classical Runge-Kutta method with `parts` steps a sample."""
    states, x, h = np.empty((len(sent), len(start))), start.astype(float), period_s / parts
    for k, u in enumerate(sent):
        states[k] = x
        for _ in range(parts):
            a = rate(x, u)
            b = rate(x + 0.5 * h * a, u)
            c = rate(x + 0.5 * h * b, u)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + h * c, u))
    return states


def geared_motor(rng: np.random.Generator, gap: float, dry: float) -> Recorded:
    """Motor (1.1 Ohm, 0.048 N m/A), 20:1 gear, load of 0.024 kg m2; gap: half the play, rad; dry:
    friction of the load, N m."""
    period_s, count, ratio, k, resistance = 0.002, 10_000, 20.0, 0.048, 1.1
    voltage = 8.0 * reversals(rng, count, (50, 200))

    def rate(x: Array, u: float) -> Array:
        motor, wm, load, wl = x
        twist = motor / ratio - load
        beyond = twist - np.clip(twist, -gap, gap)
        torque = 260.0 * beyond + 0.4 * (wm / ratio - wl) * (beyond != 0.0 or gap == 0.0)
        drive = k * (u - k * wm) / resistance
        return np.array(
            [
                wm,
                (drive - 4e-5 * wm - torque / ratio) / 4.4e-5,
                wl,
                (torque - 0.06 * wl - dry * np.tanh(wl / 0.02)) / 0.024,
            ]
        )

    x = stepped(rate, np.zeros(4), voltage, period_s, 8)
    return period_s, {
        "voltage_v": voltage,
        "motor_angle_deg": np.rad2deg(x[:, 0]) + rng.normal(0.0, 0.1, count),
        "load_angle_deg": np.rad2deg(x[:, 2]) + rng.normal(0.0, 0.02, count),
        "current_a": (voltage - k * x[:, 1]) / resistance + rng.normal(0.0, 0.02, count),
    }


def thruster(rng: np.random.Generator) -> Recorded:
    """5.4 N/V behind a dead zone of +-0.9 V."""
    command = 8.0 * levels(rng, 1500, (5, 40))
    force = 5.4 * np.sign(command) * np.maximum(np.abs(command) - 0.9, 0.0) + 0.3
    return 0.02, {"command_v": command, "force_n": force + rng.normal(0.0, 0.2, len(force))}


def released_pendulum(rng: np.random.Generator) -> Recorded:
    """A pendulum of 0.31 m with 0.012 N m of dry friction, let go from 57 degrees; every half swing
    has one sign of the friction, and ends where it comes to rest."""
    period_s, count, inertia = 0.01, 2500, 0.5 * 0.25 * 0.31
    at = period_s * np.arange(count)
    angle, t, x, way = np.zeros(count), 0.0, 1.0, -1.0
    while t < at[-1]:
        if 0.5 * GRAVITY * 0.25 * abs(np.sin(x)) <= 0.012:  # stuck
            angle[at >= t] = x
            break

        def rate(_: float, y: Array, way: float = way) -> list[float]:
            torque = -0.5 * GRAVITY * 0.25 * np.sin(y[0]) - way * 0.012
            return [y[1], torque / inertia - 0.04 * y[1]]

        def turns(_: float, y: Array) -> float:
            return float(y[1])

        turns.terminal = True  # type: ignore[attr-defined]
        turns.direction = -way  # type: ignore[attr-defined]
        span = (t, at[-1] + period_s)
        run = solve_ivp(
            rate, span, [x, 0.0], events=turns, rtol=1e-9, atol=1e-11, dense_output=True
        )
        inside = (at >= t) & (at <= run.t[-1])
        angle[inside] = run.sol(at[inside])[0]
        t, x, way = run.t[-1], run.y[0, -1], -way
    return period_s, {"angle_deg": np.rad2deg(angle) + rng.normal(0.0, 0.05, count)}


def furnace(rng: np.random.Generator) -> Recorded:
    """Element of 35 J/K in a body of 430 J/K, up to 300 degC, which radiates from 0.05 m2."""
    period_s, count, room = 5.0, 2400, 293.15
    power = 150.0 + 140.0 * levels(rng, count, (30, 120))

    def rate(x: Array, u: float) -> Array:
        over = 2.3 * (x[0] - x[1])
        radiated = 0.05 * 5.67e-8 * (x[1] ** 4 - room**4)
        return np.array([(u - over) / 35.0, (over - 0.3 * (x[1] - room) - radiated) / 430.0])

    x = stepped(rate, np.full(2, room), power, period_s, 4) - 273.15
    return period_s, {
        "power_w": power,
        "element_temperature_degc": x[:, 0] + rng.normal(0.0, 0.1, count),
        "body_temperature_degc": x[:, 1] + rng.normal(0.0, 0.05, count),
    }


def limited_servo(rng: np.random.Generator) -> Recorded:
    """14 1/s to the goal, a lag of 25 ms, at most 3.2 rad/s."""
    period_s, count = 0.01, 4000
    goal = np.deg2rad(50.0) * levels(rng, count, (20, 120))

    def rate(x: Array, u: float) -> Array:
        return np.array([x[1], (np.clip(14.0 * (u - x[0]), -3.2, 3.2) - x[1]) / 0.025])

    x = stepped(rate, np.zeros(2), goal, period_s, 8)
    read = np.rad2deg(x[:, 0]) + rng.normal(0.0, 0.1, count)
    return period_s, {"goal_deg": np.rad2deg(goal), "angle_deg": read}


def overfull_tank(rng: np.random.Generator) -> Recorded:
    """9 cm3/s per volt into 52 cm2, out through 0.21 cm2, over the rim at 12 cm."""
    period_s, count = 2.0, 1800
    pump = 3.0 + 1.6 * levels(rng, count, (10, 60))

    def rate(x: Array, u: float) -> Array:
        out = 0.21e-4 * np.sqrt(2.0 * GRAVITY * max(x[0], 0.0))
        return np.array([(9e-6 * u - out) / 52e-4])

    level = np.empty(count)
    x = np.array([0.05])
    for k, u in enumerate(pump):
        level[k] = x[0]
        for _ in range(20):
            x = np.minimum(x + period_s / 20 * rate(x, u), 0.12)
    return period_s, {"pump_v": pump, "level_cm": 100.0 * level + rng.normal(0.0, 0.05, count)}


def without(record: Recorded, column: str) -> Recorded:
    """The recording less a column."""
    period_s, columns = record
    return period_s, {name: values for name, values in columns.items() if name != column}


def motor_with_play(rng: np.random.Generator) -> Recorded:
    """2 degrees of play between motor and load."""
    return geared_motor(rng, np.deg2rad(1.0), 0.0)


MACHINES = {
    "geared-motor-play": Machine(
        "geared-motor",
        "coupling-play",
        motor_with_play,
    ),
    "geared-motor-friction": Machine(
        "geared-motor", "coulomb-friction", lambda rng: geared_motor(rng, 0.0, 0.4)
    ),
    "geared-motor-load-encoder": Machine(
        "geared-motor",
        "coupling-play",
        lambda rng: without(motor_with_play(rng), "motor_angle_deg"),
    ),
    "geared-motor-motor-encoder": Machine(
        "geared-motor", "coupling-play", lambda rng: without(motor_with_play(rng), "load_angle_deg")
    ),
    "static-map": Machine("static-map", "dead-zone", thruster),
    "free-decay": Machine("free-decay", "coulomb-friction", released_pendulum),
    "thermal-two-mass": Machine("thermal-two-mass", "growing-loss", furnace),
    "servo": Machine("servo", "saturation", limited_servo),
    "pump-tank": Machine("pump-tank", "overflow", overfull_tank),
}


def recorded(name: str, path: Path, seed: int = 1, share: float = 1.0) -> None:
    """Write the recording of a machine, or its first share, as a CSV file."""
    period_s, columns = MACHINES[name].record(np.random.default_rng(seed))
    count = len(next(iter(columns.values())))
    table = np.column_stack([period_s * np.arange(count), *columns.values()])
    table = table[: round(share * count)]
    head = ",".join(["time_s", *columns])
    np.savetxt(path, table, "%.6g", ",", header=head, comments="")


def worded(cause: dict[str, Any]) -> str:
    """A cause with its parameters."""
    values = [f"{name} {one['value']:.4g}" for name, one in cause["parameters"].items()]
    return f"{cause['effect']} {', '.join(values)}"


def main() -> None:
    """Diagnose the machines and print the leading causes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=MACHINES)
    only = parser.parse_args().only
    for name, machine in MACHINES.items():
        if only not in (None, name):
            continue
        with tempfile.TemporaryDirectory() as folder:
            recording, run = Path(folder) / "rec.csv", Path(folder) / "run"
            recorded(name, recording)
            before = time.perf_counter()
            words = ("diagnose", str(recording), "--rig", machine.rig, "--jobs", "1")
            subprocess.run(
                [sys.executable, "-m", "pamid_cli", *words, "--output", str(run)],
                check=True,
                capture_output=True,
            )
            said = json.loads((run / "diagnosis.json").read_text())
        causes = "; ".join(map(worded, said["causes"])) or "-"
        spent = time.perf_counter() - before
        print(f"{name:<24} {machine.planted:<16} {said['verdict']:<18} {spent:4.0f} s  {causes}")


if __name__ == "__main__":
    main()
