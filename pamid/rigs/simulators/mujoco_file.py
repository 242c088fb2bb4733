"""A MuJoCo or URDF file, read by MuJoCo's loader, with the line of each element.

MuJoCo compiles the file in a separate process, because native code ignores signals, and a small
file can declare a model of any size. The compiled model returns in MuJoCo's binary format. MuJoCo
refuses unknown elements, and nothing in a file is run. The package is the extra `[mujoco]`.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pamid.base.errors import FileError
from pamid.base.files import MIB, PathLike, open_data
from pamid.base.parallel.limited_process import ProcessFailure, run_limited
from pamid.rigs.simulators.foreign_limits import RAISED, foreign_limits, require_few
from pamid.rigs.simulators.free_joints import FreeJoints, settle_free_joints
from pamid.rigs.simulators.model_packages import ModelPackages, known_packages
from pamid.rigs.simulators.mujoco_sources import (
    ModelAssets,
    require_plain_sources,
    root_link_with_mass,
)

_COMPILED = "model.mjb"
_FINITE = "Every number of a model must be finite: correct it in the file."
_MOST_WARNINGS, _LONGEST = 20, 300  # of MuJoCo, and characters of each
_LINE = re.compile(r"line (\d+)")


@dataclass(frozen=True)
class MujocoFile:
    """A loaded file.

    It has MuJoCo's module, its model (mjModel), the line of every element by kind and number (0 if
    unknown), MuJoCo's warnings, and the replaced free joints. left_out: sentence on unreadable
    meshes and textures, "" if there are none; first_link: see `root_link_with_mass`.
    """

    path: Path
    mujoco: ModuleType
    model: Any
    lines: dict[tuple[str, int], int]
    warnings: tuple[str, ...] = ()
    free: FreeJoints = FreeJoints()
    left_out: str = ""
    first_link: tuple[str, int] | None = None

    def line(self, kind: str, number: int) -> int:
        return self.lines.get((kind, number), 0)

    def stated_name(self, kind: str, number: int) -> str:
        """Name of an element in the file, "" if it has none."""
        which = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        return str(self.mujoco.mj_id2name(self.model, which, number) or "")

    def name(self, kind: str, number: int) -> str:
        """Name of an element; without a name, its kind and number."""
        return self.stated_name(kind, number) or f"{kind}_{number}"

    def copy(self) -> Any:
        """Independent copy of the model."""
        return self.mujoco.MjModel.__copy__(self.model)

    def disables(self, word: str) -> bool:
        """True if the model switches this part of MuJoCo off ("CONTACT")."""
        flag = getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{word}")
        return bool(self.model.opt.disableflags & int(flag))

    def word(self, enum: str, value: Any) -> str:
        """MuJoCo's word for a value of any of its enumerations: ("mjtJoint", 3) -> "hinge"."""
        return str(getattr(self.mujoco, enum)(int(value)).name).split("_", 1)[1].lower()


def mujoco_package(path: PathLike) -> ModuleType:
    """MuJoCo's Python package. FileError with the package to install if it is absent.

    MuJoCo then no longer writes warnings itself. By default it appends them to MUJOCO_LOG.TXT in
    the working folder. Those of a compilation are findings of the file, those of steps are counted
    (`pamid.engine.simulator_warnings`). A handler from other code stays.
    """
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
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda _: None)
    module: ModuleType = mujoco
    return module


def open_mujoco(path: PathLike, *, visual: bool = True) -> MujocoFile:
    """Load a file (MJCF or URDF); its meshes are also searched in `known_packages`.

    visual: False leaves out shapes, meshes and textures that only a picture needs.

    Raises
    ------
    FileError
        The file is absent or not a regular file. MuJoCo refuses it; the message has MuJoCo's text
        and line. It takes more time or memory than `pamid.rigs.simulators.foreign_limits` allows. A
        number in it is not finite. The extra is not installed.
    """
    file = Path(path)
    with _apart(compiled, file, visual=visual) as (answer, folder):
        mujoco = mujoco_package(file)
        model = mujoco.MjModel.from_binary_path(str(folder / _COMPILED))
    lines = {(kind, number): line for kind, number, line in answer["lines"]}
    return MujocoFile(
        file,
        mujoco,
        model,
        lines,
        tuple(answer["warnings"]),
        FreeJoints(tuple(answer["floating"]), tuple(map(tuple, answer["free"]))),
        answer["left_out"],
        None if answer["first_link"] is None else tuple(answer["first_link"]),
    )


