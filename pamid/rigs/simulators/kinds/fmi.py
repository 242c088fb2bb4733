"""FMUs, FMI 2.0 and 3.0, for co-simulation and model exchange."""

from __future__ import annotations

from pathlib import Path

from pamid.model.rig import Rig
from pamid.rigs.simulators.fmu_file import read_fmu
from pamid.rigs.simulators.fmu_rig import FmuRig

SUFFIXES = (".fmu",)


def rig(path: Path) -> Rig:
    """The rig in a file; its binary is run when it is simulated, not to read it."""
    return FmuRig(read_fmu(path))
