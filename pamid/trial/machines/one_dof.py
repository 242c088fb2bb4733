"""The joint of the blind trial: the same machine as the one-dof rig on paper, in equations of its
separate equations.

Two antagonistic 20 mm muscles, the first kept at p0 while the other is vented, pulse-driven valves,
a PD controller at 3 ms. Nothing is shared with the rig, the effects or the engine: force law,
volume, valves, air, sensors and integration are written anew, so that no model of the tool
describes the recordings exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.simulation.excitation.aprbs import aprbs
from pamid.trial.conditions import ALL, NO_FORCES, Draws
from pamid.trial.faults import FAULTS, HIGH_INERTIA, PRESSURES, WIDE_RANGE, Fault, Planted, planted
from pamid.trial.logger import PLAIN_LOGGER, Logger, Readout
from pamid.trial.machine import AHEAD, ONE_DOF, Record, packed

PERIOD_S = 0.003
JOINT_CONTROLLER = {
    "kp_per_deg": 0.10,
    "kd_s_per_deg": 0.003,
    "derivative_filter_s": 0.006,
    "command_limit": 1.0,
}
# m, absolute Pa
KNOWN = {"radius": 0.030, "length": 0.250, "supply_pressure": 701325.0, "hold_pressure": 651325.0}
JOINT_CHANNELS = ("angle_deg", "pressure_1_kpa", "pressure_2_kpa", "force_1_n", "force_2_n")
JOINT_NOISE = np.array([np.radians(0.05), 1e3, 1e3, 3.0, 3.0])  # SI, at factor 1
JOINT_TO_COLUMN = np.array([180.0 / np.pi, 1e-3, 1e-3, 1.0, 1.0])
PRESSURES_KPA = {"supply_pressure_kpa": 600.0, "initial_pressure_kpa": 550.0}
SUBSTEPS = 30  # per sample
JOINT_INERTIAS = (0.014, 0.0896)  # kg m2: the arm of the first paper, and 6.4 times it
ANGLE = "angle"  # channels
STROKE, LOW_PA, HIGH_PA = 0.20, 1e5, 6e5  # over which the error of the force map has its size


@dataclass(frozen=True)
class JointConditions:
    """Conditions of a recording of a joint. loop: "closed" | "open"; channels: "all" |
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


@dataclass(frozen=True, eq=False)
class Specimen:
    """True constants of a machine, SI unless stated otherwise.

    waves: error of the force map, shape (2 muscles, 1 + waves, 3): relative amplitude, angular wave
    number and phase of cosines; the first runs over gauge pressure, the others over contraction.
    """

    law: float  # 0: threads and rubber, 1: quadratic through the chart
    rubber: float  # stiffness of the rubber, 1: as in the chart
    scale: float  # force against the chart
    damping: float  # m2 s, force per contraction rate and absolute pressure
    fill_1: float  # sonic conductances, m3/(s Pa)
    fill_2: float
    vent_1: float
    vent_2: float
    critical_ratio: float
    viscous: float  # N m s
    contraction_0: float  # both muscles, arm in the middle
    dead_volume: float  # m3 per muscle
    polytropic: float
    bore: float  # m
    braid_angle: float  # rad from the axis, at rest
    pulses_per_sample: float  # of the valves' drive: 1 to 3, 333 to 1000 Hz
    filter_lag: float  # s, group delay of the second-order filters of all readings
    angle_step: float  # deg
    pressure_step: float  # Pa
    force_step: float  # N
    drift_1: float  # share of force gained over a recording
    drift_2: float
    waves: Array = field(repr=False)


@dataclass(frozen=True, eq=False)
class Excitation:
    """Input, a value per 3 ms: a reference (the loop is closed) or the command itself."""

    reference_deg: Array | None = None
    command: Array | None = None

    def __post_init__(self) -> None:
        if (self.reference_deg is None) == (self.command is None):
            raise UsageError(
                "An excitation is a reference or a command.", "Give either of the two."
            )


