"""A pneumatic cylinder on a force bench: its rod is moved, its force is read."""

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
class BarrelSizes:
    """Sizes of faults at this rig that no catalogue contains.

    barrel: relative change of the bore's area over 20 mm of the way; late_s: by which the recorded
    pressure is behind the pressure at the piston; bleed: share of the force that a cell which holds
    a charge loses in the end, bleed_s: how soon
    """

    barrel: float = 0.0
    late_s: float = 0.0
    bleed: float = 0.0
    bleed_s: float = 1.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Force of the drive at the speed of the last step."""
    piston, barrel = f
    z = np.zeros(FORCE_MEMORY)
    before, reading = u[0, 0], u[0, 1]
    lost = 0.0
    for k in range(u.shape[0]):
        way, pressure = u[k, 0], u[k, 1] + barrel.late_s * (u[k, 1] - reading) / h
        reading = u[k, 1]
        speed = (way - before) / h
        before = way
        area = m.area * (1.0 + rough(maps[0], way)) * (1.0 + rough(maps[1], pressure - 4e5))
        area *= 1.0 + barrel.barrel * np.sin(way / 0.02)
        push = area * pressure
        force = push + m.preload + resisted(way, speed, (push, abs(pressure)), z, piston, k * h, h)
        force += sliding(speed, piston)
        lost += h / barrel.bleed_s * (force - lost)
        y[k, 0] = force - barrel.bleed * lost


MACHINE = StarterMachine(
    name="cylinder-bench",
    period_s=0.02,
    seconds=60.0,
    steps=10,
    sent={
        "position_mm": SentLevels(-0.02, 0.02, (0.4, 2.0), ramped=True),
        "pressure_bar": SentLevels(1.5e5, 6.5e5, (0.8, 4.0), ramped=True),
    },
    logged=("force_n",),
    log={
        "position_mm": LoggedColumn(1e3, noise=2e-3, steps=(1e-3, 5e-3)),
        "pressure_bar": LoggedColumn(1e-5, noise=5e-4, steps=(2e-4, 1e-3), port="gauge"),
        "force_n": LoggedColumn(noise=0.5, steps=(0.05, 0.5), port="load_cell"),
    },
    parameters={"area": around(5e-4, 1.0 / 1.15, 1.15), "preload": between(-15.0, 15.0)},
    ports={
        "gauge": SignalSizes(full=6e5, timescale_s=0.5, one_sided=True),
        "piston": ForceSizes(force=120.0, travel=0.04, speed=0.1, level=4e5),
        "barrel": BarrelSizes(),
        "load_cell": SignalSizes(full=350.0, timescale_s=0.3, one_sided=True),
    },
    inside=("piston", "barrel"),
    # A common clock for pressure and force is left out: the pressure is what the rig is given, so
    # what is early there is late in the force. A zero and a gain are the preload and the area; the
    # pressure never comes near zero.
    leave_out={
        # what the gauge reads is recorded as the input: it shows its steps by itself, and the
        # force, which knows nothing of them, none
        "gauge": ("dead-zone", "gain-error", "offset", "quantisation"),
        "piston": ("gravity", "constant-offset"),
        "load_cell": ("dead-zone", "gain-error", "offset", "play"),
    },
    further=(
        nameless_fault("barrel", "piston", {"barrel": around(0.05)}),
        nameless_fault("late-gauge", "gauge", {"late_s": around(0.06)}),
        nameless_fault("bleed", "load_cell", {"bleed": between(0.2, 0.8), "bleed_s": around(8.0)}),
    ),
    maps=(0.025, 2.5e5),
    run=run,
)
