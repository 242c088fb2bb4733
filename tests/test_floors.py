"""The house stands: imports point down, heavy packages stay at home, the package list equals the folders."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

#: from the ground up; a module (or folder) may import its own floor and those below it
FLOORS: tuple[tuple[str, ...], ...] = (
    ("errors", "schemas", "trust", "files"),
    ("toml_file", "json_file"),
    ("units", "metrics", "expressions", "arrays", "noise"),
    ("run", "parameter", "jobs", "results", "cluster", "equations"),
    ("recording_checks", "recording", "overlap", "excitation", "signals", "excitation_files"),
    ("effect", "rig", "background"),
    ("effects", "rigs"),
    ("library", "attaching", "binding"),
    ("engine",),
    ("tracing",),
    ("assembly", "isolability"),
    ("simulation",),
    ("windows", "weights", "prior"),
    ("fitting", "residuals"),
    ("intervals", "quantities", "restart"),
    ("evidence", "conformance", "catalogue", "virtual", "experiments", "combinations"),
    ("posterior", "quality", "quality_signals", "quality_rig", "quality_scale"),
    ("ingest",),
    ("inspection", "greybox"),
    ("networks",),
    ("leftover", "residual_network", "force_map"),
    ("diagnosis",),
    ("port_network",),
    ("identified",),
    ("trial",),
    ("report", "export"),
    ("force_law_run",),
    ("demo", "papers"),
    ("cli",),
)

#: the only places that may import these, at any depth of a function
HOMES: dict[str, tuple[str, ...]] = {
    "numba": ("pamid/engine/", "pamid/trial/"),
    "llvmlite": ("pamid/engine/",),
    "torch": ("pamid/networks/",),
    "pysindy": ("pamid/diagnosis/",),
    "matplotlib": ("pamid/report/",),
    "pandas": ("pamid/recording.py", "pamid/ingest/"),
    "pint": ("pamid/ingest/",),
    "pydantic": ("pamid/ingest/",),
    "h5py": ("pamid/ingest/",),
    "nptdms": ("pamid/ingest/",),
    "asammdf": ("pamid/ingest/",),
    "rosbags": ("pamid/ingest/",),
    "pyarrow": ("pamid/ingest/",),
    "matio": ("pamid/ingest/",),
    "onnx": ("pamid/export/",),
    "distributed": ("pamid/cluster.py",),
    "click": ("cli/",),
}
HEAVY = ("numba", "llvmlite", "torch", "pysindy", "matplotlib", "pandas", "scipy", "sympy", "sklearn", "numpy", "pamid",
         "pint", "pydantic", "h5py", "nptdms", "asammdf", "rosbags", "pyarrow", "matio", "onnx", "distributed")

FILES = sorted(path for folder in ("pamid", "cli") for path in (ROOT / folder).rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _unit(path: Path) -> str:
    """The entry of FLOORS a file belongs to: its folder, or its own name for a file directly in pamid/."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return "cli" if parts[0] == "cli" else parts[1]


def _imports(path: Path, *, top_only: bool = False) -> Iterator[str]:
    """Full dotted names a file imports (`from pamid import units` counts as pamid.units)."""
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
            if base == "pamid":
                yield from (f"pamid.{alias.name}" for alias in node.names)
            else:
                yield base


def _floor(unit: str) -> int:
    for number, units in enumerate(FLOORS):
        if unit in units:
            return number
    raise AssertionError(f"{unit} stands on no floor: enter it in FLOORS")


def _arrows(path: Path) -> set[str]:
    """The entries of FLOORS that a file leans on, beside its own."""
    dotted = [name.split(".") for name in _imports(path)]
    found = {parts[1] for parts in dotted if parts[0] == "pamid" and len(parts) > 1}
    return found - {_unit(path)}


@pytest.mark.parametrize("path", [path for path in FILES if path.name != "__init__.py" or path.parent.name != "pamid"],
                         ids=_name)
def test_imports_point_down(path: Path) -> None:
    here = _floor(_unit(path))
    up = [other for other in _arrows(path) if _floor(other) > here]
    assert not up, f"{_name(path)} imports {up} from a floor above"


def test_no_circles_between_units() -> None:
    face = ROOT / "pamid" / "__init__.py"
    arrows: dict[str, set[str]] = {}
    for path in FILES:
        if path != face:
            arrows.setdefault(_unit(path), set()).update(_arrows(path))
    while arrows:
        free = [unit for unit, below in arrows.items() if not below & arrows.keys()]
        assert free, f"these import each other in a circle: {sorted(arrows)}"
        for unit in free:
            del arrows[unit]


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_nobody_inside_imports_the_face(path: Path) -> None:
    if path == ROOT / "pamid" / "__init__.py":
        pytest.skip("this is the face")
    modules = {_unit(file) for file in FILES} - {"cli"}
    face = [name for name in _imports(path) if name == "pamid" or
            (name.startswith("pamid.") and name.split(".")[1] not in modules)]
    assert not face, f"{_name(path)} imports {face} from the face; import the module that defines it"


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_heavy_packages_stay_at_home(path: Path) -> None:
    roots = {name.split(".")[0] for name in _imports(path)}
    strangers = [pkg for pkg in roots & HOMES.keys() if not _name(path).startswith(HOMES[pkg])]
    assert not strangers, f"{_name(path)} imports {strangers}, whose home is elsewhere"


def test_pysindy_lives_in_one_file() -> None:
    users = [_name(path) for path in FILES if any(name.split(".")[0] == "pysindy" for name in _imports(path))]
    assert len(users) <= 1, users


@pytest.mark.parametrize("path", [path for path in FILES if _unit(path) == "cli"], ids=_name)
def test_commands_import_heavy_packages_only_when_called(path: Path) -> None:
    early = {name.split(".")[0] for name in _imports(path, top_only=True)} & set(HEAVY)
    assert not early, f"{_name(path)} imports {early} at the top; import inside the function"


def test_package_list_equals_the_folders() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT).as_posix().replace("/", ".") for path in FILES if path.is_file()}
    assert sorted(listed) == sorted("pamid_cli" if name == "cli" else name for name in folders)


def test_version_is_the_same_everywhere() -> None:
    from importlib.metadata import version

    import pamid

    assert version("pamid") == pamid.__version__
    assert f"\nversion: {pamid.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_face_loads_nothing_heavy() -> None:
    code = f"import sys, pamid; print([m for m in {(*HOMES, 'scipy', 'sympy')!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_files_and_functions_stay_short(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 350, f"{_name(path)} is longer than 350 lines"
    long = [node.name for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.body[0].lineno > 60]
    assert not long, f"{_name(path)}: functions above 60 lines: {long}"
