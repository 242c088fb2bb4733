"""Under which conditions the cases of the trial are recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pamid.trial.faults import HIGH_INERTIA, LONG_HOLDS, PRESSURES, WIDE_RANGE, Fault
from pamid.trial.logger import PLAIN_LOGGER, Logger

JOINT_INERTIAS = (0.014, 0.0896)  # kg m2: the arm of the first paper, and 6.4 times it
PAYLOADS = (0.0, 0.5)  # kg at the tip of the arm
HOLDS, SLOW_HOLD = ((0.4, 1.6), (0.8, 3.0)), (3.0, 12.0)  # s
BACKGROUND = (0.005, 0.04)  # log-uniform
SECONDS = 40.0
ALL, NO_FORCES, ANGLE, ANGLES_AND_PRESSURES = "all", "no-forces", "angle", "angles-and-pressures"


@dataclass(frozen=True)
class JointConditions:
    """Conditions of a recording of one joint. loop: "closed" | "open"; channels: "all" |
    "no-forces" | "angle"; noise: factor on the sensors' usual noise; background: size of effects
    that no model of the tool can represent; amplitude in deg, holds in s."""

    inertia_kg_m2: float
    loop: str
    channels: str
    noise: float
    background: float
    seconds: float
    amplitude_deg: float
    hold_s: tuple[float, float]
    logger: Logger = PLAIN_LOGGER


@dataclass(frozen=True)
class ArmConditions:
    """How a case of the arm is recorded: as one of a joint, with a payload and an amplitude for
    each joint; channels: "all" | "no-forces" | "angles-and-pressures"."""

    payload_kg: float
    loop: str
    channels: str
    noise: float
    background: float
    seconds: float
    amplitude_1_deg: float
    amplitude_2_deg: float
    hold_s: tuple[float, float]
    logger: Logger = PLAIN_LOGGER


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


Conditions = JointConditions | ArmConditions | StarterConditions


def draw_joint_conditions(
    random: np.random.Generator, faults: Sequence[Fault], clean: bool
) -> JointConditions:
    """Draw the conditions, then restrict them to those in which the faults can show."""
    needs, u = _needs(faults), random.random(7)
    angle_only = u[2] < 0.2 and PRESSURES not in needs
    return JointConditions(
        inertia_kg_m2=JOINT_INERTIAS[1] if HIGH_INERTIA in needs else JOINT_INERTIAS[int(u[0] * 2)],
        loop=_loop(u[1]),
        channels=ANGLE if angle_only else NO_FORCES if u[2] < 0.6 else ALL,
        noise=_noise(u[3]),
        background=_background(u[4], clean),
        seconds=_seconds(needs),
        amplitude_deg=float(32.0 + 8.0 * u[5] if WIDE_RANGE in needs else 25.0 + 15.0 * u[5]),
        hold_s=_holds(u[6], needs),
    )


def draw_arm_conditions(
    random: np.random.Generator, faults: Sequence[Fault], clean: bool
) -> ArmConditions:
    """Draw the conditions, then restrict them to those in which the faults can show."""
    needs, u = _needs(faults), random.random(8)
    wide = WIDE_RANGE in needs
    return ArmConditions(
        payload_kg=PAYLOADS[1] if HIGH_INERTIA in needs else PAYLOADS[int(u[0] * 2)],
        loop=_loop(u[1]),
        channels=ANGLES_AND_PRESSURES if u[2] < 0.2 else NO_FORCES if u[2] < 0.6 else ALL,
        noise=_noise(u[3]),
        background=_background(u[4], clean),
        seconds=_seconds(needs),
        amplitude_1_deg=float(25.0 + 5.0 * u[5] if wide else 15.0 + 15.0 * u[5]),
        amplitude_2_deg=float(34.0 + 6.0 * u[7] if wide else 20.0 + 20.0 * u[7]),
        hold_s=_holds(u[6], needs),
    )


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
        noise=_noise(u[1]),
        background=_background(u[2], clean),
        seconds=seconds,
        amplitude=float(0.8 + 0.4 * u[3]),
    )


def _needs(faults: Sequence[Fault]) -> frozenset[str]:
    return frozenset().union(*(f.needs for f in faults))


def _loop(u: float) -> str:
    return "open" if u < 0.25 else "closed"


def _noise(u: float) -> float:
    return 5.0 if u < 0.15 else 1.0


def _background(u: float, clean: bool) -> float:
    low, high = BACKGROUND
    return 0.0 if clean else float(low * (high / low) ** u)


def _seconds(needs: frozenset[str]) -> float:
    return 2.0 * SECONDS if LONG_HOLDS in needs else SECONDS


def _holds(u: float, needs: frozenset[str]) -> tuple[float, float]:
    return SLOW_HOLD if LONG_HOLDS in needs else HOLDS[int(u * 2)]
