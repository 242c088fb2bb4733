"""A damper in a testing machine: its rod is moved, its force is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between
from pamid.trial.starter_faults import (
    ForceSizes,
    SignalSizes,
    nameless_fault,
)
from pamid.trial.starter_kernel import FORCE_MEMORY, resisted, rough, sliding
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FluidSizes:
    """What no catalogue has a name for at this rig.

    blow_off: share of the damping that a valve takes off beyond a force of 200 N; thinning,
    thinning_s: share of it lost to the heat of 15 W in the end, and how soon; gulp: share of it
    missing while air is pushed through the piston after a turn, over gulp_m of the way
    """

    blow_off: float = 0.0
    thinning: float = 0.0
    thinning_s: float = 1.0
    gulp: float = 0.0
    gulp_m: float = 1e-3


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """What the machine has to push with; the speed is that of the way just made."""
    rod, fluid = f
    z = np.zeros(FORCE_MEMORY)
    heat = since = 0.0
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
        force = thick * speed / (1.0 + fluid.thinning * heat)
        beyond = max(abs(force) - 200.0, 0.0)
        force -= fluid.blow_off * np.sign(force) * beyond * beyond / (beyond + 50.0)
        heat += h / fluid.thinning_s * (abs(force * speed) / 15.0 - heat)
        force += m.stiffness * u[k, 0] + m.preload
        force += resisted(u[k, 0], speed, force, abs(u[k, 1]), z, rod, k * h, h)
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
        nameless_fault("blow-off", "rod", {"blow_off": between(0.3, 0.8)}),
        nameless_fault(
            "thinning", "rod", {"thinning": around(0.3), "thinning_s": between(1.0, 5.0)}
        ),
        nameless_fault("gulp", "rod", {"gulp": between(0.5, 1.0), "gulp_m": around(1e-3)}),
    ),
    maps=(0.012, 0.3),
    run=run,
)
