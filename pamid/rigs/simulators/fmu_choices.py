"""Choices of a user on an FMU, in a table next to it, `drive.fmu.toml` for `drive.fmu`:

kind = "model-exchange"   # or "co-simulation", where it offers both
seen = false              # its states are not its whole memory
free = ["inertia_kg_m2"]  # parameters to fit, where not all are

[ports.torque_n_m]        # an input that is a force or a torque: a motion port
position = "angle_rad"
velocity = "speed_rad_per_s"
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pamid.base.errors import FileError, nearest
from pamid.base.toml_file import read_toml

EXCHANGE, CO_SIMULATION = "model-exchange", "co-simulation"
_KNOWN: dict[str, type] = {"kind": str, "seen": bool, "free": list, "ports": dict}
_MOTION = ("position", "velocity")


@dataclass(frozen=True)
class FmuChoices:
    """Content of the table; without a file the FMU's defaults hold.

    kind is "" and seen is None if the table does not state them; motion: as in `FmuRig`.
    """

    path: Path
    kind: str = ""
    seen: bool | None = None
    free: tuple[str, ...] = ()
    motion: dict[str, tuple[str, str]] = field(default_factory=dict)


def choices_path(fmu: Path) -> Path:
    """Path of the table of an FMU."""
    return fmu.with_name(f"{fmu.name}.toml")


def read_choices(fmu: Path) -> FmuChoices:
    """Read the table next to an FMU, if any.

    FileError for unknown content. The names are not compared with those of the FMU here.
    """
    path = choices_path(fmu)
    if not path.exists():
        return FmuChoices(path)
    table = read_toml(path)
    for key, value in table.items():
        if key not in _KNOWN:
            raise FileError(
                f"{path}: {key!r} is not a setting of an FMU",
                nearest(key, list(_KNOWN)) or f"there are {', '.join(_KNOWN)}",
                code="toml",
            )
        if not isinstance(value, _KNOWN[key]):
            raise _wrong(path, key, value)
    kind, free = table.get("kind", ""), table.get("free", [])
    if kind not in ("", EXCHANGE, CO_SIMULATION):
        raise FileError(
            f"{path}: kind = {kind!r} is not a kind of FMU",
            nearest(kind, [EXCHANGE, CO_SIMULATION]) or f"{EXCHANGE} or {CO_SIMULATION}",
            code="toml",
        )
    if not all(isinstance(name, str) for name in free):
        raise _wrong(path, "free", free)
    ports = table.get("ports", {})
    motion = {name: _signals(path, name, port) for name, port in ports.items()}
    return FmuChoices(path, kind, table.get("seen"), tuple(free), motion)


def _signals(path: Path, name: str, port: Any) -> tuple[str, str]:
    where = f"{path}: [ports.{name}]"
    if not isinstance(port, dict):
        raise FileError(
            f"{where} must be a table",
            f'write [ports.{name}] and under it position = "..." and velocity = "..."',
            code="toml",
        )
    for key, value in port.items():
        if key not in _MOTION:
            hint = nearest(key, list(_MOTION)) or "it takes position and velocity"
            raise FileError(f"{where} has {key!r}", hint, code="toml")
        if not isinstance(value, str):
            raise _wrong(path, f"ports.{name}.{key}", value)
    lacking = [key for key in _MOTION if key not in port]
    if lacking:
        raise FileError(
            f"{where} lacks {' and '.join(lacking)}",
            "name the outputs that are the position and the velocity where the force acts",
            code="toml",
        )
    return port["position"], port["velocity"]


def _wrong(path: Path, key: str, value: Any) -> FileError:
    like = {"kind": f'"{EXCHANGE}"', "seen": "false", "free": '["mass_kg"]', "ports": "a table"}
    return FileError(
        f"{path}: {key} = {value!r:.40} is not valid",
        f"write for example {like.get(key, 'a name')}",
        code="toml",
    )
