"""Runs every command of the README and of every tutorial as a new user would: an empty environment
(`env -i`), a new home, no `.venv`.

    python tests/support/tutorials.py [--full] [--tests FILE] [NAME ...]

What is called `pamid` comes from a wheel, in a folder with nothing in it but the project's data;
packages that it needs are borrowed from the environment that runs this, with --full they are
installed anew. What is called `make` runs in a copy of the sources and installs everything itself.
`make docs-test` runs it.
"""

import argparse
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "tutorials"
README = ROOT / "README.md"
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


#: what the reader of a page has already, as a page that makes it or as commands
ALREADY: dict[str, tuple[str | Path, ...]] = {
    "README": (
        "pamid generate-aprbs --rig dc-motor --duration 20 --output sent.csv",
        "pamid simulate --rig dc-motor --excitation sent.csv --output rec.csv",
        FOLDER / "own-mujoco-model.md",
        "python robot.py",
        "cp pendulum.xml arm.xml",
    ),
}


#: packages that a page needs and pamid does not, by the page; `pip install` of each in words
NEEDED = {"own-robot": {"airo_models": "pip install --no-deps airo-models"}}


def missing_package(page: Path) -> str:
    """Why a page cannot be run here, "" where it can."""
    for package, command in NEEDED.get(page.stem, {}).items():
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed: {command}"
    return ""


def prepared(page: Path) -> list[Step]:
    """The steps of a page, after those that give its reader what it takes for granted."""
    found: list[Step] = []
    for one in ALREADY.get(page.stem, ()):
        if isinstance(one, Path):
            found += [step for step in steps(one) if step.name]
        else:
            found.append(Step("", one))
    return found + steps(page)


def sources(place: Path) -> Path:
    """A copy of the sources as they are kept: of a working tree without what was built in it."""
    copy = place / "source"
    if not copy.exists():
        left_out = (".git", ".venv", "build", "demo-run", "*.egg-info", ".*_cache", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*left_out))
    return copy


def environment(place: Path, full: bool) -> Path:
    """A new virtual environment with pamid from its wheel; its folder of programs."""
    wheels, venv = place / "wheels", place / "venv"
    pip = [sys.executable, "-m", "pip"]
    quiet = ["--quiet", "--disable-pip-version-check"]
    # of a copy: what lies about in build/ is no part of a wheel
    wheel_of = ["--no-deps", "--no-build-isolation", "-w", wheels, sources(place)]
    subprocess.run([*pip, "wheel", *quiet, *wheel_of], check=True)
    shutil.rmtree(sources(place))  # setuptools builds within it
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


def run(page: Path, programs: Path, place: Path, tests: str = "") -> bool:
    """Go through a page; False where a command fails. One that needs a package which is not
    installed is skipped."""
    if why := missing_package(page):
        print(f"{page.stem}: skipped, {why}", flush=True)
        return True
    work, home = place / page.stem, place / "home"
    work.mkdir()
    home.mkdir(exist_ok=True)  # one for all: what was compiled in it is kept there
    shutil.copytree(ROOT / "data", work / "data")
    for step in prepared(page):
        if step.name:
            (work / step.name).write_text(step.text, encoding="utf-8")
            continue
        made = step.text.startswith("make ")
        command = f"{step.text} TESTS={shlex.quote(tests)}" if made and tests else step.text
        own = Path(sys.base_prefix, "bin") if made else programs
        clean = {"HOME": str(home), "PATH": f"{own}:/usr/bin:/bin", "LANG": "C.UTF-8"}
        # where packages come from is the network's affair, not the user's
        clean |= {name: text for name, text in os.environ.items() if name.startswith("PIP_")}
        if not said_ok(page.stem, command, sources(place) if made else work, clean):
            return False
    return True


def said_ok(title: str, command: str, folder: Path, clean: dict[str, str]) -> bool:
    """Run one command with these variables and no others; tell how it ended."""
    begun = time.monotonic()
    done = subprocess.run(
        ["/bin/bash", "-euo", "pipefail", "-c", command],
        cwd=folder,
        env=clean,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    said = "ok" if done.returncode == 0 else f"exit code {done.returncode}"
    print(f"{title}: {command}\n    {said}, {time.monotonic() - begun:.0f} s", flush=True)
    if done.returncode != 0:
        print(done.stdout + done.stderr)
        return False
    (folder / "said.txt").open("a").write(f"$ {command}\n{done.stdout}\n")
    return True


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument(
        "names", nargs="*", help="README, or tutorials by their files, in this order; default: all"
    )
    asked.add_argument("--tests", default="", help="all that `make test` of the README runs")
    asked.add_argument("--full", action="store_true", help="install what pamid needs anew")
    asked.add_argument("--keep", type=Path, help="a new folder to work in, and to keep")
    given = asked.parse_args()
    # the README last: its tests take longest
    all_pages = {p.stem: p for p in (*sorted(FOLDER.glob("*.md")), README)}
    pages = [all_pages[name] for name in given.names or all_pages]
    with tempfile.TemporaryDirectory() as temporary:
        place = given.keep or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        programs = environment(place, given.full)
        failed = [page.stem for page in pages if not run(page, programs, place, given.tests)]
    print(f"failed: {', '.join(failed)}" if failed else f"{len(pages)} pages run")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
