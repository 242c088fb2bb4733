"""Files that an MJCF or URDF file names: includes, meshes, textures, height fields.

MuJoCo opens anything under these names. A pipe would block it for ever, and a device has no end.
Meshes and textures that MuJoCo does not find are searched where ROS and other tools have them. If
a file is missing and the motion does not depend on it, it is left out.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from types import ModuleType
from typing import Any

from pamid.base.errors import FileError, listed
from pamid.base.files import open_data
from pamid.rigs.simulators.foreign_limits import foreign_limits
from pamid.rigs.simulators.model_packages import ModelPackages, package_of, places_of
from pamid.rigs.simulators.xml_text import Edits, Tag, tags_of

_FOLDERS = ("meshdir", "texturedir", "assetdir")  # of <compiler>
_TEXTS = ("include", "model", "attach")  # elements whose file is a model itself
_ANY_SIZE = 1 << 62  # the memory of the process is limited
_MOST_NAMED = 6  # files in a note


def require_plain_sources(path: Path) -> tuple[Path, ...]:
    """Return the folders that names of files in a model are relative to.

    A missing include, or a text that is not XML, is left to MuJoCo's error.

    Raises
    ------
    FileError
        The model or an included model names a pipe, a device or a socket, or the text needs xacro.
    """
    pending, seen = [path], set()
    folders: dict[Path, None] = {path.parent: None}
    names: dict[str, None] = {}
    while pending:
        text = pending.pop()
        if text in seen:
            continue
        seen.add(text)
        tags = _tags(text)
        _require_expanded(text, tags)
        folders[text.parent] = None
        for tag in tags:
            for key in _FOLDERS:
                if key in tag.attributes:
                    folders |= {base / tag.attributes[key]: None for base in list(folders)}
        for tag in tags:
            for name in _files(tag):
                names[name] = None
                if tag.name in _TEXTS:
                    pending += [p for base in folders if (p := base / name).is_file()]
    for name in names:
        for base in folders:
            for place in {base / name, base / Path(name).name}:
                _require_regular(place)
    return tuple(folders)


def _require_regular(place: Path) -> None:
    if _is_there(place):
        open_data(place, _ANY_SIZE).close()


def _is_there(place: Path) -> bool:
    """True if there is a file, a pipe or the like."""
    try:
        return place.exists() and not place.is_dir()
    except (OSError, ValueError):  # a name too long, or a zero in it
        return False


def _require_expanded(path: Path, tags: Iterable[Tag]) -> None:
    """Raise FileError for a text with macros of xacro, which MuJoCo cannot read."""
    tag = next((t for t in tags if t.name.startswith("xacro:")), None)
    if tag is None and path.suffix != ".xacro":
        return
    plain = path.with_suffix("") if path.suffix == ".xacro" else path
    plain = plain if plain.suffix == ".urdf" and plain != path else plain.with_suffix(".plain.urdf")
    at = f", line {tag.line}: <{tag.name}>" if tag else ""
    raise FileError(
        f"{path}{at} needs xacro and is not yet a URDF.",
        f"Expand it first: xacro {path} > {plain} (pip install xacro, or ROS).",
        code="model",
    )


def _files(tag: Tag) -> list[str]:
    """Names of files in an element: "file", "fileright" ..., and "filename" of URDF."""
    return [value for key, value in tag.attributes.items() if key.startswith("file") and value]


def _tags(path: Path) -> list[Tag]:
    with contextlib.suppress(OSError), open_data(path, foreign_limits().text) as file:
        text = file.read()
        with contextlib.suppress(FileError):
            return tags_of(text)
    return []


def root_link_with_mass(path: Path) -> tuple[str, int] | None:
    """Name and line of a URDF's root link, if it has a mass."""
    tags = _tags(path)
    if not tags or tags[0].name != "robot":
        return None
    led = {tag.attributes.get("link") for tag in tags if tag.name == "child"}
    for mass in (tag for tag in tags if tag.name == "mass"):
        link = tags[tags[mass.parent].parent]
        name = link.attributes.get("name", "")
        weighty = mass.attributes.get("value", "").strip("0. ") != ""
        if link.name == "link" and name not in led and weighty:
            return name, link.line
    return None


