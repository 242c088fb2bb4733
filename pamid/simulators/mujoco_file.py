"""A MuJoCo or URDF file through MuJoCo's own loader, with the line at which each element stands.

MuJoCo reads the file and refuses what it does not know; nothing in it is run. The package is the
extra `[mujoco]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from pamid.base.errors import FileError
from pamid.base.files import PathLike

#: endings of the files that are read here
SUFFIXES = (".xml", ".mjcf", ".urdf")

_LINE = re.compile(r"line (\d+)")


@dataclass(frozen=True)
class MujocoFile:
    """A loaded file: MuJoCo's module, its model (mjModel), and the line of every element by kind
    and number, 0 where it is not known."""

    path: Path
    mujoco: ModuleType
    model: Any
    lines: dict[tuple[str, int], int]

    def line(self, kind: str, number: int) -> int:
        return self.lines.get((kind, number), 0)

    def name(self, kind: str, number: int) -> str:
        """An element's own name; where it has none, its kind and number."""
        kinds = self.mujoco.mjtObj
        found = self.mujoco.mj_id2name(self.model, _object(kinds, kind), number)
        return str(found) if found else f"{kind}_{number}"

    def word(self, enum: str, value: Any) -> str:
        """What MuJoCo calls a value of one of its enumerations: ("mjtJoint", 3) -> "hinge"."""
        return str(getattr(self.mujoco, enum)(int(value)).name).split("_", 1)[1].lower()


def _object(kinds: Any, kind: str) -> Any:
    return getattr(kinds, f"mjOBJ_{kind.upper()}")


def mujoco_package(path: PathLike) -> ModuleType:
    """MuJoCo's Python package; FileError with what to install where it is absent."""
    try:
        import mujoco
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "mujoco":
            raise
        raise FileError(
            f"{path}: reading a MuJoCo or URDF model needs mujoco, which is not installed.",
            "pip install 'pamid[mujoco]'",
            code="missing-extra",
        ) from error
    module: ModuleType = mujoco
    return module


def open_mujoco(path: PathLike) -> MujocoFile:
    """Load a file (MJCF or URDF). FileError: it is absent, MuJoCo refuses it (its words and its
    line are passed on), or the extra is not installed."""
    file = Path(path)
    if not file.is_file():
        raise FileError(f"no such file: {file}", "give the path of a .xml (MJCF) or .urdf file")
    mujoco = mujoco_package(file)
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise FileError(f"{file}: {_reason(error)}", _hint(str(error)), code="model") from error
    kinds = {
        "body": spec.bodies,
        "joint": spec.joints,
        "geom": spec.geoms,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
        "sensor": spec.sensors,
        "equality": spec.equalities,
    }
    lines = {key: line for kind, found in kinds.items() for key, line in _lines(kind, found)}
    return MujocoFile(file, mujoco, model, lines)


def _lines(kind: str, elements: Iterable[Any]) -> Iterable[tuple[tuple[str, int], int]]:
    for element in elements:
        found = _LINE.search(element.info or "")
        if found and element.id >= 0:
            yield (kind, int(element.id)), int(found.group(1))


def _reason(error: Exception) -> str:
    said = " ".join(str(error).split()).removeprefix("Error: ")
    return f"MuJoCo cannot read it: {said[:300] or type(error).__name__}"


def _hint(said: str) -> str:
    if "opening file" in said or "Could not open" in said:
        return "Put the file that it names where the model looks for it (its own folder, meshdir)."
    if "Schema violation" in said:
        return "Mend or remove the element; `python -m mujoco.viewer --mjcf FILE` shows the same."
    return ""
