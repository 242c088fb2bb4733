"""The package list equals the folders, the version is the same everywhere, the face is light."""

import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pamid

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_package_list_equals_the_folders():
    folders = {
        path.parent.relative_to(ROOT).as_posix().replace("/", ".")
        for folder in ("pamid", "cli")
        for path in (ROOT / folder).rglob("*.py")
    }
    listed = PROJECT["tool"]["setuptools"]["packages"]
    assert sorted(listed) == sorted("pamid_cli" if name == "cli" else name for name in folders)


def test_version_is_the_same_everywhere():
    assert version("pamid") == pamid.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {pamid.__version__}\n" in citation


def test_the_face_loads_nothing_heavy():
    heavy = PROJECT["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-module-level-imports"]
    code = f"import sys, pamid; print([m for m in {heavy!r} if m in sys.modules and m != 'pamid'])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
