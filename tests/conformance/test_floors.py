"""The house stands: every file has its room, imports point down, nothing goes in a circle (imports
inside functions included), heavy packages stay at home, the package list equals the folders."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

#: rooms from the ground up; a file may import its own room and rooms on floors below
FLOORS: tuple[tuple[str, ...], ...] = (
    ("schemas",),
    ("base",),
    ("parallel", "recording", "symbolic"),
    ("engine",),
    ("model", "networks"),
    ("excitation",),
    ("effects", "rigs", "simulation", "ingest", "simulators"),
    ("checks", "estimation"),
    ("authoring",),
    ("diagnosis",),
    ("planning", "trial"),
    ("verdict",),
    ("report",),
    ("correction",),
    ("export",),
    ("api",),
    ("replications",),
    ("cli",),
)
#: not in a room: what rig files, effect files and scripts import
FACES = ("pamid/__init__.py", "pamid/equations.py")

#: the only places that may import these, at any depth of a function
HOMES: dict[str, tuple[str, ...]] = {
    "numba": ("pamid/engine/", "pamid/trial/"),
    "llvmlite": ("pamid/engine/",),
    "torch": ("pamid/networks/",),
    "pysindy": ("pamid/verdict/",),
    "matplotlib": ("pamid/report/", "pamid/recording/plot.py"),
    "jinja2": ("pamid/report/",),
    "markupsafe": ("pamid/report/",),
    "pandas": ("pamid/recording/recording.py", "pamid/ingest/", "pamid/api/given.py"),
    "pint": ("pamid/ingest/",),
    "pydantic": ("pamid/ingest/", "pamid/schemas/"),
    "h5py": ("pamid/ingest/",),
    "nptdms": ("pamid/ingest/",),
    "asammdf": ("pamid/ingest/",),
    "rosbags": ("pamid/ingest/",),
    "pyarrow": ("pamid/ingest/",),
    "matio": ("pamid/ingest/",),
    "onnx": ("pamid/export/",),
    "mujoco": ("pamid/simulators/",),
    "fmpy": ("pamid/simulators/",),
    "distributed": ("pamid/parallel/dask_backend.py",),
    "click": ("cli/",),
}
HEAVY = (
    "numba",
    "llvmlite",
    "torch",
    "pysindy",
    "matplotlib",
    "jinja2",
    "markupsafe",
    "pandas",
    "scipy",
    "sklearn",
    "numpy",
    "pamid",
    "pint",
    "pydantic",
    "h5py",
    "nptdms",
    "asammdf",
    "rosbags",
    "pyarrow",
    "matio",
    "onnx",
    "mujoco",
    "fmpy",
    "distributed",
)

FILES = sorted(path for folder in ("pamid", "cli") for path in (ROOT / folder).rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _room(path: Path) -> str:
    """The room of a file: the folder in pamid/ that it lies in, however deep."""
    parts = path.relative_to(ROOT).parts
    return "cli" if parts[0] == "cli" else parts[1]


@cache
def _imports(path: Path, *, top_only: bool = False) -> tuple[str, ...]:
    """Full dotted names a file imports (`from pamid.base import units`: pamid.base.units)."""
    return tuple(_imported(path, top_only))


def _imported(path: Path, top_only: bool) -> Iterator[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = tree.body if top_only else list(ast.walk(tree))
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                folder = path.parents[node.level - 1].relative_to(ROOT).as_posix().replace("/", ".")
                base = f"{folder}.{base}".rstrip(".")
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _floor(room: str) -> int:
    for number, rooms in enumerate(FLOORS):
        if room in rooms:
            return number
    raise AssertionError(f"{room} is no room: enter it in FLOORS, or move the file into a room")


def _module(path: Path) -> str:
    return (
        path.relative_to(ROOT)
        .with_suffix("")
        .as_posix()
        .replace("/", ".")
        .removesuffix(".__init__")
    )


MODULES = {_module(path): path for path in FILES}


def _leans_on(path: Path) -> set[Path]:
    """The files that a file imports, at any depth of a function; the face aside."""
    found = set()
    for name in _imports(path):
        parts = name.replace("pamid_cli", "cli").split(".")
        for length in range(len(parts), 1, -1):
            if ".".join(parts[:length]) in MODULES:
                found.add(MODULES[".".join(parts[:length])])
                break
    return found - {path}


INSIDE = [path for path in FILES if _name(path) not in FACES]


def test_imports_point_down() -> None:
    up = [
        f"{_name(path)} imports {_name(other)}"
        for path in INSIDE
        for other in _leans_on(path)
        if _room(other) != _room(path) and _floor(_room(other)) >= _floor(_room(path))
    ]
    assert not up, f"what is imported does not lie below: {up}"


def test_no_circles_between_files() -> None:
    arrows = {path: _leans_on(path) for path in FILES}
    while arrows:
        free = [path for path, below in arrows.items() if not below & arrows.keys()]
        assert free, f"these import each other in a circle: {sorted(map(_name, arrows))}"
        for path in free:
            del arrows[path]


def test_nobody_inside_imports_the_face() -> None:
    faces = {_module(ROOT / face) for face in FACES}
    found = [
        f"{_name(path)} imports {name}"
        for path in INSIDE
        for name in _imports(path)
        if name in faces
        or name.rpartition(".")[0] in faces
        and name not in MODULES
        and not any(module.startswith(f"{name}.") for module in MODULES)
    ]
    assert not found, f"import the module that defines it: {found}"


def test_heavy_packages_stay_at_home() -> None:
    away = [
        f"{_name(path)} imports {package}"
        for path in FILES
        for package in {name.split(".")[0] for name in _imports(path)} & HOMES.keys()
        if not _name(path).startswith(HOMES[package])
    ]
    assert not away, f"their home is elsewhere: {away}"


def test_pysindy_lives_in_one_file() -> None:
    users = [
        _name(path)
        for path in FILES
        if any(name.split(".")[0] == "pysindy" for name in _imports(path))
    ]
    assert len(users) <= 1, users


def test_commands_import_heavy_packages_only_when_called() -> None:
    early = [
        f"{_name(path)} imports {package}"
        for path in FILES
        if _room(path) == "cli"
        for package in {name.split(".")[0] for name in _imports(path, top_only=True)} & {*HEAVY}
    ]
    assert not early, f"import inside the function: {early}"


def test_package_list_equals_the_folders() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]["packages"]
    folders = {
        path.parent.relative_to(ROOT).as_posix().replace("/", ".")
        for path in FILES
        if path.is_file()
    }
    assert sorted(listed) == sorted("pamid_cli" if name == "cli" else name for name in folders)


def test_version_is_the_same_everywhere() -> None:
    from importlib.metadata import version

    import pamid

    assert version("pamid") == pamid.__version__
    assert f"\nversion: {pamid.__version__}\n" in (ROOT / "CITATION.cff").read_text(
        encoding="utf-8"
    )


def test_the_face_loads_nothing_heavy() -> None:
    code = (
        f"import sys, pamid; print([m for m in {(*HOMES, 'scipy', 'sympy')!r} if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
