"""One name, one thing: classes, files and constants that are found by search are found alone."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
    for room in ("pamid", "cli")
    for path in sorted((ROOT / room).rglob("*.py"))
}

#: what a folder's files say of themselves, each in one name, by which the folder is scanned
SCANNED = {
    "EXAMPLE": "cli/",
    "PLACE": "cli/",
    "KIND": "pamid/ingest/readers/",
    "MODEL_KIND": "pamid/simulators/kinds/",
    "FORM": "pamid/export/forms/",
    "OPTIONS": "pamid/replications/papers/",
    "MACHINE": "pamid/trial/machines/",
}
#: scanned folders whose files are named as users name them: MATLAB is read and written, a rig has a
#: machine in the trial
NAMED_BY_USERS = (
    "pamid/export/forms/",
    "pamid/ingest/readers/",
    "pamid/rigs/",
    "pamid/trial/machines/",
)

Places = dict[str, dict[str, str]]  # name -> where -> what stands there


def _several(found: dict[str, dict[str, str]]) -> dict[str, list[str]]:
    return {name: sorted(places) for name, places in found.items() if len(places) > 1}


def classes(sources: dict[str, ast.Module]) -> dict[str, list[str]]:
    """Names that several classes bear, with their files."""
    found: Places = defaultdict(dict)
    for file, tree in sources.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found[node.name][f"{file}:{node.lineno}"] = ""
    return _several(found)


def modules(files: list[str]) -> dict[str, list[str]]:
    """Names that several files bear, other than one in each of the folders named by users."""
    found: Places = defaultdict(dict)
    for file in files:
        if not file.endswith("/__init__.py"):
            found[Path(file).stem][file] = ""
    return {
        name: places
        for name, places in _several(found).items()
        if not all(place.startswith(NAMED_BY_USERS) for place in places)
    }


def constants(sources: dict[str, ast.Module]) -> dict[str, list[str]]:
    """Names in capitals at the head of files that stand for several values.

    Indices that unpack a range are those of one file's compiled arrays; type variables are named
    as everywhere.
    """
    found: Places = defaultdict(lambda: defaultdict(str))
    for file, tree in sources.items():
        for name, value in _assigned(tree):
            if not name.strip("_").isupper() or file.startswith(SCANNED.get(name, "nowhere")):
                continue
            if isinstance(value, ast.Call) and ast.unparse(value.func) in ("TypeVar", "range"):
                continue
            found[name][ast.unparse(value)] += file
    return {
        name: [f"{value} in {file}" for value, file in values.items()]
        for name, values in found.items()
        if len(values) > 1
    }


def _assigned(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    for node in tree.body:
        if isinstance(node, ast.AnnAssign):
            targets, value = [node.target], node.value
        elif isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        else:
            continue
        for target in targets:
            if isinstance(target, ast.Name) and value is not None:
                yield target.id, value
            elif isinstance(target, ast.Tuple):
                many = value.elts if isinstance(value, ast.Tuple) else [value] * len(target.elts)
                for one, part in zip(target.elts, many, strict=True):
                    if isinstance(one, ast.Name) and part is not None:
                        yield one.id, part


def test_no_two_classes_have_one_name() -> None:
    assert classes(SOURCES) == {}


def test_no_two_files_have_one_name() -> None:
    assert modules(list(SOURCES)) == {}


def test_no_constant_has_two_values() -> None:
    assert constants(SOURCES) == {}


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("LIMIT = 1", "LIMIT = 2", ["LIMIT"]),
        ("LIMIT: int = 1", "LOW, LIMIT = 0, 3", ["LIMIT"]),
        ("LIMIT = 1", "LIMIT = 1", []),
        ("A, B = range(2)", "B, A = range(2)", []),
        ("T = TypeVar('T')", "T = TypeVar('T', bound=int)", []),
        ("EXAMPLE = 'one'", "EXAMPLE = 'two'", ["EXAMPLE"]),
    ],
)
def test_constants_of_one_name_are_found(first: str, second: str, expected: list[str]) -> None:
    found = constants({"pamid/a.py": ast.parse(first), "pamid/b.py": ast.parse(second)})
    assert list(found) == expected


def test_classes_and_files_of_one_name_are_found() -> None:
    tree = ast.parse("class One:\n    class Two: ...\n")
    again = ast.parse("class Two: ...\n")
    found = classes({"pamid/a.py": tree, "pamid/b.py": again})
    assert found == {"Two": ["pamid/a.py:2", "pamid/b.py:1"]}
    assert list(modules(["pamid/x/a.py", "cli/a.py", "pamid/__init__.py", "cli/__init__.py"])) == [
        "a"
    ]
    both = [f"{folder}a.py" for folder in NAMED_BY_USERS]
    assert modules(both) == {} and list(modules([*both, "cli/a.py"])) == ["a"]
