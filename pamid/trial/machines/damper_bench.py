"""A damper in a testing machine: its rod is moved, its force is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, nameless_fault
from pamid.trial.starter_faults import ForceSizes, SignalSizes
from pamid.trial.starter_kernel import FORCE_MEMORY, resisted, rough, sliding
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine


@dataclass(frozen=True)
class FluidSizes:
    """Sizes of faults at this rig that no catalogue contains.

    bypass: share of the damping that grooves in the tube take off within 3 mm of the middle; gulp:
    share of it missing while air is pushed through the piston after a turn, over gulp_m of the way;
    rubber, rubber_s: stiffness (N/m) of a bush next to the damper, and how soon its force is gone
    """

    bypass: float = 0.0
    gulp: float = 0.0
    gulp_m: float = 1e-3
    rubber: float = 0.0
    rubber_s: float = 1.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Force of the machine at the speed of the last step."""
    rod, fluid = f
    z = np.zeros(FORCE_MEMORY)
    pressed = since = 0.0
    before, last = u[0, 0], 0.0
    for k in range(u.shape[0]):
        speed = (u[k, 0] - before) / h
        before = u[k, 0]
        if speed * last < 0.0:
            since = 0.0
        since += abs(speed) * h
        last = speed if speed != 0.0 else last
        thick = m.damping * (1.0 + rough(maps[0], u[k, 0])) * (1.0 + rough(maps[1], speed))
        thick *= 1.0 - fluid.gulp * np.exp(-((since / fluid.gulp_m) ** 2))
        thick *= 1.0 - fluid.bypass * np.exp(-((u[k, 0] / 0.003) ** 2))
        pressed += h * (fluid.rubber * speed - pressed / fluid.rubber_s)
        force = thick * speed + pressed
        force += m.stiffness * u[k, 0] + m.preload
        force += resisted(u[k, 0], speed, (force, abs(u[k, 1])), z, rod, k * h, h)
        y[k, 0] = force + sliding(speed, rod)


MACHINE = StarterMachine(
    name="damper-bench",
    period_s=0.005,
    seconds=15.0,
    steps=20,
    sent={
        "position_mm": SentLevels(-0.01, 0.01, (0.08, 0.6), ramped=True),
        "current_a": SentLevels(0.0, 1.0, (0.5, 2.0), ramped=True),
    },
    logged=("force_n",),
    log={
        "position_mm": LoggedColumn(1e3, noise=2e-4, steps=(1e-4, 5e-4)),
        "current_a": LoggedColumn(noise=0.002, steps=(5e-4, 2e-3)),
        "force_n": LoggedColumn(noise=2.0, steps=(0.2, 2.0), port="load_cell"),
    },
    parameters={
        "damping": around(2000.0, 1.0 / 1.5, 1.5),
        "stiffness": around(1000.0),
        "preload": between(-80.0, 80.0),
    },
    ports={
        "rod": ForceSizes(force=350.0, travel=0.02, speed=0.3, load=200.0, level=0.5),
        "fluid": FluidSizes(),
        "load_cell": SignalSizes(full=400.0, timescale_s=0.04),
    },
    inside=("rod", "fluid"),
    clock="load_cell",
    leave_out={
        "rod": ("gravity", "viscous-friction", "linear-stiffness", "constant-offset"),
        "load_cell": ("play", "gain-error", "offset", "full-wave-rectification"),
    },
    further=(
        nameless_fault("bypass", "rod", {"bypass": between(0.3, 0.7)}),
        nameless_fault("rubber", "rod", {"rubber": around(2e4), "rubber_s": between(0.05, 0.2)}),
        nameless_fault("gulp", "rod", {"gulp": between(0.5, 1.0), "gulp_m": around(1e-3)}),
    ),
    maps=(0.012, 0.3),
    run=run,
)
