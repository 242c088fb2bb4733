"""A geared DC motor with a load, driven by a voltage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, fixed
from pamid.trial.starter_faults import (
    ForceSizes,
    SignalSizes,
    clock_fault,
    force_faults,
    known_fault,
    level_friction,
    load_friction,
    nameless_fault,
    signal_faults,
)
from pamid.trial.starter_kernel import MEMORY, arrested, resisted, rough
from pamid.trial.starter_machine import Column, Sent, StarterMachine

Array = NDArray[np.float64]

PERIOD_S, SECONDS = 0.002, 8.0


@dataclass(frozen=True)
class GearSizes:
    """What is planted between the shaft and the load, and in the motor itself.

    outboard: share of the inertia that hangs behind a spring; outboard_hz: its frequency with the
    shaft held; play: half gap before the spring, rad; bent_damping: N m s, damping that comes and
    goes with the angle; fade: share of the constant that a current of 5 A takes off; warmth: share
    by which the winding's resistance grows at 100 W
    """

    outboard: float = 0.0
    outboard_hz: float = 15.0
    outboard_ratio: float = 0.03
    play: float = 0.0
    bent_damping: float = 0.0
    fade: float = 0.0
    warmth: float = 0.0
    warmth_s: float = 2.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Angle and current; trapezoidal in what damps, so that the step's error is of second order."""
    shaft, gear = f
    z = np.zeros(MEMORY)
    angle = speed = heat = 0.0
    load_angle = load_speed = 0.0
    for k in range(u.shape[0]):
        constant = m.constant * m.ratio * (1.0 + rough(maps[0], angle))
        resistance = m.resistance * (1.0 + gear.warmth * heat)
        current = (u[k, 0] - constant * speed) / resistance
        constant /= 1.0 + gear.fade * (current / 5.0) ** 2
        y[k, 0], y[k, 1] = angle, (u[k, 0] - constant * speed) / resistance
        heat += h / gear.warmth_s * (resistance * y[k, 1] ** 2 / 100.0 - heat)
        inertia = m.inertia * (1.0 - gear.outboard)
        driving = constant * u[k, 0] / resistance
        push = driving - resisted(
            angle, speed, constant * y[k, 1], abs(y[k, 1]), z, shaft, k * h, h
        )
        if gear.outboard > 0.0:
            load = m.inertia * gear.outboard
            swing = 2.0 * np.pi * gear.outboard_hz
            twist = angle - load_angle
            beyond = twist - min(max(twist, -gear.play), gear.play)
            link = load * swing * swing * beyond * (1.0 + (beyond / 0.3) ** 2)
            if beyond != 0.0:
                link += 2.0 * gear.outboard_ratio * load * swing * (speed - load_speed)
            push -= link
            load_speed += h * link / load
            load_angle += h * load_speed
        damped = m.viscous + constant * constant / resistance
        damped += gear.bent_damping * np.sin(0.8 * angle + 0.5) ** 2
        c = 0.5 * h * damped / inertia
        free = (speed * (1.0 - c) + h * push / inertia) / (1.0 + c)
        free = arrested(free, speed, shaft, h, inertia)
        angle += 0.5 * h * (speed + free)
        speed = free


SHAFT = ForceSizes(force=4.0, travel=6.0, speed=7.0)
AMPLIFIER = SignalSizes(full=9.0, timescale_s=0.03)
ENCODER = SignalSizes(full=3.0, timescale_s=0.03)
AMMETER = SignalSizes(full=6.0, timescale_s=0.03)
FLEXIBLE = "flexible-transmission"

MACHINE = StarterMachine(
    name="dc-motor",
    period_s=PERIOD_S,
    seconds=SECONDS,
    steps=40,
    sent={"voltage_v": Sent(-9.0, 9.0, (0.03, 0.5), paired=True)},
    logged=("angle_deg", "current_a"),
    log={
        "voltage_v": Column(port="amplifier"),
        "angle_deg": Column(180.0 / np.pi, noise=0.02, steps=(0.01, 0.04), port="encoder"),
        "current_a": Column(noise=0.02, steps=(0.002, 0.02), port="ammeter"),
    },
    parameters={
        "resistance": around(1.0, 1.0 / 1.2, 1.2),
        "constant": around(0.05, 1.0 / 1.1, 1.1),
        "ratio": fixed(20.0),
        "inertia": around(0.03, 1.0 / 1.4, 1.4),
        "viscous": between(0.01, 0.09),
    },
    ports={
        "amplifier": AMPLIFIER,
        "shaft": SHAFT,
        "gear": GearSizes(),
        "encoder": ENCODER,
        "ammeter": AMMETER,
    },
    inside=("shaft", "gear"),
    listed=(
        *signal_faults(
            "amplifier", AMPLIFIER, SECONDS, True, ("gain-error", "full-wave-rectification")
        ),
        *force_faults("shaft", SHAFT, ("viscous-friction",)),
        load_friction("shaft", SHAFT, 2.0),
        level_friction("shaft", SHAFT, 2.0),
        known_fault(
            "two-mass",
            FLEXIBLE,
            "gear",
            {"outboard": between(0.4, 0.8), "outboard_hz": around(15.0, 0.6, 1.6)},
        ),
        known_fault(
            "backlash",
            FLEXIBLE,
            "gear",
            {
                "outboard": between(0.4, 0.8),
                "outboard_hz": around(30.0, 0.7, 1.5),
                "play": around(0.03),
            },
        ),
        # an encoder that counts from anywhere has no zero, sign or limit to lose
        *signal_faults(
            "encoder",
            ENCODER,
            SECONDS,
            False,
            (
                "dead-zone",
                "asymmetric-dead-zone",
                "saturation",
                "asymmetric-saturation",
                "rectification",
                "full-wave-rectification",
                "offset",
                "gain-error",
            ),
        ),
        *signal_faults("ammeter", AMMETER, SECONDS, False, ("play", "gain-error")),
        clock_fault("encoder", PERIOD_S),
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