def draw_specimen(random: np.random.Generator, background: float) -> Specimen:
    """A machine within about a tolerance of its data sheet; background: rms error of its force
    map (0 .. 0.04)."""

    def even(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    def times(middle: float, factor: float) -> float:
        return middle * factor ** even(-1.0, 1.0)

    part = background / 0.04
    c_in, c_out = times(3.777e-9, 1.15), times(3.777e-9, 1.15)
    uneven = [1.0 + 0.03 * part * even(-1.0, 1.0) for _ in range(4)]
    return Specimen(
        law=float(random.integers(2)),
        rubber=1.0 + float(random.choice((-1.0, 1.0))) * even(0.07, 0.12),
        scale=even(0.85, 1.15),
        damping=times(6e-4, 1.8),
        fill_1=c_in * uneven[0],
        fill_2=c_in * uneven[1],
        vent_1=c_out * uneven[2],
        vent_2=c_out * uneven[3],
        critical_ratio=even(0.35, 0.51),
        viscous=even(0.01, 0.10),
        contraction_0=even(0.096, 0.104),
        dead_volume=even(2e-6, 9e-6),
        polytropic=even(1.0, 1.2),
        bore=0.020,
        braid_angle=math.radians(even(28.1, 29.1)),
        pulses_per_sample=float(random.integers(1, 4)),
        filter_lag=even(2e-4, 4e-4),
        angle_step=even(0.005, 0.02),
        pressure_step=1e6 / 2.0 ** int(random.integers(12, 17)),
        force_step=2e3 / 2.0 ** int(random.integers(12, 17)),
        drift_1=0.5 * background * even(-1.0, 1.0),
        drift_2=0.5 * background * even(-1.0, 1.0),
        waves=draw_waves(random, background),
    )


def draw_waves(random: np.random.Generator, rms: float) -> Array:
    """Force-map errors of both muscles: 1 to 6 half waves of stroke, a slow one of pressure."""
    count = int(random.integers(1, 7))
    waves = np.zeros((2, count + 1, 3))
    chi, pressure = np.meshgrid(np.linspace(0.0, STROKE, 101), np.linspace(LOW_PA, HIGH_PA, 51))
    for muscle in waves:
        muscle[:, 2] = random.uniform(0.0, 2.0 * np.pi, count + 1)
        muscle[0, :2] = 0.4, np.pi * random.uniform(0.5, 1.5) / HIGH_PA
        muscle[1:, 0] = random.uniform(0.5, 1.0, count) / np.arange(1, count + 1)
        muscle[1:, 1] = np.pi * np.arange(1, count + 1) / STROKE
        error = sum(
            a * np.cos(k * (pressure if i == 0 else chi) + c) for i, (a, k, c) in enumerate(muscle)
        )
        muscle[:, 0] *= rms / np.sqrt(np.mean(np.square(error)))
    return waves


def machine_record(
    specimen: Specimen, inertia_kg_m2: float, known: Mapping[str, float] = KNOWN
) -> Any:
    """The machine's constants as compiled code reads them."""
    record = {
        f.name: float(getattr(specimen, f.name)) for f in fields(specimen) if f.name != "waves"
    }
    return packed(**record, **known, inertia=inertia_kg_m2)


def record(
    specimen: Specimen,
    faults: Mapping[str, Mapping[str, float]],
    excitation: Excitation,
    inertia_kg_m2: float,
    readout: Readout,
) -> dict[str, Array]:
    """Simulate the recording of this machine with these faults (name -> sizes, as `Fault.draw`
    gives them).

    White noise is 0.05 deg, 1 kPa, 3 N at factor 1. The columns of a recording come back in their
    declared units. UsageError if the machine flies apart.
    """
    from pamid.trial.joint_kernel import run  # compiling takes seconds: only who records pays

    f = planted(faults)
    closed = excitation.reference_deg is not None
    reference = np.asarray(
        excitation.reference_deg if closed else excitation.command, dtype=np.float64
    )
    n = len(reference)
    extended = np.concatenate([reference, np.full(AHEAD, reference[-1])])
    random, logger = np.random.default_rng(readout.seed), readout.logger
    jitter = readout.noise * JOINT_NOISE * logger.noise(random, (n + AHEAD, len(JOINT_CHANNELS)))
    readings, commands = np.zeros((n + AHEAD, len(JOINT_CHANNELS))), np.zeros(n + AHEAD)
    run(
        machine_record(specimen, inertia_kg_m2),
        packed(**asdict(f)),
        specimen.waves,
        (extended, closed, np.array(list(JOINT_CONTROLLER.values())), np.degrees(jitter[:, 0])),
        (PERIOD_S, readout.steps or SUBSTEPS),
        (readings, commands),
    )
    if not np.isfinite(readings).all():
        raise UsageError(
            f"The machine becomes unstable with {', '.join(faults) or 'no fault'}.",
            "Draw smaller sizes.",
        )
    time = np.arange(n, dtype=np.float64) * PERIOD_S
    stamps = time + PERIOD_S * logger.delays(random, n)
    logged = _logged(specimen, f, readings, jitter[:n], stamps)
    references = {"reference_deg": reference} if closed else {}
    return {
        "time_s": time,
        **references,
        "command": commands[:n],
        **{name: logged[:, i] for i, name in enumerate(JOINT_CHANNELS)},
    }


def stamped(f: Planted, readings: Array, time: Array) -> Array:
    """Readings at the times of the logger, a copy; its clock may be early and drift."""
    when = time + f.early_s - f.skew_ppm * 1e-6 * time
    stamps = np.arange(len(readings), dtype=np.float64) * PERIOD_S
    return np.stack([np.interp(when, stamps, channel) for channel in readings.T], axis=1)


def _logged(specimen: Specimen, f: Planted, readings: Array, jitter: Array, time: Array) -> Array:
    """Readings (SI, running on past the end) as the logger writes them: shifted clock, sensor
    errors, noise, steps."""
    shown = stamped(f, readings, time)
    for column, share in ((1, 1.0), (2, 0.9)):
        shown[:, column] += share * f.pressure_zero_pa + f.pressure_gain * shown[:, column]
    steps = np.array(
        [
            np.radians(specimen.angle_step),
            *2 * (specimen.pressure_step,),
            *2 * (specimen.force_step,),
        ]
    )
    return np.asarray(np.floor((shown + jitter) / steps + 0.5) * steps * JOINT_TO_COLUMN)


class OneDofMachine:
    """A joint with two muscles; see `pamid.trial.machine.Machine`."""

    name: ClassVar[str] = ONE_DOF
    period_s: ClassVar[float] = PERIOD_S
    faults: ClassVar[Mapping[str, Fault]] = FAULTS
    controller: ClassVar[Mapping[str, float]] = JOINT_CONTROLLER
    withheld_columns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        ALL: (),
        NO_FORCES: ("force_",),
        ANGLE: ("force_", "pressure_"),
    }

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> JointConditions:
        """Draw the conditions, then restrict them to those in which the faults can show."""
        d, u = Draws(faults), random.random(7)
        angle_only = u[2] < 0.2 and PRESSURES not in d.needs
        return JointConditions(
            inertia_kg_m2=JOINT_INERTIAS[1 if HIGH_INERTIA in d.needs else int(u[0] * 2)],
            loop=d.loop(u[1]),
            channels=ANGLE if angle_only else NO_FORCES if u[2] < 0.6 else ALL,
            noise=d.noise(u[3]),
            background=d.background(u[4], clean),
            seconds=d.seconds,
            amplitude_deg=float(32.0 + 8.0 * u[5] if WIDE_RANGE in d.needs else 25.0 + 15.0 * u[5]),
            hold_s=d.holds(u[6]),
        )

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        return fault, FAULTS[fault].draw(random)

    def truth(self, site: str) -> dict[str, Any]:
        return FAULTS[site].truth

    def known(self, c: JointConditions) -> dict[str, float]:
        return {"inertia_kg_m2": c.inertia_kg_m2, **PRESSURES_KPA}

    def excitation(self, c: JointConditions, record: Record, seed: int, noise: int) -> Excitation:
        reference = Excitation(aprbs(c.seconds, PERIOD_S, c.amplitude_deg, c.hold_s, seed=seed))
        if c.loop == "closed":
            return reference
        return Excitation(command=record({}, reference, noise)["command"])

    def build(self, random: np.random.Generator, c: JointConditions) -> Record:
        specimen = draw_specimen(random, c.background)
        return lambda faults, signal, seed: record(
            specimen, faults, signal, c.inertia_kg_m2, Readout(c.noise, seed, c.logger)
        )


MACHINE = OneDofMachine()
