"""Under which conditions the cases of the trial are recorded."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from pamid.base.arrays import Array
from pamid.trial.faults import LONG_HOLDS
from pamid.trial.logger import PLAIN_LOGGER, Logger

HOLDS, SLOW_HOLD = ((0.4, 1.6), (0.8, 3.0)), (3.0, 12.0)  # s
BACKGROUND = (0.005, 0.04)  # log-uniform
SECONDS = 40.0
ALL, NO_FORCES = "all", "no-forces"  # channels


class Conditions(Protocol):
    """How a case is recorded: a frozen dataclass. loop: "closed" | "open"; noise: factor on the
    sensors' usual noise; background: size of effects that no model of the tool can represent."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def loop(self) -> str: ...
    @property
    def channels(self) -> str: ...
    @property
    def noise(self) -> float: ...
    @property
    def background(self) -> float: ...
    @property
    def seconds(self) -> float: ...
    @property
    def logger(self) -> Logger: ...


@dataclass(frozen=True)
class StarterConditions:
    """Conditions of a recording of a starter rig's machine, always in open loop, or of a machine
    built from a rig. channels: "all", or the omitted column; amplitude: share of the usual range of
    the input."""

    loop: str
    channels: str
    noise: float
    background: float
    seconds: float
    amplitude: float
    logger: Logger = PLAIN_LOGGER


def muscle_conditions(needs: Set[str], u: Array, clean: bool) -> dict[str, Any]:
    """Common conditions of a joint and of an arm, drawn by numbers u that are even between 0 and 1.
    needs: what a recording must have to show the faults."""
    return {
        "loop": "open" if u[1] < 0.25 else "closed",
        "noise": noise_factor(u[3]),
        "background": background_size(u[4], clean),
        "seconds": 2.0 * SECONDS if LONG_HOLDS in needs else SECONDS,
        "hold_s": SLOW_HOLD if LONG_HOLDS in needs else HOLDS[int(u[6] * 2)],
    }


def noise_factor(u: float) -> float:
    return 5.0 if u < 0.15 else 1.0


def background_size(u: float, clean: bool) -> float:
    low, high = BACKGROUND
    return 0.0 if clean else float(low * (high / low) ** u)


def draw_starter_conditions(
    random: np.random.Generator, channels: Sequence[str], seconds: float, clean: bool
) -> StarterConditions:
    """channels: those that a case may have, all of them first, which half of the cases have."""
    u = random.random(4)
    rest = channels[1:]
    return StarterConditions(
        loop="open",
        channels=channels[0]
        if u[0] < 0.5 or not rest
        else rest[int((2.0 * u[0] - 1.0) * len(rest))],
        noise=noise_factor(u[1]),
        background=background_size(u[2], clean),
        seconds=seconds,
        amplitude=float(0.8 + 0.4 * u[3]),
    )
