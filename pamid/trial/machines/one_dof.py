"""One joint with two muscles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pamid.excitation.aprbs import aprbs
from pamid.trial import joint_plant
from pamid.trial.conditions import (
    ALL,
    ANGLE,
    NO_FORCES,
    Conditions,
    JointConditions,
    draw_joint_conditions,
)
from pamid.trial.faults import FAULTS, Fault
from pamid.trial.joint_plant import PERIOD_S, PRESSURES_KPA, Excitation
from pamid.trial.machine import ONE_DOF, Record

Array = NDArray[np.float64]


class OneDofMachine:
    """The joint of `joint_plant`."""

    name: ClassVar[str] = ONE_DOF
    period_s: ClassVar[float] = PERIOD_S
    faults: ClassVar[Mapping[str, Fault]] = FAULTS
    controller: ClassVar[Mapping[str, float]] = joint_plant.JOINT_CONTROLLER
    withheld_columns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        ALL: (),
        NO_FORCES: ("force_",),
        ANGLE: ("force_", "pressure_"),
    }

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> Conditions:
        return draw_joint_conditions(random, faults, clean)

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        return fault, FAULTS[fault].draw(random)

    def truth(self, site: str) -> dict[str, Any]:
        return FAULTS[site].truth

    def known(self, c: Conditions) -> dict[str, float]:
        assert isinstance(c, JointConditions)
        return {"inertia_kg_m2": c.inertia_kg_m2, **PRESSURES_KPA}

    def reference(self, c: Conditions, seed: int) -> Excitation:
        assert isinstance(c, JointConditions)
        return Excitation(
            reference_deg=aprbs(c.seconds, PERIOD_S, c.amplitude_deg, c.hold_s, seed=seed)
        )

    def commands(self, columns: Mapping[str, Array]) -> Excitation:
        return Excitation(command=columns["command"])

    def excitation(self, c: Any, record: Record, seed: int, noise: int) -> Excitation:
        reference = self.reference(c, seed)
        return self.commands(record({}, reference, noise)) if c.loop == "open" else reference

    def build(self, random: np.random.Generator, c: Conditions) -> Record:
        assert isinstance(c, JointConditions)
        specimen = joint_plant.draw_specimen(random, c.background)
        return lambda faults, signal, seed: joint_plant.record(
            specimen,
            faults,
            signal,
            inertia_kg_m2=c.inertia_kg_m2,
            noise=c.noise,
            seed=seed,
            logger=c.logger,
        )


MACHINE = OneDofMachine()
