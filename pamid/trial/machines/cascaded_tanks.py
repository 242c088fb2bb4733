"""Two tanks, stacked, filled by a pump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.numba_cache import njit
from pamid.trial.faults import around, between, known_fault, nameless_fault
from pamid.trial.starter_faults import NEVER, SignalSizes
from pamid.trial.starter_kernel import rough
from pamid.trial.starter_machine import LoggedColumn, SentLevels, StarterMachine

GRAVITY = 9.81
START_M = 0.05
SHALLOW_M = 1e-4  # below it the outflow dies away with the level


@dataclass(frozen=True)
class TankSizes:
    """Sizes of the faults at a tank.

    crack: m2, a hole in the wall at its bottom, whose flow is lost; seep: m2/s, lost in proportion
    to the level; rim: m, height from which it spills; weir: m1.5/s, its width as a weir; caught:
    share of what spills that falls into the other tank; tapered: relative growth of the area by
    0.1 m of level; clogging: share of the hole's area lost in the end
    """

    crack: float = 0.0
    seep: float = 0.0
    rim: float = NEVER
    weir: float = 0.0
    caught: float = 0.0
    tapered: float = 0.0
    clogging: float = 0.0
    clogging_s: float = 1.0


@dataclass(frozen=True)
class PipeSizes:
    """Between the tanks. fall_s: time that water is under way, spread over a filter of second
    order; swirl: twice the share of the flow lost at a level of
    0.2 m."""

    fall_s: float = 0.0
    swirl: float = 0.0


@njit
def lost(level: float, f: Any) -> tuple[float, float]:
    """Flow through cracks and pores, and over the rim, m3/s."""
    above = max(level, 0.0)
    seeped = f.crack * np.sqrt(2.0 * GRAVITY) * above / np.sqrt(above + SHALLOW_M)
    return seeped + f.seep * above, f.weir * max(level - f.rim, 0.0) ** 1.5


@njit
def run(u: Array, m: Any, f: tuple[Any, ...], maps: tuple[Array, ...], h: float, y: Array) -> None:
    """Levels of the lower and of the upper tank."""
    upper, lower, pipe = f
    high = low = START_M
    through, change = 0.0, 0.0
    for k in range(u.shape[0]):
        y[k, 0], y[k, 1] = low, high
        filling = m.gain * (1.0 + rough(maps[0], u[k, 0] - 2.5)) * u[k, 0]
        above, below = max(high, 0.0), max(low, 0.0)
        hole_1 = m.upper_hole * (1.0 + rough(maps[1], above - 0.1))
        hole_1 *= 1.0 - upper.clogging * (1.0 - np.exp(-k * h / upper.clogging_s))
        hole_1 *= 1.0 - pipe.swirl * above * above / (above * above + 0.04)
        hole_2 = m.lower_hole * (1.0 + rough(maps[1], below - 0.1))
        hole_2 *= 1.0 - lower.clogging * (1.0 - np.exp(-k * h / lower.clogging_s))
        out = hole_1 * np.sqrt(2.0 * GRAVITY) * above / np.sqrt(above + SHALLOW_M)
        out_low = hole_2 * np.sqrt(2.0 * GRAVITY) * below / np.sqrt(below + SHALLOW_M)
        arriving = out
        if pipe.fall_s > 0.0:
            corner = 1.4 / pipe.fall_s
            change += h * corner * (corner * (out - through) - 1.4 * change)
            through += h * change
            arriving = through
        seeped_1, spilt_1 = lost(high, upper)
        seeped_2, spilt_2 = lost(low, lower)
        high += (
            h
            * (filling - out - seeped_1 - spilt_1)
            / (m.upper_area * (1.0 + upper.tapered * (above - START_M) / 0.1))
        )
        low += (
            h
            * (arriving + upper.caught * spilt_1 - out_low - seeped_2 - spilt_2)
            / (m.lower_area * (1.0 + lower.tapered * (below - START_M) / 0.1))
        )


RIM = between(0.09, 0.13)
WEIR = around(1.5e-3)

MACHINE = StarterMachine(
    name="cascaded-tanks",
    period_s=2.0,
    seconds=3000.0,
    steps=40,
    sent={"pump_v": SentLevels(0.0, 5.0, (15.0, 150.0))},
    logged=("level_cm", "upper_level_cm"),
    log={
        "pump_v": LoggedColumn(port="pump"),
        "level_cm": LoggedColumn(1e2, noise=0.05, steps=(0.01, 0.05), port="gauge"),
        "upper_level_cm": LoggedColumn(1e2, noise=0.05, steps=(0.01, 0.05), port="upper_gauge"),
    },
    parameters={
        "gain": around(1e-5, 1.0 / 1.2, 1.2),
        "upper_area": around(5e-3, 1.0 / 1.1, 1.1),
        "lower_area": around(5e-3, 1.0 / 1.1, 1.1),
        "upper_hole": around(2e-5, 1.0 / 1.15, 1.15),
        "lower_hole": around(2e-5, 1.0 / 1.15, 1.15),
    },
    ports={
        "pump": SignalSizes(full=5.0, timescale_s=40.0, one_sided=True),
        "upper": TankSizes(),
        "lower": TankSizes(),
        "pipe": PipeSizes(),
        "gauge": SignalSizes(full=0.2, timescale_s=40.0, one_sided=True),
        "upper_gauge": SignalSizes(full=0.2, timescale_s=40.0, one_sided=True),
    },
    inside=("upper", "lower", "pipe"),
    commands=("pump",),
    clock="gauge",
    leave_out={
        "pump": ("gain-error",),
        # a gain of a level equals a gain of areas and holes
        "gauge": ("dead-zone", "gain-error"),
        "upper_gauge": ("dead-zone", "gain-error"),
    },
    further=(
        known_fault("tube-lag", "tube-lag", "pipe", {"fall_s": around(8.0)}),
        # at the lower tank it is a wider hole
        known_fault("leak", "leak", "upper", {"crack": around(2e-6)}, also=("orifice-loss",)),
        known_fault("first-order-loss", "leak", "upper", {"seep": around(4e-5)}),
        known_fault("first-order-loss", "leak", "lower", {"seep": around(4e-5)}),
        known_fault("overflow", "overflow", "upper", {"weir": WEIR, "rim": RIM}),
        known_fault("overflow", "overflow", "lower", {"weir": WEIR, "rim": RIM}),
        known_fault(
            "overflow-into-store",
            "overflow",
            "upper",
            {"weir": WEIR, "rim": RIM, "caught": between(0.5, 0.9)},
        ),
        nameless_fault("tapered-wall", "lower", {"tapered": around(0.15, 0.6, 2.0)}),
        nameless_fault("swirl", "pipe", {"swirl": around(0.25)}),
        nameless_fault(
            "clogging", "lower", {"clogging": around(0.12), "clogging_s": between(500.0, 1500.0)}
        ),
    ),
    maps=(2.5, 0.1),
    run=run,
    without=("upper_level_cm",),
)