def mjcf_of(path: PathLike) -> bytes:
    """Text of a model as MJCF, for example of a URDF. Errors as in `open_mujoco`."""
    with _apart(translated, Path(path)) as (answer, _):
        return str(answer["text"]).encode()


@contextmanager
def _apart(
    function: Callable[..., Any], file: Path, **settings: Any
) -> Iterator[tuple[dict[str, Any], Path]]:
    """Call a function of this module on a file in a separate process.

    Returns the answer and the folder with its output. FileError: see `open_mujoco`.
    """
    if not file.exists():
        raise FileError(f"no such file: {file}", "give the path of a .xml (MJCF) or .urdf file")
    limits = foreign_limits()
    open_data(file, limits.text).close()
    mujoco_package(file)
    whole = str(file.absolute())
    with tempfile.TemporaryDirectory(prefix="pamid-") as name:
        folder = Path(name)
        try:
            answer = run_limited(
                f"{__name__}:{function.__name__}",
                {"path": whole, "packages": asdict(known_packages()), **settings},
                folder,
                limits.compilation,
                f"compiling {file.name}, for at most {limits.compilation.patience:.0f} s",
            )
        except ProcessFailure as failure:
            raise FileError(
                f"{file}: MuJoCo cannot compile it: {failure}.", RAISED, code="too-large"
            ) from failure
        except FileError as error:
            raise FileError(
                error.message.replace(whole, str(file)),
                error.hint.replace(whole, str(file)),
                code=error.code,
            ) from error
        yield answer, folder


def compiled(path: str, packages: dict[str, Any], folder: Path, visual: bool) -> dict[str, Any]:
    """Compile a file and save the model into the folder; returns lines of its elements, and
    warnings.

    `open_mujoco` calls it in a separate process. packages: a `ModelPackages` as plain values.
    """
    file = Path(path)
    warnings: list[str] = []
    mujoco = mujoco_package(file)
    mujoco.set_mju_user_warning(warnings.append)
    spec, model, left_out = _compile(file, packages, visual)
    free = settle_free_joints(mujoco, spec, _line)
    if free.notes:
        model = spec.compile()
    kinds = {
        "body": spec.bodies,
        "joint": spec.joints,
        "geom": spec.geoms,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
        "sensor": spec.sensors,
        "equality": spec.equalities,
    }
    for kind in ("joint", "tendon", "actuator", "sensor"):
        require_few(file, f"{kind}s", len(kinds[kind]))
    lines = {
        (kind, int(element.id)): line
        for kind, elements in kinds.items()
        for element in elements
        if (line := _line(element)) and element.id >= 0
    }
    require_finite(MujocoFile(file, mujoco, model, lines))
    for text in warnings:
        if "NaN" in text:  # MuJoCo treats NaN as an omitted value, such as a mass
            raise FileError(f"{path}: MuJoCo warns: {text}", _FINITE, code="model")
    mujoco.mj_saveModel(model, str(folder / _COMPILED))
    return {
        "lines": [(kind, number, line) for (kind, number), line in lines.items()],
        "floating": list(free.floating),
        "free": [list(note) for note in free.notes],
        "warnings": [" ".join(text.split())[:_LONGEST] for text in warnings[:_MOST_WARNINGS]],
        "left_out": left_out,
        "first_link": root_link_with_mass(file),
    }


