"""The machines of the trial, one per rig: which faults they can have, how they are drawn and how
they are recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import UsageError, nearest
from pamid.excitation.aprbs import aprbs
from pamid.trial import arm_plant, joint_plant
from pamid.trial.arm_faults import ARM_FAULTS, JOINTS, draw_site, draw_sizes, truth_of
from pamid.trial.conditions import (
    ALL,
    ANGLE,
    ANGLES_AND_PRESSURES,
    NO_FORCES,
    ArmConditions,
    Conditions,
    JointConditions,
    draw_arm_conditions,
    draw_joint_conditions,
)
from pamid.trial.faults import FAULTS, Fault
from pamid.trial.joint_plant import PERIOD_S, Excitation

Array = NDArray[np.float64]
#: planted sizes by fault (or fault@place), excitation, seed of the noise -> columns of a recording
Record = Callable[[Mapping[str, Mapping[str, float]], Excitation, int], dict[str, Array]]

ONE_DOF, TWO_LINK = "one-dof", "two-link"
PRESSURES_KPA = {"supply_pressure_kpa": 600.0, "initial_pressure_kpa": 550.0}


class OneDofMachine:
    """The joint of `joint_plant`."""

    name: ClassVar[str] = ONE_DOF
    faults: ClassVar[Mapping[str, Fault]] = FAULTS
    controller: ClassVar[Mapping[str, float]] = joint_plant.JOINT_CONTROLLER
    #: channels of a case -> how the columns begin that its recordings do not have
    withheld_columns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        ALL: (),
        NO_FORCES: ("force_",),
        ANGLE: ("force_", "pressure_"),
    }

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> Conditions:
        """How a case with these faults is recorded; clean: without background."""
        return draw_joint_conditions(random, faults, clean)

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        """Where the fault is planted (its name, or fault@place), and its sizes (SI)."""
        return fault, FAULTS[fault].draw(random)

    def truth(self, site: str) -> dict[str, Any]:
        """What counts as the right answer to a planted fault."""
        fault = FAULTS[site]
        return {
            "fault": site,
            "family": fault.family,
            "port": fault.port,
            "exact": sorted(fault.exact),
        }

    def known(self, c: Conditions) -> dict[str, float]:
        """[known] of a recording."""
        assert isinstance(c, JointConditions)
        return {"inertia_kg_m2": c.inertia_kg_m2, **PRESSURES_KPA}

    def reference(self, c: Conditions, seed: int) -> Excitation:
        """What the closed loop is asked to follow."""
        assert isinstance(c, JointConditions)
        return Excitation(
            reference_deg=aprbs(c.seconds, PERIOD_S, c.amplitude_deg, c.hold_s, seed=seed)
        )

    def commands(self, columns: Mapping[str, Array]) -> Excitation:
        """The commands of a recording, for an open loop."""
        return Excitation(command=columns["command"])

    def build(self, random: np.random.Generator, c: Conditions) -> Record:
        """A drawn machine, recorded under these conditions."""
        assert isinstance(c, JointConditions)
        specimen = joint_plant.draw_specimen(random, c.background)
        return lambda faults, signal, seed: joint_plant.record(
            specimen, faults, signal, inertia_kg_m2=c.inertia_kg_m2, noise=c.noise, seed=seed
        )


class TwoLinkMachine:
    """The arm of `arm`. Its methods are those of `OneDof`."""

    name: ClassVar[str] = TWO_LINK
    faults: ClassVar[Mapping[str, Fault]] = ARM_FAULTS
    controller: ClassVar[Mapping[str, float]] = arm_plant.ARM_CONTROLLER
    withheld_columns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        ALL: (),
        NO_FORCES: ("force_",),
        ANGLES_AND_PRESSURES: ("force_", "contraction_"),
    }

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> Conditions:
        return draw_arm_conditions(random, faults, clean)

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        site = draw_site(fault, random)
        return site, draw_sizes(site, random)

    def truth(self, site: str) -> dict[str, Any]:
        return truth_of(site)

    def known(self, c: Conditions) -> dict[str, float]:
        assert isinstance(c, ArmConditions)
        return {"payload_kg": c.payload_kg, "plane_deg": 90.0, **PRESSURES_KPA}

    def reference(self, c: Conditions, seed: int) -> Excitation:
        assert isinstance(c, ArmConditions)
        seeds = np.random.SeedSequence(seed).generate_state(len(JOINTS))
        return Excitation(
            reference_deg=np.stack(
                [
                    aprbs(c.seconds, PERIOD_S, amplitude, c.hold_s, seed=int(own))
                    for amplitude, own in zip(
                        (c.amplitude_1_deg, c.amplitude_2_deg), seeds, strict=True
                    )
                ],
                axis=1,
            )
        )

    def commands(self, columns: Mapping[str, Array]) -> Excitation:
        return Excitation(command=np.stack([columns[f"command_{j}"] for j in JOINTS], axis=1))

    def build(self, random: np.random.Generator, c: Conditions) -> Record:
        assert isinstance(c, ArmConditions)
        specimen = arm_plant.draw_arm(random, c.background)
        return lambda faults, signal, seed: arm_plant.record_arm(
            specimen, faults, signal, payload_kg=c.payload_kg, noise=c.noise, seed=seed
        )


Machine = OneDofMachine | TwoLinkMachine
MACHINES: dict[str, Machine] = {ONE_DOF: OneDofMachine(), TWO_LINK: TwoLinkMachine()}


def machine_named(rig: str) -> Machine:
    """The machine that stands for this rig. UsageError for a rig that the trial has none for."""
    if rig not in MACHINES:
        raise UsageError(
            f"the trial has no machine for the rig {rig!r}",
            nearest(rig, list(MACHINES)) or f"rigs: {', '.join(MACHINES)}",
        )
    return MACHINES[rig]
