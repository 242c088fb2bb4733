"""The arm of the blind trial: the same machine as the two-link rig on paper, in separate equations.

Two links in a vertical plane, two antagonistic 20 mm muscles at each joint, four pulse-driven valve
pairs on a common supply, a PD controller at each joint. Muscles, valves and air are those of the
joint; links and their coupling stand in `arm_kernel`. Angle 1 is counted from hanging straight
down, angle 2 from link 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.simulation.excitation.aprbs import aprbs
from pamid.trial.arm_faults import (
    ARM_FAULTS,
    JOINTS,
    MUSCLES,
    draw_site,
    draw_sizes,
    placed,
    truth_of,
)
from pamid.trial.conditions import ALL, NO_FORCES, muscle_conditions
from pamid.trial.faults import HIGH_INERTIA, WIDE_RANGE, Fault
from pamid.trial.logger import PLAIN_LOGGER, Logger, Readout
from pamid.trial.machine import TWO_LINK, Record, packed
from pamid.trial.machines.one_dof import (
    JOINT_CONTROLLER,
    PERIOD_S,
    PRESSURES_KPA,
    Excitation,
    MuscleLayout,
    Specimen,
    draw_specimen,
    record_muscles,
)

# gentler than the joint's: with that controller the arm, ten times as heavy, never comes to rest
ARM_CONTROLLER = {**JOINT_CONTROLLER, "kp_per_deg": 0.03}
RADII = (0.035, 0.025)  # m
LENGTH_1, LENGTH_2 = 0.40, 0.30  # m
GRAVITY = 9.81  # m/s2
TRUE_ARM = {
    "mass_1": 2.2,
    "centre_1": 0.20,
    "inertia_1": 0.040,
    "mass_2": 0.70,
    "centre_2": 0.13,
    "inertia_2": 0.0075,
}
# estimate: weighed and drawn without all that is on it
OFF_SHEET = {"mass": 0.15, "centre": 0.10, "inertia": 0.25}
VISCOUS = (0.10, 0.05)  # N m s, on the sheet
ARM_LAYOUT = MuscleLayout(
    "arm",
    tuple(f"_{j}" for j in JOINTS),
    (
        *(f"angle_{j}_deg" for j in JOINTS),
        *(f"contraction_{i}" for i in MUSCLES),
        *(f"pressure_{i}_kpa" for i in MUSCLES),
        *(f"force_{i}_n" for i in MUSCLES),
    ),
    tuple(range(14)),
    ARM_CONTROLLER,
)
# joints against each other; friction against its sheet, a factor
SCALE_APART, VISCOUS_APART = 0.02, 2.0
PAYLOADS = (0.0, 0.5)  # kg at the tip
ANGLES_AND_PRESSURES = "angles-and-pressures"  # channels


@dataclass(frozen=True)
class ArmConditions:
    """How a case of the arm is recorded: as a case of a joint, with a payload and an amplitude for
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


@dataclass(frozen=True, eq=False)
class ArmSpecimen:
    """True constants of an arm. joints: the muscles and valves of each; links: as in TRUE_ARM, SI;
    viscous: N m s."""

    joints: tuple[Specimen, Specimen]
    links: Mapping[str, float]
    viscous: tuple[float, float]

    def body(self, payload_kg: float) -> Any:
        """Link properties in the equations of motion, with a payload at the tip, as compiled code
        reads them; SI.

        inertia_1: of link 1 about its joint, with all of link 2 at the elbow; inertia_2: of link 2
        about the elbow; coupling, weight_1, weight_2: factors of the cosine of the bend and of the
        sines of both angles against the vertical
        """
        links = self.links
        moment = links["mass_2"] * links["centre_2"] + payload_kg * LENGTH_2
        beyond = links["mass_2"] + payload_kg
        return packed(
            inertia_1=links["inertia_1"]
            + links["mass_1"] * links["centre_1"] ** 2
            + beyond * LENGTH_1**2,
            inertia_2=links["inertia_2"]
            + links["mass_2"] * links["centre_2"] ** 2
            + payload_kg * LENGTH_2**2,
            coupling=moment * LENGTH_1,
            weight_1=GRAVITY * (links["mass_1"] * links["centre_1"] + beyond * LENGTH_1),
            weight_2=GRAVITY * moment,
            viscous_1=self.viscous[0],
            viscous_2=self.viscous[1],
        )