def translated(path: str, packages: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Text of a file as MJCF; `mjcf_of` calls it in a separate process."""
    spec, _, _ = _compile(Path(path), packages, True)
    return {"text": spec.to_xml()}


def _compile(file: Path, packages: dict[str, Any], visual: bool) -> tuple[Any, Any, str]:
    """MjSpec of a file, its mjModel, and a note on omissions."""
    mujoco = mujoco_package(file)
    folders = require_plain_sources(file)
    assets = ModelAssets(mujoco, file, folders, ModelPackages(**packages), visual=visual)
    try:
        spec, model = assets.compiled()
        if file.suffix.lower() == ".urdf":
            # neighbours in a tree never collide in MuJoCo, but for the world, of which the
            # compiled base of a URDF is a part: shapes of neighbours overlap in most of them
            for link in spec.worldbody.bodies:
                spec.add_exclude(bodyname1="world", bodyname2=link.name)
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise FileError(f"{file}: {_reason(error)}", _hint(str(error)), code="model") from error
    return spec, model, assets.note()


def require_finite(file: MujocoFile) -> None:
    """Raise FileError for an impossible number of the model, of which MuJoCo only warns.

    Impossible are NaN, infinity anywhere but at an end of a range, and a time step that is not
    above 0.
    """
    m = file.model
    step = float(m.opt.timestep)
    if not (math.isfinite(step) and step > 0.0):
        raise FileError(
            f"{file.path}: its timestep is {step:g} s, not a positive number.",
            'Write a time step of the simulation into it: <option timestep="0.002"/>.',
            code="model",
        )
    for part, owner in (("option ", m.opt), ("statistic ", m.stat), ("", m)):
        for name in dir(owner):
            values = np.asarray(getattr(owner, name)) if name[:1] != "_" else np.zeros(0)
            if values.dtype.kind != "f":
                continue
            wrong = np.isnan(values) if "range" in name else ~np.isfinite(values)
            if wrong.any():
                first = np.argwhere(wrong)[0] if values.ndim else np.zeros(1, int)
                number = values[tuple(first)] if values.ndim else values
                raise FileError(
                    f"{file.path}: {part or _owner(file, name, int(first[0]))}{name} is "
                    f"{float(number):g}.",
                    _FINITE,
                    code="model",
                )


def _owner(file: MujocoFile, array: str, row: int) -> str:
    """Element of a row of an array of the model, as text for an error."""
    prefix = array.partition("_")[0]
    if prefix == "dof":
        prefix, row = "jnt", int(file.model.dof_jntid[row])
    kind = {"jnt": "joint", "eq": "equality"}.get(prefix, prefix)
    if kind not in ("body", "joint", "geom", "tendon", "actuator", "sensor", "equality"):
        return ""
    line = file.line(kind, row)
    return f"{kind} {file.name(kind, row)!r}{f', line {line}' if line else ''}: "


def _line(element: Any) -> int:
    """Line of an element in the file, 0 if unknown."""
    match = _LINE.search(element.info or "")
    return int(match.group(1)) if match else 0


def _reason(error: Exception) -> str:
    reason = " ".join(str(error).split()).removeprefix("Error: ")
    return f"MuJoCo cannot read it: {reason[:300] or type(error).__name__}"


def _hint(message: str) -> str:
    if "opening file" in message or "Could not open" in message:
        return "Put the file that it names where the model looks for it (its own folder, meshdir)."
    if "unknown exception" in message or "alloc" in message:
        most = foreign_limits().compilation.memory // MIB
        return f"Most likely it needs more than {most} MiB of memory. {RAISED}"
    if "mass and inertia of moving bodies" in message:
        return (
            "Give that body its mass (<inertial>), or let MuJoCo assume a small one, in a URDF with"
            ' <mujoco><compiler boundmass="1e-4" boundinertia="1e-7"/></mujoco> inside <robot>.'
        )
    if "A + B >= C" in message:
        return (
            "Correct the inertia of that body, or let MuJoCo do it, in a URDF with"
            ' <mujoco><compiler balanceinertia="true"/></mujoco> inside <robot>.'
        )
    if "missing element: 'inertia'" in message:
        return "Add <inertia> to that <inertial>; without <inertial> the shapes give the mass."
    if "Schema violation" in message:
        return (
            "Correct or remove the element; `python -m mujoco.viewer --mjcf FILE` has the same "
            "message."
        )
    return ""
