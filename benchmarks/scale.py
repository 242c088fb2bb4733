"""Peak memory, CPU and open files of whole commands on very long recordings and on very many of
them.

    OMP_NUM_THREADS=1 python benchmarks/scale.py --samples 1000000               # check, fit
    OMP_NUM_THREADS=1 python benchmarks/scale.py --samples 1000000 --diagnose    # and a diagnosis:
    about 20 minutes OMP_NUM_THREADS=1 python benchmarks/scale.py --recordings 200 --diagnose     #
    of 4 s each, of the cart OMP_NUM_THREADS=1 python benchmarks/scale.py --recordings 200 --rig
    one-dof

Every command is a process of its own, `--jobs 1`. Peak memory is its largest resident set as the
kernel notes it, CPU its own seconds; open files are looked at ten times a second. The joint has
seven channels at 3 ms.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import contextlib
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

CART = Path(__file__).resolve().parents[1] / "data" / "rigs" / "cart.py"
PERIOD_S = {"one-dof": 0.003, str(CART): 0.01}
EFFECT = {"one-dof": "coulomb-friction:torque_n_m=0.4", str(CART): "coulomb-friction"}
SHORT = {"one-dof": 1000, str(CART): 420}  # samples of one of many


@dataclass(frozen=True)
class Spent:
    """Of one process. memory in GB, CPU and clock in s."""

    memory_gb: float
    cpu_s: float
    clock_s: float
    files: int
    code: int


def spent_on(*words: str) -> Spent:
    """`pamid` with these arguments in a process of its own."""
    begun, most = time.monotonic(), 0
    child = os.posix_spawn(
        sys.executable,
        [sys.executable, "-m", "pamid_cli", *words],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)],
    )
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            break
        with contextlib.suppress(OSError):
            most = max(most, len(os.listdir(f"/proc/{child}/fd")))
        time.sleep(0.1)
    return Spent(
        used.ru_maxrss / 1e6,
        used.ru_utime + used.ru_stime,
        time.monotonic() - begun,
        most,
        os.waitstatus_to_exitcode(status),
    )


def record(folder: Path, rig: str, name: str, samples: int, seed: int) -> Path:
    """A virtual recording of so many samples with friction that the model lacks."""
    period, path = PERIOD_S[rig], folder / f"{name}.csv"
    closed = rig == "one-dof"
    sent = aprbs(
        samples * period,
        period,
        40.0 if closed else 4.0,
        (0.4, 1.6) if closed else (0.1, 0.4),
        seed=seed,
    )
    write_recording(
        path, period * np.arange(len(sent)), {"reference_deg" if closed else "force_n": sent}
    )
    made = simulate_virtual_rig(
        rig,
        read_recording(path),
        (EFFECT[rig],),
        {},
        {"scale": 1.1} if closed else {"mass_kg": 1.2},
        1.0,
        seed,
    )
    write_recording(path, period * np.arange(len(sent)), made.columns, made.meta)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, help="Of one long recording of the joint.")
    parser.add_argument("--recordings", type=int, help="So many short ones.")
    parser.add_argument(
        "--rig", choices=["cart", "one-dof"], default="cart", help="Of many recordings."
    )
    parser.add_argument("--diagnose", action="store_true")
    asked = parser.parse_args()
    rig = "one-dof" if asked.samples or asked.rig == "one-dof" else str(CART)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        count, samples = (
            (1, asked.samples) if asked.samples else (asked.recordings or 200, SHORT[rig])
        )
        paths = [str(record(folder, rig, f"rec-{k}", samples, k)) for k in range(count)]
        rows = {
            "check": ("check", paths[0], "--rig", rig),
            "fit": ("fit", *paths, "--rig", rig, "--output", str(folder / "fit")),
        }
        if asked.diagnose:
            rows["diagnose"] = (
                "diagnose",
                *paths,
                "--rig",
                rig,
                "--jobs",
                "1",
                "--output",
                str(folder / "run"),
            )
        print(f"{count} recordings of {samples} samples, rig {Path(rig).stem}")
        print(
            f"{'command':10s} {'peak GB':>9s} {'CPU s':>9s} {'clock s':>9s} {'open files':>11s} "
            f"{'exit':>5s}"
        )
        for name, words in rows.items():
            s = spent_on(*words)
            print(
                f"{name:10s} {s.memory_gb:9.2f} {s.cpu_s:9.1f} {s.clock_s:9.1f} {s.files:11d} "
                f"{s.code:5d}",
                flush=True,
            )


if __name__ == "__main__":
    main()
