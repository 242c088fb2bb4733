"""An arm of two joints with four muscles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pamid.excitation.aprbs import aprbs
from pamid.trial import arm_plant
from pamid.trial.arm_faults import ARM_FAULTS, JOINTS, draw_site, draw_sizes, truth_of
from pamid.trial.conditions import (
    ALL,
    ANGLES_AND_PRESSURES,
    NO_FORCES,
    ArmConditions,
    Conditions,
    draw_arm_conditions,
)
from pamid.trial.faults import Fault
from pamid.trial.joint_plant import PERIOD_S, PRESSURES_KPA, Excitation
from pamid.trial.machine import TWO_LINK, Record

Array = NDArray[np.float64]


class TwoLinkMachine:
    """The arm of `arm_plant`."""

    name: ClassVar[str] = TWO_LINK
    period_s: ClassVar[float] = PERIOD_S
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
                    aprbs(c.seconds, PERIOD_S, amplitude, c.hold_s, seed=int(stream))
                    for amplitude, stream in zip(
                        (c.amplitude_1_deg, c.amplitude_2_deg), seeds, strict=True
                    )
                ],
                axis=1,
            )
        )

    def commands(self, columns: Mapping[str, Array]) -> Excitation:
        return Excitation(command=np.stack([columns[f"command_{j}"] for j in JOINTS], axis=1))

    def excitation(self, c: Any, record: Record, seed: int, noise: int) -> Excitation:
        reference = self.reference(c, seed)
        return self.commands(record({}, reference, noise)) if c.loop == "open" else reference

    def build(self, random: np.random.Generator, c: Conditions) -> Record:
        assert isinstance(c, ArmConditions)
        specimen = arm_plant.draw_arm(random, c.background)
        return lambda faults, signal, seed: arm_plant.record_arm(
            specimen,
            faults,
            signal,
            payload_kg=c.payload_kg,
            noise=c.noise,
            seed=seed,
            logger=c.logger,
        )


MACHINE = TwoLinkMachine()