def relocated_text(text: bytes, path: Path, folder: Path) -> tuple[bytes, str]:
    """Text of a model file whose relative paths lead from another folder to the same files.

    Folders of meshes and textures in <compiler>, included files, and the meshes of a URDF are
    rewritten. Absolute paths and those of packages stay. Also a note on included files that state
    such folders themselves, "" if there are none.
    """
    tags, edits = tags_of(text), Edits(text)
    if folder.absolute() == path.parent.absolute():
        return text, ""
    is_urdf, has_files = tags[0].name == "robot", False
    lacking = {"meshdir", "texturedir"}  # folders that are those of the model by default
    compilers = [tag for tag in tags if tag.name == "compiler"]
    for tag in compilers:
        for key in (key for key in _FOLDERS if key in tag.attributes):
            edits.set(tag, key, _moved(tag.attributes[key], path, folder))
            lacking -= {"meshdir", "texturedir"} if key == "assetdir" else {key}
    for tag in tags:
        for key in (key for key in tag.attributes if key.startswith("file")):
            name = tag.attributes[key]
            if is_urdf and (path.parent / name).is_file() or tag.name in _TEXTS:
                edits.set(tag, key, _moved(name, path, folder))
            has_files = has_files or _moved(name, path, folder) != name
    if has_files and lacking and not is_urdf:
        values = {key: _moved(".", path, folder) for key in sorted(lacking)}
        for key, value in values.items() if compilers else ():
            edits.set(compilers[0], key, value)
        if not compilers:
            words = " ".join(f'{key}="{value}"' for key, value in values.items())
            edits.add_inside(tags[0], f"<compiler {words}/>")
    included = [tag.attributes.get("file", "") for tag in tags if tag.name == "include"]
    stating = [
        name
        for name in included
        for tag in _tags(path.parent / name)
        if tag.name == "compiler" and any(key in tag.attributes for key in _FOLDERS)
    ]
    note = (
        f"{', '.join(dict.fromkeys(stating))} states the folder of its meshes relative to "
        f"{path.parent}, which does not lead there from {folder}"
    )
    return edits.made(tags), note if stating else ""


def _moved(name: str, path: Path, folder: Path) -> str:
    """Name of a file or folder relative to another folder than that of the model."""
    if not name or "://" in name or Path(name).is_absolute():
        return name
    return Path(os.path.relpath((path.parent / name).absolute(), folder.absolute())).as_posix()


# ---- meshes and textures -------------------------------------------------------------------------


@dataclass(frozen=True)
class AbsentFile:
    """Unreadable mesh or texture: its name in the model, and the reason."""

    name: str
    reason: str


