"""Models of MuJoCo (MJCF), and URDF through MuJoCo's own loader."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import FileError
from pamid.model.model_file import ModelKind
from pamid.model.rig import Rig
from pamid.simulators.compiled_rig import CompiledMechanism
from pamid.simulators.mechanism import Mechanism
from pamid.simulators.mujoco_file import SUFFIXES
from pamid.simulators.mujoco_mechanism import read_mechanism


def rig(path: Path) -> Rig:
    """The rig in a file; FileError where it cannot be read or made one."""
    return rig_of(read_mechanism(path))


def rig_of(mechanism: Mechanism) -> Rig:
    """A mechanism as equations; FileError, with every hindrance, where it cannot be written so."""
    if not mechanism.joints:
        raise FileError(f"{mechanism.path}: it has no joints, so nothing in it can move.")
    if mechanism.hindrances:
        told = "; ".join(map(str, mechanism.hindrances))
        raise FileError(
            f"{mechanism.path} cannot be written as equations: {told}.",
            "Take these out, or state them otherwise: a tree of hinges and slides, out of reach of "
            "contacts, with fixed tendons and motor, position, velocity or general actuators.",
            code="model",
        )
    if not mechanism.sensors:
        raise FileError(
            f"{mechanism.path}: it has no sensor that pamid can read.",
            "Add <jointpos joint=...> for every joint that is recorded, or leave <sensor> out.",
        )
    return CompiledMechanism(mechanism)


KIND = ModelKind("mujoco", SUFFIXES, rig)
