"""The joint of the blind trial: the same machine as the one-dof rig on paper, in separate
equations.

Two antagonistic 20 mm muscles, the first kept at p0 while the other is vented, pulse-driven valves,
a PD controller at 3 ms. Nothing is shared with the rig, the effects or the engine: force law,
volume, valves, air, sensors and integration are written anew, so that no model of the tool
describes the recordings exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.simulation.excitation.aprbs import aprbs
from pamid.trial.conditions import ALL, NO_FORCES, muscle_conditions
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
RADIUS = 0.030  # m, of the wheel
# m, absolute Pa
KNOWN = {"length": 0.250, "supply_pressure": 701325.0, "hold_pressure": 651325.0}
# of an angle, a contraction, a pressure and a force: SI at factor 1, and SI to column
NOISE = (float(np.radians(0.05)), 2e-4, 1e3, 3.0)
TO_COLUMN = (180.0 / np.pi, 1.0, 1e-3, 1.0)
CONTRACTION_STEP = 5e-5
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
    """Input, a value (of an arm: of each joint) per 3 ms: references in deg, or, where the loop is
    not closed, the commands themselves."""

    values: Array
    closed: bool = True


@dataclass(frozen=True)
class MuscleLayout:
    """Columns and controller of a machine of n joints with two muscles each.

    word        for it in messages
    joints      endings of the columns of each joint
    channels    columns of the readings
    seen        which reading of the kernel each of them is
    """

    word: str
    joints: tuple[str, ...]
    channels: tuple[str, ...]
    seen: tuple[int, ...]
    controller: Mapping[str, float]

    def by_channel(self, values: Sequence[float]) -> Array:
        """A value per channel from those of an angle, a contraction, a pressure and a force."""
        n = len(self.joints)
        return np.repeat(values, (n, 2 * n, 2 * n, 2 * n))[list(self.seen)]


JOINT_LAYOUT = MuscleLayout(
    "machine",
    ("",),
    ("angle_deg", "pressure_1_kpa", "pressure_2_kpa", "force_1_n", "force_2_n"),
    (0, 3, 4, 5, 6),
    JOINT_CONTROLLER,
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


def machine_record(specimen: Specimen, radius: float) -> Any:
    """The machine's constants as compiled code reads them; radius: of the wheel, m."""
    record = {
        f.name: float(getattr(specimen, f.name)) for f in fields(specimen) if f.name != "waves"
    }
    return packed(**record, **KNOWN, radius=radius)


def record(
    specimen: Specimen,
    faults: Mapping[str, Mapping[str, float]],
    excitation: Excitation,
    inertia_kg_m2: float,
    readout: Readout,
) -> dict[str, Array]:
    """Simulate the recording of this machine with these faults (name -> sizes, as `Fault.draw`
    gives them), as `record_muscles` does."""
    # compiling takes seconds: only who records pays
    from pamid.trial.arm_kernel import advance_joint

    f = planted(faults)
    f_2 = replace(f, pressure_zero_pa=0.9 * f.pressure_zero_pa)  # of the second muscle
    mechanism = advance_joint, packed(inertia=inertia_kg_m2, viscous=specimen.viscous)
    joints, acting = [(specimen, RADIUS)], (faults, (f, f_2, f, f))
    return record_muscles(JOINT_LAYOUT, mechanism, joints, acting, excitation, readout)


