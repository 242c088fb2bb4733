"""Peak memory of a diagnosis, with all its worker processes, against the promised bound.

    OMP_NUM_THREADS=1 python benchmarks/memory.py                # the example; 200 s of the joint
    OMP_NUM_THREADS=1 python benchmarks/memory.py --only example

Memory is what the processes of a command occupy together, read four times a second: pages that they
share count once (`Pss` of `/proc/PID/smaps_rollup`; Linux only). `largest` is the largest resident
set of any process so far, as the kernel notes it. Exit code 1 where either exceeds the bound.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import contextlib
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from scale import record

ROOT = Path(__file__).resolve().parents[1]
BOUND_GB = 2.0  # of what README and tutorials run
LONG_SAMPLES = 66_667  # 200 s of the joint at 3 ms
POLL_S = 0.25


def family(process: int) -> list[int]:
    """A process and all that descend from it."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            parents.setdefault(int(fields[1]), []).append(int(entry.name))
    members = [process]
    for member in members:
        members += parents.get(member, [])
    return members


def occupied_gb(processes: list[int]) -> float:
    """Memory of processes together in GB."""
    total = 0
    for process in processes:
        with contextlib.suppress(OSError):
            text = Path(f"/proc/{process}/smaps_rollup").read_text()
            total += sum(int(line.split()[1]) for line in text.splitlines() if line[:4] == "Pss:")
    return total * 1024 / 1e9


def peaks_gb(*words: str) -> tuple[float, float, float, int]:
    """(peak of all processes, of the largest one, GB; seconds; exit code) of `pamid` with these
    arguments."""
    begun, peak = time.monotonic(), 0.0
    command = [sys.executable, "-m", "pamid_cli", *words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL) as running:
        while running.poll() is None:
            peak = max(peak, occupied_gb(family(running.pid)))
            time.sleep(POLL_S)
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    return peak, largest, time.monotonic() - begun, running.returncode


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=["example", "long"])
    parser.add_argument("--jobs", default="2")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        recordings = {"example": ROOT / "data" / "example" / "joint.csv"}
        if asked.only != "example":
            recordings["long"] = record(folder, "one-dof", "long", LONG_SAMPLES, 0)
        print(
            f"{'recording':10s} {'peak GB':>8s} {'largest':>8s} {'bound GB':>9s} {'clock s':>8s} "
            f"{'exit':>5s}"
        )
        exceeded = False
        for name, path in recordings.items():
            if asked.only not in (None, name):
                continue
            output = str(folder / f"run-{name}")
            peak, largest, seconds, code = peaks_gb(
                "diagnose", str(path), "--rig", "one-dof", "--jobs", asked.jobs, "--output", output
            )
            print(
                f"{name:10s} {peak:8.2f} {largest:8.2f} {BOUND_GB:9.2f} {seconds:8.0f} {code:5d}",
                flush=True,
            )
            exceeded |= max(peak, largest) > BOUND_GB
    return int(exceeded)


if __name__ == "__main__":
    sys.exit(main())