class ModelAssets:
    """Meshes and textures of a model before its compilation."""

    def __init__(
        self,
        mujoco: ModuleType,
        path: Path,
        folders: tuple[Path, ...],
        packages: ModelPackages,
        *,
        visual: bool = True,
    ) -> None:
        self.mujoco, self.path, self.folders, self.packages = mujoco, path, folders, packages
        self.visual = visual  # False: without what only a picture needs
        self.absent: dict[str, AbsentFile] = {}  # meshes by their name
        self.textures: dict[str, AbsentFile] = {}
        self.bodies: dict[str, None] = {}  # bodies without some of their collision shapes
        self.present: dict[str, tuple[Any, Path]] = {}  # meshes of the latest parse, their places

    def compiled(self) -> tuple[Any, Any]:
        """MjSpec of the model, and the compiled model.

        FileError if the model depends on an unreadable mesh. ValueError: as MuJoCo raises it.
        """
        spec = self._parsed()
        try:
            return spec, spec.compile()
        except ValueError:
            unread = {name: why for name in self.present if (why := self._why_unread(name))}
            if not unread:
                raise
        self.absent |= {
            name: AbsentFile(self.present[name][1].name, why) for name, why in unread.items()
        }
        spec = self._parsed()
        return spec, spec.compile()

    def note(self) -> str:
        """Sentence on omissions, "" if there are none."""
        by_reason: dict[str, list[str]] = {}
        for absent in dict.fromkeys([*self.absent.values(), *self.textures.values()]):
            by_reason.setdefault(absent.reason, []).append(absent.name)
        if not by_reason:
            return ""
        reasons = "; ".join(
            f"{listed(names, _MOST_NAMED)} ({why})" for why, names in by_reason.items()
        )
        note = f"left out, because the motion does not depend on them: {reasons}"
        if self.bodies:
            note += f"; contacts of these shapes of {listed(self.bodies, _MOST_NAMED)} are not seen"
        return note

    def _parsed(self) -> Any:
        """Model with every mesh and texture at its place, and without the absent ones."""
        spec = self.mujoco.MjSpec.from_file(str(self.path))
        for body in spec.bodies:
            # a diagonal mass matrix that MuJoCo stores as such could not follow a moved centre
            body.simple = 0
        stripped, self.present = spec.strippath, {}
        spec.compiler.discardvisual = spec.compiler.discardvisual or not self.visual
        for mesh in spec.meshes:
            name = _mesh_name(mesh)
            if not mesh.file or name in self.absent:
                continue
            place, why = self._put(mesh, stripped)
            if place is None:
                self.absent[name] = AbsentFile(mesh.file, why)
            else:
                self.present[name] = mesh, place
        for texture in spec.textures:
            if not texture.file:
                continue
            place, why = self._put(texture, stripped)
            if place is None:
                self.textures[texture.file] = AbsentFile(texture.file, why)
                texture.file, texture.builtin = "", self.mujoco.mjtBuiltin.mjBUILTIN_FLAT
                texture.width = texture.height = 1
        for asset in (*spec.hfields, *spec.skins):  # the motion may depend on them
            if asset.file:
                self._put(asset, stripped)
        spec.strippath = False  # every file stands with its whole path now
        self._leave_out(spec)
        return spec

    def _put(self, asset: Any, stripped: bool) -> tuple[Path | None, str]:
        """Write the path of its file into a mesh or texture, unless MuJoCo finds it by itself.

        Returns the path, or None and the reason.
        """
        name = asset.file
        place = next(
            filter(_is_there, places_of(name, self.path, self.folders, self.packages)), None
        )
        if place is None:
            package = package_of(name)
            unknown = package and not any(self.packages.folders(package, self.path))
            return None, f"package {package!r} is not found" if unknown else "no such file"
        _require_regular(place)
        if stripped or not any(_is_there(base / name) for base in self.folders):
            asset.file = str(place)
        return place, ""

    def _why_unread(self, name: str) -> str:
        """Reason why MuJoCo cannot read a mesh by itself, "" if it can."""
        mesh, place = self.present[name]
        alone = self.mujoco.MjSpec()
        copy = alone.add_mesh(name="mesh", file=str(place), inertia=mesh.inertia)
        copy.content_type, copy.scale = mesh.content_type, mesh.scale
        try:
            alone.compile()
        except ValueError as error:
            first = str(error).splitlines()[0].removeprefix("Error: ")
            return f"MuJoCo: {first.replace(str(place), place.name)}"
        return ""

    def _leave_out(self, spec: Any) -> None:
        """Remove the shapes of absent meshes.

        FileError if a moving body has its mass from such a file.
        """
        for geom in list(spec.geoms):
            absent = self.absent.get(geom.meshname)
            if absent is None:
                continue
            body, moving = geom.parent, False
            while body is not None and not moving:
                moving, body = len(body.joints) > 0, body.parent
            if moving and self._has_mass_from(geom):
                name, package = geom.parent.name, package_of(absent.name)
                cure = (
                    f"Give the folder of the package (--package {package}=DIR)"
                    if package
                    else "Put the file in its place (the model's folder, meshdir) as .stl, .obj or "
                    ".msh"
                )
                raise FileError(
                    f"{self.path}: {name!r} has no <inertial>, so its mass comes from the mesh "
                    f"{absent.name}, which cannot be read: {absent.reason}.",
                    f"{cure}, or write the mass of {name!r} as <inertial> into the model.",
                    code="model",
                )
            if geom.contype or geom.conaffinity:
                self.bodies[geom.parent.name] = None
            spec.delete(geom)
        for mesh in list(spec.meshes):
            if _mesh_name(mesh) in self.absent:
                spec.delete(mesh)

    def _has_mass_from(self, geom: Any) -> bool:
        """True if the mass or inertia of the body depends on this shape."""
        modes, mode = self.mujoco.mjtInertiaFromGeom, geom.compiler.inertiafromgeom
        if mode == modes.mjINERTIAFROMGEOM_FALSE or (
            mode == modes.mjINERTIAFROMGEOM_AUTO and geom.parent.explicitinertial
        ):
            return False
        low, high = geom.compiler.inertiagrouprange
        weightless = geom.mass == 0.0 or (geom.mass != geom.mass and geom.density == 0.0)
        return low <= geom.group <= high and not weightless


def _mesh_name(mesh: Any) -> str:
    """Name by which shapes refer to a mesh; without a name, that of its file."""
    return str(mesh.name or PureWindowsPath(mesh.file).stem)