def record_muscles(
    layout: MuscleLayout,
    mechanism: tuple[Any, Any],
    joints: Sequence[tuple[Specimen, float]],
    faults: tuple[Iterable[str], Sequence[Planted]],
    excitation: Excitation,
    readout: Readout,
) -> dict[str, Array]:
    """Simulate the recording of a machine of n joints.

    White noise is 0.05 deg, 2e-4 contraction, 1 kPa, 3 N at factor 1. The columns of a recording
    come back in their declared units. UsageError if the machine flies apart.

    mechanism  function of `arm_kernel` that moves it, and the record of its body
    joints     constants of the muscles and valves of each joint, and the radius (m) of its wheel
    faults     their names, and what is planted in the order of `arm_kernel`
    """
    from pamid.trial.arm_kernel import READINGS, run

    (advance, body), (names, planted_at), n = mechanism, faults, len(joints)
    given = np.asarray(excitation.values, dtype=np.float64).reshape(len(excitation.values), n)
    samples = len(given)
    # it runs on after the end, for readings that are stamped early
    extended = np.concatenate([given, np.repeat(given[-1:], AHEAD, axis=0)]).T.copy()
    random, logger = np.random.default_rng(readout.seed), readout.logger
    jitter = readout.noise * layout.by_channel(NOISE)
    jitter = jitter * logger.noise(random, (samples + AHEAD, len(layout.channels)))
    readings, commands = np.zeros((samples + AHEAD, READINGS * n)), np.zeros((n, samples + AHEAD))
    # errors of all force maps; waves that a joint does not use have no amplitude
    waves = np.zeros((n, 2, max(joint.waves.shape[1] for joint, _ in joints), 3))
    for of_joint, (joint, _) in zip(waves, joints, strict=True):
        of_joint[:, : joint.waves.shape[1]] = joint.waves
    run(
        advance,
        (
            body,
            np.array([machine_record(joint, radius) for joint, radius in joints]),
            np.array([packed(**asdict(f)) for f in planted_at]),
        ),
        waves,
        (
            extended,
            excitation.closed,
            np.array(list(layout.controller.values())),
            np.degrees(jitter[:, :n]).T.copy(),
        ),
        (PERIOD_S, readout.steps or SUBSTEPS),
        (readings, commands),
    )
    if not np.isfinite(readings).all():
        raise UsageError(
            f"The {layout.word} becomes unstable with {', '.join(names) or 'no fault'}.",
            "Draw smaller sizes.",
        )
    simulated_s = np.arange(samples + AHEAD, dtype=np.float64) * PERIOD_S
    time = simulated_s[:samples]
    stamps = time + PERIOD_S * logger.delays(random, samples)
    # the logger's clock may be early and drift
    when = stamps + planted_at[-1].early_s - planted_at[-1].skew_ppm * 1e-6 * stamps
    shown = np.stack([np.interp(when, simulated_s, channel) for channel in readings.T], axis=1)
    for f, pressure in zip(planted_at, range(3 * n, 5 * n), strict=False):
        shown[:, pressure] += f.pressure_zero_pa + f.pressure_gain * shown[:, pressure]
    lot = joints[0][0]
    steps = layout.by_channel(
        [np.radians(lot.angle_step), CONTRACTION_STEP, lot.pressure_step, lot.force_step]
    )
    shown = shown[:, list(layout.seen)] + jitter[:samples]
    logged = np.floor(shown / steps + 0.5) * steps * layout.by_channel(TO_COLUMN)
    references = {f"reference{j}_deg": given[:, k] for k, j in enumerate(layout.joints)}
    return {
        "time_s": time,
        **(references if excitation.closed else {}),
        **{f"command{j}": commands[k, :samples] for k, j in enumerate(layout.joints)},
        **dict(zip(layout.channels, logged.T, strict=True)),
    }


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
        needs, u = frozenset().union(*(f.needs for f in faults)), random.random(7)
        angle_only = u[2] < 0.2 and PRESSURES not in needs
        return JointConditions(
            inertia_kg_m2=JOINT_INERTIAS[1 if HIGH_INERTIA in needs else int(u[0] * 2)],
            channels=ANGLE if angle_only else NO_FORCES if u[2] < 0.6 else ALL,
            amplitude_deg=float(32.0 + 8.0 * u[5] if WIDE_RANGE in needs else 25.0 + 15.0 * u[5]),
            **muscle_conditions(needs, u, clean),
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
        return Excitation(record({}, reference, noise)["command"], closed=False)

    def build(self, random: np.random.Generator, c: JointConditions) -> Record:
        specimen = draw_specimen(random, c.background)
        return lambda faults, signal, seed: record(
            specimen, faults, signal, c.inertia_kg_m2, Readout(c.noise, seed, c.logger)
        )


MACHINE = OneDofMachine()
