"""A pendulum on the shaft of a geared servo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, fixed, nameless_fault
from pamid.trial.starter_faults import ForceSizes, SignalSizes, SpringSizes, spring_faults
from pamid.trial.starter_kernel import FORCE_MEMORY, resisted, rough, turned
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine

GRAVITY = 9.81


@dataclass(frozen=True)
class HornSizes(SpringSizes):
    """Sizes of faults between the gear and the rod, and in the servo itself.

    bent_damping: N m s, damping that comes and goes with the angle; tired, tired_s: share of the
    torque that half a watt of work takes off in the end, and how soon; windage: N m s2, drag on the
    way down alone
    """

    bent_damping: float = 0.0
    tired: float = 0.0
    tired_s: float = 2.0
    windage: float = 0.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Angle of the gear."""
    gear, horn = f
    x, z = np.zeros(4), np.zeros(FORCE_MEMORY)
    spent = 0.0
    whole = m.mass * m.length * m.length + m.rotor
    for k in range(u.shape[0]):
        angle, speed = x[0], x[1]
        y[k, 0] = angle
        drive = m.gain * (1.0 + rough(maps[0], angle)) * u[k, 0] / (1.0 + horn.tired * spent)
        spent += h / horn.tired_s * (abs(drive * speed) / 0.5 - spent)
        weight = -m.mass * GRAVITY * m.length * np.sin(angle)
        push = drive + weight
        pressed = 0.5 * (drive - weight), abs(drive)
        push -= resisted(angle, speed, pressed, z, gear, k * h, h)
        if speed * angle < 0.0:
            push -= horn.windage * speed * abs(speed)
        damped = m.damping + horn.bent_damping * np.sin(1.2 * angle + 0.5) ** 2
        turned(x, push, damped, whole, gear, horn, h)


MACHINE = StarterMachine(
    name="servo-pendulum",
    period_s=0.005,
    seconds=20.0,
    steps=40,
    sent={"voltage_v": SentLevels(-5.0, 5.0, (0.1, 1.0), paired=True)},
    logged=("angle_deg",),
    log={
        "voltage_v": LoggedColumn(port="driver"),
        "angle_deg": LoggedColumn(180.0 / np.pi, noise=0.05, steps=(0.02, 0.09), port="encoder"),
    },
    parameters={
        "mass": fixed(0.3),
        "length": fixed(0.15),
        "gain": around(0.117, 1.0 / 1.2, 1.2),
        "damping": around(0.22, 1.0 / 1.3, 1.3),
        "rotor": around(0.005, 1.0 / 1.6, 1.6),
    },
    ports={
        "driver": SignalSizes(full=5.0, timescale_s=0.1),
        "gear": ForceSizes(force=0.4, travel=2.0, speed=2.5, load=0.3),
        "horn": HornSizes(),
        "encoder": SignalSizes(full=0.8, timescale_s=0.1),
    },
    inside=("gear", "horn"),
    commands=("driver",),
    clock="encoder",
    leave_out={
        "driver": ("gain-error", "full-wave-rectification"),
        "gear": ("viscous-friction",),
        # but for large angles a gain of it equals a gain of the drive
        "encoder": ("gain-error", "rectification", "full-wave-rectification"),
    },
    twins={"constant-offset@gear": "offset", "offset@driver": "constant-offset"},
    further=(
        *spring_faults("horn", 6.0, 0.04),
        nameless_fault("bent-damping", "gear", {"bent_damping": around(0.15)}),
        nameless_fault(
            "tired-servo", "driver", {"tired": around(0.3), "tired_s": between(1.0, 5.0)}
        ),
        nameless_fault("windage", "gear", {"windage": around(0.05)}),
    ),
    maps=(1.2,),
    run=run,
)
