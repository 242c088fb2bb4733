"""Runs every command of every tutorial as a new user would: pamid from a wheel, an empty
environment (`env -i`), a new home, a folder with nothing in it but the project's data.

    python tests/support/tutorials.py [--full] [NAME ...]

Packages that pamid needs are borrowed from the environment that runs this; with --full they are
installed anew. `make docs-test` runs it.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "tutorials"
LIMIT_S = 1800.0  # of one command
_BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S)


@dataclass(frozen=True)
class Step:
    """A file to write (`name` and its text), or a command to run (`name` empty)."""

    name: str
    text: str


def steps(page: Path) -> list[Step]:
    """What a tutorial asks of its reader, in order."""
    found = []
    for language, name, text in _BLOCK.findall(page.read_text(encoding="utf-8")):
        if name:
            found.append(Step(name, text))
        elif language == "sh":
            found += [Step("", line) for line in text.splitlines() if line.strip()]
    return found


def environment(place: Path, full: bool) -> Path:
    """A new virtual environment with pamid from its wheel; its folder of programs."""
    wheels, venv = place / "wheels", place / "venv"
    pip = [sys.executable, "-m", "pip"]
    quiet = ["--quiet", "--disable-pip-version-check"]
    # of a copy: what lies about in build/ is no part of a wheel
    source = place / "source"
    shutil.copytree(
        ROOT, source, ignore=shutil.ignore_patterns(".git", ".venv", "build", "*.egg-info")
    )
    subprocess.run(
        [*pip, "wheel", *quiet, "--no-deps", "--no-build-isolation", "-w", wheels, source],
        check=True,
    )
    (wheel,) = wheels.glob("pamid-*.whl")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    into = [*pip, "--python", venv / "bin" / "python", "install", *quiet]
    if full:
        constraints = ["-c", str(ROOT / "constraints.txt")]
        subprocess.run([*into, *constraints, f"{wheel}[mujoco]"], check=True)
    else:
        subprocess.run([*into, "--no-deps", wheel], check=True)
        (site,) = (venv / "lib").glob("python*/site-packages")
        borrowed = [p for p in sys.path if p.endswith("site-packages")]
        (site / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    return venv / "bin"


def run(page: Path, programs: Path, place: Path) -> bool:
    """Go through a tutorial; False where a command fails."""
    work, home = place / page.stem, place / "home"
    work.mkdir()
    home.mkdir(exist_ok=True)  # one for all: what was compiled in it is kept there
    shutil.copytree(ROOT / "data", work / "data")
    clean = {"HOME": str(home), "PATH": f"{programs}:/usr/bin:/bin", "LANG": "C.UTF-8"}
    for step in steps(page):
        if step.name:
            (work / step.name).write_text(step.text, encoding="utf-8")
            continue
        begun = time.monotonic()
        done = subprocess.run(
            ["/bin/bash", "-euo", "pipefail", "-c", step.text],
            cwd=work,
            env=clean,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
        )
        said = "ok" if done.returncode == 0 else f"exit code {done.returncode}"
        print(f"{page.stem}: {step.text}\n    {said}, {time.monotonic() - begun:.0f} s", flush=True)
        if done.returncode != 0:
            print(done.stdout + done.stderr)
            return False
        (work / "said.txt").open("a").write(f"$ {step.text}\n{done.stdout}\n")
    return True


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument(
        "names", nargs="*", help="tutorials by their files, in this order; default: all"
    )
    asked.add_argument("--full", action="store_true", help="install what pamid needs anew")
    asked.add_argument("--keep", type=Path, help="a new folder to work in, and to keep")
    given = asked.parse_args()
    all_pages = {p.stem: p for p in sorted(FOLDER.glob("*.md"))}
    pages = [all_pages[name] for name in given.names or all_pages]
    with tempfile.TemporaryDirectory() as temporary:
        place = given.keep or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        programs = environment(place, given.full)
        failed = [page.stem for page in pages if not run(page, programs, place)]
    print(f"failed: {', '.join(failed)}" if failed else f"{len(pages)} tutorials run")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
