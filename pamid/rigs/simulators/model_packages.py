"""Places of the files that a model names: `package://`, `file://` and plain paths.

A URDF names its meshes by their ROS package, and MuJoCo has no list of packages. The folders from
`--package` and `pamid.model_packages` are in the environment variable PAMID_MODEL_PACKAGES. It
reaches the processes that compile a model and those that do the jobs of a diagnosis. Files are only
located and read.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote

from pamid.base.errors import FileError, UsageError
from pamid.base.files import PathLike, open_data
from pamid.rigs.simulators.xml_text import tags_of

PACKAGES_VARIABLE = "PAMID_MODEL_PACKAGES"
_PACKAGE_FILE = "package.xml"
_PACKAGE_FILE_BYTES = 1 << 20
_MOST_FOLDERS = 2000  # searched in an entry of ROS_PACKAGE_PATH
_DEPTH = 3  # of packages below an entry of ROS_PACKAGE_PATH
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


@dataclass(frozen=True)
class ModelPackages:
    """Search places for packages: stated folders by name, and search paths, all absolute.

    roots: folders that contain packages, such as the entries of ROS_PACKAGE_PATH.
    """

    stated: tuple[tuple[str, str], ...] = ()
    roots: tuple[str, ...] = ()

    def folders(self, name: str, file: Path) -> Iterator[Path]:
        """Folders of the package, most plausible first: as stated, near the file, on the roots."""
        yield from (Path(folder) for stated, folder in self.stated if stated == name)
        for parent in file.parents:
            yield from _package_in(parent, name)
        for root in map(Path, self.roots):
            yield from _package_in(root, name)
            yield from _package_below(root, name)


def known_packages() -> ModelPackages:
    """Packages in the environment variable. UsageError if it is not NAME=DIR pairs."""
    pairs = map(
        split_package, filter(None, os.environ.get(PACKAGES_VARIABLE, "").split(os.pathsep))
    )
    roots = [
        *_entries("ROS_PACKAGE_PATH"),
        *(prefix / "share" for prefix in _entries("AMENT_PREFIX_PATH")),
    ]
    stated = tuple((name, str(Path(folder).absolute())) for name, folder in pairs)
    return ModelPackages(stated, tuple(map(str, roots)))


@contextmanager
def model_packages(**folders: PathLike) -> Iterator[None]:
    """Set the folders of ROS packages, for models that name their meshes by `package://NAME/...`.

        with pamid.model_packages(ur_description="/opt/ros/share/ur_description"):
            diagnosis = pamid.diagnose("log.csv", rig="ur5e.urdf")

    The folders are in force within the block, here and in processes that begin there. They precede
    every other place. UsageError if a folder does not exist.
    """
    stated = []
    for name, folder in folders.items():
        place = Path(folder).expanduser().absolute()
        if not place.is_dir() or os.pathsep in str(place):
            more = f", or has {os.pathsep!r} in its path" if os.pathsep in str(place) else ""
            raise UsageError(
                f"package {name}: {folder} is not a folder{more}.",
                f"Give the folder that holds the meshes of {name}, the one with its "
                f"{_PACKAGE_FILE}.",
            )
        stated.append(f"{name}={place}")
    before = os.environ.get(PACKAGES_VARIABLE)
    os.environ[PACKAGES_VARIABLE] = os.pathsep.join([*stated, *([before] if before else [])])
    try:
        yield
    finally:
        if before is None:
            del os.environ[PACKAGES_VARIABLE]
        else:
            os.environ[PACKAGES_VARIABLE] = before


def split_package(pair: str) -> tuple[str, str]:
    """("ur_description", "/opt/ur_description") of "ur_description=/opt/ur_description".

    UsageError if it is not NAME=DIR.
    """
    name, sign, folder = pair.partition("=")
    if not (sign and folder and _NAME.fullmatch(name)):
        raise UsageError(
            f"--package {pair!r} is not NAME=DIR.",
            "For example --package ur_description=/opt/ros/share/ur_description.",
        )
    return name, folder


def package_of(name: str) -> str:
    """Package in the name of a file, "" if there is none."""
    match = re.match(r"(?:package|model):/+([^/]+)", name)
    return match[1] if match else ""


def places_of(
    name: str, file: Path, folders: Iterable[Path], packages: ModelPackages
) -> Iterator[Path]:
    """Possible places of a file that a model names, the most plausible first.

    name: as the model writes it: `package://NAME/...`, `model://NAME/...`, `file://...`, a path of
    this system or of Windows; file: the model; folders: those that plain names are relative to.
    """
    package = package_of(name)
    plain = name.replace("\\", "/")
    if package:
        inside = re.sub(r"^(?:package|model):/+[^/]+/*", "", plain)
        for folder in packages.folders(package, file):
            yield folder / inside
        # the package under another name, as an unpacked archive has it
        for parent in file.parents:
            yield parent / inside
    else:
        inside = re.sub(r"^file:(?://(?:localhost(?=/))?)?", "", plain)
    for spelling in dict.fromkeys((inside, unquote(inside))):
        for folder in folders:
            yield folder / spelling
    for folder in folders:
        yield folder / PureWindowsPath(inside).name


def _package_in(folder: Path, name: str) -> Iterator[Path]:
    """Package in a folder: the folder itself, or a package directly in it."""
    if folder.name == name or _name_in(folder) == name:
        yield folder
    if (folder / name).is_dir():
        yield folder / name
    for place in _children(folder, _MOST_FOLDERS):
        if place.name != name and _name_in(place) == name:
            yield place


def _package_below(root: Path, name: str) -> Iterator[Path]:
    """Packages deeper in a workspace, as ROS searches for them, within a limit."""
    level, seen = [root], 0
    for _ in range(_DEPTH):
        level = [place for folder in level for place in _children(folder, _MOST_FOLDERS - seen)]
        seen += len(level)
        for place in level:
            if place.parent != root and (place.name == name or _name_in(place) == name):
                yield place


def _children(folder: Path, most: int) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            names = sorted(e.name for e in entries if not e.name.startswith(".") and e.is_dir())
    except OSError:
        return []
    return [folder / name for name in names[: max(0, most)]]


def _name_in(folder: Path) -> str:
    """Name in the folder's package.xml, "" if there is none."""
    path = folder / _PACKAGE_FILE
    if not path.is_file():
        return ""
    try:
        with open_data(path, _PACKAGE_FILE_BYTES) as data:
            text = data.read()
        tag = next((t for t in tags_of(text) if t.name == "name"), None)
    except (OSError, FileError):
        return ""
    return "" if tag is None else text[tag.end : tag.closing].decode(errors="replace").strip()


def _entries(variable: str) -> list[Path]:
    return [Path(e).absolute() for e in os.environ.get(variable, "").split(os.pathsep) if e]
