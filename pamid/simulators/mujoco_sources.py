"""The files that an MJCF or URDF file names: includes, meshes, textures, height fields.

MuJoCo opens whatever stands under their names. A pipe there would block it for ever, and a device
has no end.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from pamid.base.errors import FileError
from pamid.base.files import open_data
from pamid.simulators.foreign_limits import foreign_limits
from pamid.simulators.xml_text import Tag, tags_of

_FOLDERS = ("meshdir", "texturedir", "assetdir")  # of <compiler>
_SCHEME = re.compile(r"^[a-z]+:/*")  # package://, file://
_TEXTS = ("include", "model", "attach")  # elements whose file is a model itself


def require_plain_sources(path: Path) -> None:
    """FileError for a pipe, a device or a socket where a model, or one that it includes, names a
    file. What is missing or is no XML is left for MuJoCo to say."""
    pending, seen = [path], set()
    folders: dict[Path, None] = {path.parent: None}
    names: dict[str, None] = {}
    while pending:
        text = pending.pop()
        if text in seen:
            continue
        seen.add(text)
        tags = _tags(text)
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
                if place.exists() and not place.is_dir():
                    open_data(place, _ANY_SIZE).close()


_ANY_SIZE = 1 << 62  # the memory of the process is limited


def _files(tag: Tag) -> list[str]:
    """Names of files in an element: "file", "fileright" ..., and "filename" of URDF."""
    found = (value for key, value in tag.attributes.items() if key.startswith("file") and value)
    return [_SCHEME.sub("", value) if "://" in value else value for value in found]


def _tags(path: Path) -> list[Tag]:
    with contextlib.suppress(OSError), open_data(path, foreign_limits().text) as file:
        text = file.read()
        with contextlib.suppress(FileError):
            return tags_of(text)
    return []
