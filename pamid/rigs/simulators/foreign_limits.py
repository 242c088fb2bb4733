"""Limits on reading a model file of another program.

A file of a kilobyte can declare a model that takes hours and all memory. The environment variable
PAMID_MODEL_LIMITS multiplies every limit here, for a model that you trust and that needs more.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError, UsageError
from pamid.base.files import MIB
from pamid.base.parallel.limited_process import ProcessLimits

VARIABLE = "PAMID_MODEL_LIMITS"
COMPILE_S = 40.0  # processor time for MuJoCo's compilation of a model
COMPILE_PATIENCE_S = 120.0  # wall-clock time for it
COMPILE_MEMORY = 1536 * MIB
MODEL_TEXT = 32 * MIB  # of an MJCF or URDF file; of the description in an FMU
FMU_UNPACKED = 512 * MIB  # total size of an FMU
FMU_FILES = 20_000  # in an FMU
# of a kind: joints, actuators, sensors, tendons; inputs and outputs of an FMU
MODEL_ELEMENTS = 1000
RAISED = (
    f"Check that this is the intended file. If you trust the file, set {VARIABLE}=4 in the "
    "environment: the limit is then four times as large."
)


@dataclass(frozen=True)
class ForeignLimits:
    """Limits for a model file.

    They bound the compilation, the bytes of its text, bytes and number of unpacked files, and
    elements of a kind.
    """

    compilation: ProcessLimits
    text: int
    unpacked: int
    files: int
    elements: int


def foreign_limits() -> ForeignLimits:
    """Limits in force. UsageError for a factor that is not a positive number."""
    setting = os.environ.get(VARIABLE, "").strip() or "1"
    try:
        factor = float(setting)
    except ValueError:
        factor = math.nan
    if not (math.isfinite(factor) and factor > 0.0):
        raise UsageError(
            f"{VARIABLE}={setting!r} is not a positive number.", "Write a number like 4."
        )
    return ForeignLimits(
        ProcessLimits(
            factor * COMPILE_S, factor * COMPILE_PATIENCE_S, round(factor * COMPILE_MEMORY)
        ),
        round(factor * MODEL_TEXT),
        round(factor * FMU_UNPACKED),
        round(factor * FMU_FILES),
        max(1, round(factor * MODEL_ELEMENTS)),
    )


def require_few(path: Path, kind: str, count: int) -> None:
    """Raise FileError if a model has too many elements of a kind for a rig.

    Every element becomes a port, at which every effect is tried.
    """
    most = foreign_limits().elements
    if count > most:
        raise FileError(
            f"{path}: the model has {count} {kind}; the limit is {most}.",
            RAISED,
            code="too-large",
        )
