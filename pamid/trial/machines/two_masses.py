"""Two carriages on a rail, joined by a spring, the first driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, nameless_fault
from pamid.trial.starter_faults import ForceSizes, SignalSizes
from pamid.trial.starter_kernel import FORCE_MEMORY, arrested, resisted, rough
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine


@dataclass(frozen=True)
class RailSizes:
    """Sizes of faults at this rig that no catalogue contains.

    slack: half gap of the coupling, m; bent_damping: N s/m, of a rail that is tight in places, on
    the first carriage; yielding, yielding_s: share by which the first carriage's spring gives in
    the end, and how soon
    """

    slack: float = 0.0
    bent_damping: float = 0.0
    yielding: float = 0.0
    yielding_s: float = 1.0


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Both positions; speeds first, then positions."""
    spring, first, second, rail = f
    z = np.zeros((3, FORCE_MEMORY))
    x_1 = v_1 = x_2 = v_2 = given = 0.0
    for k in range(u.shape[0]):
        y[k, 0], y[k, 1] = x_1, x_2
        stretch, rate = x_2 - x_1, v_2 - v_1
        free = stretch - min(max(stretch, -rail.slack), rail.slack)
        pull = -m.stiffness * (1.0 + rough(maps[1], stretch)) * free
        if free != 0.0 or rail.slack == 0.0:
            pull -= m.coupling_damping * rate
        pull -= resisted(stretch, rate, (0.0, 0.0), z[0], spring, k * h, h)
        held = m.frame_stiffness * (1.0 + rough(maps[0], x_1))
        given += h / rail.yielding_s * (rail.yielding * x_1 - given)
        tight = m.viscous_1 + rail.bent_damping * np.sin(25.0 * x_1 + 0.5) ** 2
        push_1 = u[k, 0] - held * (x_1 - given) - tight * v_1 - pull
        push_1 -= resisted(x_1, v_1, (0.0, 0.0), z[1], first, k * h, h)
        push_2 = pull - m.viscous_2 * v_2
        push_2 -= resisted(x_2, v_2, (0.0, 0.0), z[2], second, k * h, h)
        v_1 = arrested(v_1 + h * push_1 / m.mass_1, v_1, first, h, m.mass_1)
        v_2 = arrested(v_2 + h * push_2 / m.mass_2, v_2, second, h, m.mass_2)
        x_1 += h * v_1
        x_2 += h * v_2


MACHINE = StarterMachine(
    name="two-masses",
    period_s=0.005,
    seconds=20.0,
    steps=40,
    sent={"force_n": SentLevels(-15.0, 15.0, (0.1, 1.0))},
    logged=("position_1_mm", "position_2_mm"),
    log={
        "force_n": LoggedColumn(port="drive"),
        "position_1_mm": LoggedColumn(1e3, noise=0.05, steps=(0.01, 0.05), port="ruler_1"),
        "position_2_mm": LoggedColumn(1e3, noise=0.05, steps=(0.01, 0.05), port="ruler_2"),
    },
    parameters={
        "mass_1": around(2.0, 1.0 / 1.15, 1.15),
        "mass_2": around(1.5, 1.0 / 1.15, 1.15),
        "stiffness": around(800.0, 1.0 / 1.2, 1.2),
        "frame_stiffness": between(150.0, 260.0),
        "coupling_damping": between(1.0, 3.5),
        "viscous_1": between(2.5, 8.0),
        "viscous_2": between(1.5, 5.0),
    },
    ports={
        "drive": SignalSizes(full=15.0, timescale_s=0.15),
        "spring": ForceSizes(force=8.0, travel=0.03, speed=0.2),
        "carriage_1": ForceSizes(force=12.0, travel=0.3, speed=0.8),
        "carriage_2": ForceSizes(force=12.0, travel=0.3, speed=0.8),
        "ruler_1": SignalSizes(full=0.15, timescale_s=0.15),
        "ruler_2": SignalSizes(full=0.15, timescale_s=0.15),
        "rail": RailSizes(),
    },
    inside=("spring", "carriage_1", "carriage_2", "rail"),
    commands=("drive",),
    clock="ruler",
    leave_out={
        "drive": ("gain-error", "full-wave-rectification"),
        # between two masses nothing has a weight or a stick; stiffness and damping are
        # the rig's parameters
        "spring": ("gravity", "stribeck-friction", "viscous-friction", "linear-stiffness"),
        "carriage_1": ("gravity", "viscous-friction", "linear-stiffness"),
        "carriage_2": ("gravity", "viscous-friction"),
        # a ruler counts both ways
        "ruler_1": ("rectification", "full-wave-rectification"),
        "ruler_2": ("rectification", "full-wave-rectification"),
    },
    twins={"constant-offset@carriage_1": "offset", "offset@drive": "constant-offset"},
    further=(
        # play of a coupling is in the catalogue, but this rig offers it no stretch there
        nameless_fault("slack-coupling", "coupling", {"slack": around(0.002)}),
        nameless_fault("tight-rail", "carriage_1", {"bent_damping": around(15.0)}),
        nameless_fault(
            "yielding-frame",
            "carriage_1",
            {"yielding": between(0.15, 0.35), "yielding_s": between(0.5, 2.0)},
        ),
    ),
    maps=(0.17, 0.02),
    run=run,
    without=("position_2_mm", "position_1_mm"),
)