def draw_arm(random: np.random.Generator, background: float) -> ArmSpecimen:
    """An arm within about a tolerance of its data sheet; background: rms error of its force maps
    (0 .. 0.04).

    Muscles and valves of both joints come from the same lot: what is not of the single piece is the
    same in all.
    """
    first, other = draw_specimen(random, background), draw_specimen(random, background)
    part = background / 0.04
    uneven = {
        name: 1.0 + 0.03 * part * float(random.uniform(-1.0, 1.0))
        for name in ("fill_1", "fill_2", "vent_1", "vent_2")
    }
    second = replace(
        first,
        **{name: getattr(first, name) * factor for name, factor in uneven.items()},
        scale=first.scale * (1.0 + SCALE_APART * part * float(random.uniform(-1.0, 1.0))),
        drift_1=other.drift_1,
        drift_2=other.drift_2,
        waves=other.waves,
    )
    links = {
        name: value * (1.0 + OFF_SHEET[name.partition("_")[0]] * float(random.uniform(-1.0, 1.0)))
        for name, value in TRUE_ARM.items()
    }
    viscous = [value * VISCOUS_APART ** float(random.uniform(-1.0, 1.0)) for value in VISCOUS]
    return ArmSpecimen((first, second), links, (viscous[0], viscous[1]))


def record_arm(
    arm: ArmSpecimen,
    faults: Mapping[str, Mapping[str, float]],
    excitation: Excitation,
    payload_kg: float,
    readout: Readout,
) -> dict[str, Array]:
    """Simulate the recording of this arm with these faults (fault@place -> sizes), on references or
    commands of shape (samples, 2), as `record_muscles` does."""
    # compiling takes seconds: only who records pays
    from pamid.trial.arm_kernel import advance_arm

    mechanism = advance_arm, arm.body(payload_kg)
    joints = list(zip(arm.joints, RADII, strict=True))
    acting = faults, placed(faults)
    return record_muscles(ARM_LAYOUT, mechanism, joints, acting, excitation, readout)


class TwoLinkMachine:
    """An arm of two joints with four muscles; see `pamid.trial.machine.Machine`."""

    name: ClassVar[str] = TWO_LINK
    period_s: ClassVar[float] = PERIOD_S
    faults: ClassVar[Mapping[str, Fault]] = ARM_FAULTS
    controller: ClassVar[Mapping[str, float]] = ARM_CONTROLLER
    withheld_columns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        ALL: (),
        NO_FORCES: ("force_",),
        ANGLES_AND_PRESSURES: ("force_", "contraction_"),
    }

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> ArmConditions:
        """Draw the conditions, then restrict them to those in which the faults can show."""
        needs, u = frozenset().union(*(f.needs for f in faults)), random.random(8)
        wide = WIDE_RANGE in needs
        return ArmConditions(
            payload_kg=PAYLOADS[1] if HIGH_INERTIA in needs else PAYLOADS[int(u[0] * 2)],
            channels=ANGLES_AND_PRESSURES if u[2] < 0.2 else NO_FORCES if u[2] < 0.6 else ALL,
            amplitude_1_deg=float(25.0 + 5.0 * u[5] if wide else 15.0 + 15.0 * u[5]),
            amplitude_2_deg=float(34.0 + 6.0 * u[7] if wide else 20.0 + 20.0 * u[7]),
            **muscle_conditions(needs, u, clean),
        )

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        site = draw_site(fault, random)
        return site, draw_sizes(site, random)

    def truth(self, site: str) -> dict[str, Any]:
        return truth_of(site)

    def known(self, c: ArmConditions) -> dict[str, float]:
        return {"payload_kg": c.payload_kg, "plane_deg": 90.0, **PRESSURES_KPA}

    def excitation(self, c: ArmConditions, record: Record, seed: int, noise: int) -> Excitation:
        seeds = np.random.SeedSequence(seed).generate_state(len(JOINTS))
        references = [
            aprbs(c.seconds, PERIOD_S, amplitude, c.hold_s, seed=int(stream))
            for amplitude, stream in zip((c.amplitude_1_deg, c.amplitude_2_deg), seeds, strict=True)
        ]
        reference = Excitation(np.stack(references, axis=1))
        if c.loop == "closed":
            return reference
        columns = record({}, reference, noise)
        commands = np.stack([columns[f"command_{j}"] for j in JOINTS], axis=1)
        return Excitation(commands, closed=False)

    def build(self, random: np.random.Generator, c: ArmConditions) -> Record:
        specimen = draw_arm(random, c.background)
        return lambda faults, signal, seed: record_arm(
            specimen, faults, signal, c.payload_kg, Readout(c.noise, seed, c.logger)
        )


MACHINE = TwoLinkMachine()
