"""Digests of what pamid makes of the example data: runs, fits, exports and pages.

Taken before a change that is to leave behaviour as it was, and compared after it, on the same
machine: results round differently between processors.

    python benchmarks/digests.py --output before.txt
    python benchmarks/digests.py --output after.txt && diff before.txt after.txt

run.json (clocks, paths) and what names it are left out; so are PNG and GIF pictures made of
compressed pixels only where --pixels is not given, because a font that differs moves them.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

#: one working folder for all: a later command reads what an earlier one wrote
COMMANDS = """
generate-aprbs --rig one-dof --duration 20 --amplitude 30 --hold 0.4 1.6 --seed 1 --output excitation.csv
generate-aprbs --rig one-dof --duration 20 --signal multisine --seed 1 --output multisine.csv
simulate --rig one-dof --excitation excitation.csv --effect coulomb-friction --noise default --seed 2 --output rec.csv
simulate --rig one-dof --excitation excitation.csv --effect dead-time:delay_s=0.03 --noise none --seed 2 --output late.csv
ingest --guess DATA/bench_log.csv --pressures gauge --output map.toml
check rec.csv --json
check DATA/joint.csv --json
effects --json
effects coulomb-friction
rigs two-link
schema
config --json
fit rec.csv --rig one-dof --seed 1 --jobs 2 --output fit
fit rec.csv --rig one-dof --effect coulomb-friction --seed 1 --output fit-friction
train-residual fit --network narx --hidden 4 --iterations 15 --starts 1 --seed 1
report fit
export fit-friction --to c --output c
export fit-friction --to fmu2 --output model2.fmu
export fit-friction --to fmu3 --output model3.fmu
export fit-friction --to matlab --output model.m
export fit-friction --to onnx --output model.onnx
simulate --model fit-friction --excitation multisine.csv --noise none --output replayed.csv
force-law DATA/muscle_map.csv --seed 1 --output law
diagnose DATA/joint.csv --seed 1 --jobs 2 --output run
report run
train-residual run --network anfis --iterations 5 --starts 1 --seed 1
report run --output second.html
trial --part test --seed 3 --cases 1 --output trial
report trial
""".strip().splitlines()  # noqa: E501
PIXELS = (".png", ".gif")


def digests(folder: Path, pixels: bool) -> list[str]:
    """One line for each printed text and each file, in the order in which they are made."""
    lines: list[str] = []
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "COLUMNS": "120",
    }
    for command in COMMANDS:
        words = command.replace("DATA", str(ROOT / "data" / "example")).split()
        done = subprocess.run(
            [sys.executable, "-m", "pamid_cli", *words],
            cwd=folder,
            env=environment,
            capture_output=True,
            check=False,
        )
        said = done.stdout.replace(str(ROOT).encode(), b"ROOT")
        lines.append(f"{hashlib.sha256(said).hexdigest()[:16]}  {done.returncode}  pamid {command}")
        print(lines[-1], flush=True)
        if done.returncode:
            print(done.stderr.decode(errors="replace")[-600:], file=sys.stderr)
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != "run.json" and (pixels or path.suffix not in PIXELS):
            data = _timeless(path, path.read_bytes().replace(str(ROOT).encode(), b"ROOT"))
            lines.append(
                f"{hashlib.sha256(data).hexdigest()[:16]}  {path.relative_to(folder).as_posix()}"
            )
    return lines


def _timeless(path: Path, data: bytes) -> bytes:
    """Pages and exports name the moment and the folder in which they were made."""
    if path.suffix in (".html", ".json", ".c", ".h", ".m", ".csv"):
        data = re.sub(
            rb"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}(:\d{2}(\.\d+)?)?(Z|\+00:00)?", b"TIME", data
        )
        data = re.sub(rb"/tmp/[A-Za-z0-9_./-]*", b"FOLDER", data)
    return data


if __name__ == "__main__":
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--output", type=Path, required=True, help="text file for the list")
    options.add_argument("--pixels", action="store_true", help="pictures, too")
    options.add_argument("--keep", type=Path, help="work in this folder and keep it")
    given = options.parse_args()
    if given.keep:
        given.keep.mkdir(parents=True)
        found = digests(given.keep.resolve(), given.pixels)
    else:
        with tempfile.TemporaryDirectory(prefix="pamid-digests-") as place:
            found = digests(Path(place), given.pixels)
    given.output.write_text("\n".join(found) + "\n")
