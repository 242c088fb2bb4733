"""Models of MuJoCo (MJCF), and URDF through MuJoCo's loader."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import FileError
from pamid.model.rig import Rig
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mechanism_forms import mechanism_rig
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")


def rig(path: Path) -> Rig:
    """The rig in a file; FileError where it cannot be read or made a rig."""
    return rig_of(read_mechanism(path))


def rig_of(mechanism: Mechanism) -> Rig:
    """A mechanism as equations, or stepped by MuJoCo where it cannot be written so or geoms may
    touch; FileError where neither goes."""
    if not mechanism.joints:
        raise FileError(f"{mechanism.path}: it has no joints, so nothing in it can move.")
    if not mechanism.sensors:
        raise FileError(
            f"{mechanism.path}: it has no sensor that pamid can read"
            + "".join(f"; {why}" for why in mechanism.hindrances)
            + ".",
            "Add <jointpos joint=...> for every hinge or slide that is recorded, or leave <sensor> "
            "out.",
        )
    return mechanism_rig(mechanism)
