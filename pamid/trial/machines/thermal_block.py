"""A block that is heated and cools to its surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, drawn_from, known_fault, nameless_fault
from pamid.trial.starter_faults import NEVER, SignalSizes
from pamid.trial.starter_kernel import rough
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine

ROOM_K = 293.15


@dataclass(frozen=True)
class BlockSizes:
    """Sizes of faults in the block.

    draught: W, lost at 50 K to a flow that hardly grows with the difference (power of 0.55); boils,
    boiling: K above the surroundings from which more is lost, and how much, W/K1.3; glow: share of
    radiation in the losses at 100 K; core, core_s: share of the capacity that warms up behind the
    rest, and how soon; breeze, breeze_s: share of the losses that comes and goes with the wind, and
    how often; stored: J/K, a second capacity that melts about melts K above the room
    """

    draught: float = 0.0
    boils: float = NEVER
    boiling: float = 0.0
    glow: float = 0.0
    core: float = 0.0
    core_s: float = 1.0
    breeze: float = 0.0
    breeze_s: float = 1.0
    stored: float = 0.0
    melts: float = 40.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """The temperature of the block above the room's usual temperature."""
    block = f[0]
    warm = deep = 0.0
    for k in range(u.shape[0]):
        y[k, 0] = warm
        above = warm - (u[k, 1] - ROOM_K)
        loss = m.loss * (1.0 + rough(maps[0], above - 60.0)) * above
        loss *= 1.0 + block.breeze * np.sin(2.0 * np.pi * k * h / block.breeze_s)
        loss += block.draught * np.sign(above) * (abs(above) / 50.0) ** 0.55
        loss += block.boiling * max(above - block.boils, 0.0) ** 1.3
        hot, cold = warm + ROOM_K, u[k, 1]
        loss += block.glow * m.loss * 100.0 * (hot**4 - cold**4) / ((cold + 100.0) ** 4 - cold**4)
        inward = 0.0
        capacity = m.capacity
        if block.core > 0.0:
            inward = block.core * m.capacity * (warm - deep) / block.core_s
            deep += h * (warm - deep) / block.core_s
            capacity *= 1.0 - block.core
        capacity += block.stored * np.exp(-(((warm - block.melts) / 5.0) ** 2))
        warm += h * (u[k, 0] * (1.0 + rough(maps[1], u[k, 0] - 50.0)) - loss - inward) / capacity


MACHINE = StarterMachine(
    name="thermal-block",
    period_s=10.0,
    seconds=24000.0,
    steps=20,
    sent={
        "power_w": SentLevels(0.0, 100.0, (200.0, 1500.0)),
        "ambient_degc": SentLevels(ROOM_K - 3.0, ROOM_K + 3.0, (1500.0, 5000.0), ramped=True),
    },
    logged=("temperature_degc",),
    log={
        "power_w": LoggedColumn(port="heater"),
        "ambient_degc": LoggedColumn(shift=273.15, noise=0.02, steps=(0.01, 0.06)),
        "temperature_degc": LoggedColumn(
            noise=0.05, shift=-20.0, steps=(0.01, 0.06), port="sensor"
        ),
    },
    parameters={
        "capacity": around(400.0, 1.0 / 1.2, 1.2),
        "loss": around(0.8, 1.0 / 1.3, 1.3),
    },
    ports={
        "heater": SignalSizes(full=100.0, timescale_s=400.0, one_sided=True),
        "block": BlockSizes(),
        "sensor": SignalSizes(full=100.0, timescale_s=400.0, one_sided=True),
    },
    inside=("block",),
    commands=("heater",),
    clock="sensor",
    # A zero of the heater and a zero of the sensor have the same effect. Heat has no play.
    leave_out={
        "heater": ("gain-error", "offset", "play"),
        "sensor": ("gain-error", "offset", "play"),
    },
    further=(
        known_fault("leak", "leak", "block", {"draught": around(8.0)}, also=("orifice-loss",)),
        known_fault(
            "overflow", "overflow", "block", {"boiling": around(0.3), "boils": between(45.0, 65.0)}
        ),
        known_fault(
            "pwm-quantisation",
            "valve-dead-band",
            "heater",
            {"pulse_s": between(60.0, 150.0), "ticks": drawn_from(6.0, 8.0, 12.0)},
        ),
        known_fault("growing-loss", "leak", "block", {"glow": around(0.2)}),
        known_fault(
            "second-store",
            "second-store",
            "block",
            {"core": between(0.2, 0.5), "core_s": between(150.0, 500.0)},
            "core",
        ),
        nameless_fault("breeze", "block", {"breeze": around(0.3), "breeze_s": around(2500.0)}),
        nameless_fault("melting", "block", {"stored": around(300.0), "melts": between(35.0, 60.0)}),
    ),
    maps=(60.0, 50.0),
    run=run,
)
