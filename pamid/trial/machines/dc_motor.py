"""A geared DC motor with a load, driven by a voltage."""

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


@dataclass(frozen=True)
class GearSizes(SpringSizes):
    """Sizes of faults between the shaft and the load, and in the motor itself.

    bent_damping: N m s, damping that comes and goes with the angle; fade: share of the constant
    that a current of 5 A takes off; warmth: share by which the winding's resistance grows at 100 W
    """

    bent_damping: float = 0.0
    fade: float = 0.0
    warmth: float = 0.0
    warmth_s: float = 2.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Angle and current."""
    shaft, gear = f
    x, z = np.zeros(4), np.zeros(FORCE_MEMORY)
    heat = 0.0
    for k in range(u.shape[0]):
        angle, speed = x[0], x[1]
        constant = m.constant * m.ratio * (1.0 + rough(maps[0], angle))
        resistance = m.resistance * (1.0 + gear.warmth * heat)
        current = (u[k, 0] - constant * speed) / resistance
        constant /= 1.0 + gear.fade * (current / 5.0) ** 2
        y[k, 0], y[k, 1] = angle, (u[k, 0] - constant * speed) / resistance
        heat += h / gear.warmth_s * (resistance * y[k, 1] ** 2 / 100.0 - heat)
        driving = constant * u[k, 0] / resistance
        pressed = constant * y[k, 1], abs(y[k, 1])
        push = driving - resisted(angle, speed, pressed, z, shaft, k * h, h)
        damped = m.viscous + constant * constant / resistance
        damped += gear.bent_damping * np.sin(0.8 * angle + 0.5) ** 2
        turned(x, push, damped, m.inertia, shaft, gear, h)


MACHINE = StarterMachine(
    name="dc-motor",
    period_s=0.002,
    seconds=8.0,
    steps=40,
    sent={"voltage_v": SentLevels(-9.0, 9.0, (0.03, 0.5), paired=True)},
    logged=("angle_deg", "current_a"),
    log={
        "voltage_v": LoggedColumn(port="amplifier"),
        "angle_deg": LoggedColumn(180.0 / np.pi, noise=0.02, steps=(0.01, 0.04), port="encoder"),
        "current_a": LoggedColumn(noise=0.02, steps=(0.002, 0.02), port="ammeter"),
    },
    parameters={
        "resistance": around(1.0, 1.0 / 1.2, 1.2),
        "constant": around(0.05, 1.0 / 1.1, 1.1),
        "ratio": fixed(20.0),
        "inertia": around(0.03, 1.0 / 1.4, 1.4),
        "viscous": between(0.01, 0.09),
    },
    ports={
        "amplifier": SignalSizes(full=9.0, timescale_s=0.03),
        "shaft": ForceSizes(force=4.0, travel=6.0, speed=7.0, load=2.0, level=2.0),
        "gear": GearSizes(),
        "encoder": SignalSizes(full=3.0, timescale_s=0.03),
        "ammeter": SignalSizes(full=6.0, timescale_s=0.03),
    },
    inside=("shaft", "gear"),
    commands=("amplifier",),
    clock="encoder",
    leave_out={
        "amplifier": ("gain-error", "full-wave-rectification"),
        "shaft": ("viscous-friction",),
        # an encoder that counts from anywhere has no zero, sign or limit to lose
        "encoder": (
            "dead-zone",
            "asymmetric-dead-zone",
            "saturation",
            "asymmetric-saturation",
            "rectification",
            "full-wave-rectification",
            "offset",
            "gain-error",
        ),
        "ammeter": ("play", "gain-error"),
    },
    further=(
        *spring_faults("gear", 15.0, 0.03),
        nameless_fault("bent-damping", "shaft", {"bent_damping": around(0.4)}),
        nameless_fault("armature-reaction", "shaft", {"fade": around(0.15)}),
        nameless_fault(
            "hot-winding", "amplifier", {"warmth": around(0.8), "warmth_s": between(0.5, 2.0)}
        ),
    ),
    maps=(8.0,),
    run=run,
    without=("current_a",),
)
