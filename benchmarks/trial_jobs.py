"""What a second process is worth to `pamid trial`, beside what it can be worth on this machine.

    python benchmarks/trial_jobs.py --cases 8 --repeats 3

Everything stands in one table of one run, medians over the repeats, seconds on the clock:

- the trial with --jobs 1 and with --jobs 2, each as a command of its own into a fresh folder;
- its processor seconds: where --jobs 2 spends more of them for the same cases, the processes are in
  each other's way (shared caches, memory, clock rate, hardware threads);
- the ceiling: one diagnosis, nothing but computing, in one process and at the same time in two
  (each has a case to itself and begins when both are warm). Two cores that share nothing reach 2;
  no way of handing out jobs gets further;
- the tail: how much longer than half of all the work the best order of these cases would take,
  since a case is not divided. Longer trials have next to none.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ONE_BLAS_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}
PURE = """
import sys, time
from pathlib import Path
from tempfile import mkdtemp
from pamid.trial.cases import draw_cases
from pamid.api.trial_cases import examine
case = draw_cases("calibration", int(sys.argv[1]) + 1, int(sys.argv[2]))[-1]
examine(case, Path(mkdtemp(dir=sys.argv[3])))      # compiles
print("warm", flush=True)
sys.stdin.readline()
begun, spent = time.perf_counter(), time.process_time()
examine(case, Path(mkdtemp(dir=sys.argv[3])))
print(time.perf_counter() - begun, time.process_time() - spent, flush=True)
"""


def trial(jobs: int, options: argparse.Namespace) -> tuple[float, float, list[float]]:
    """Seconds on the clock, processor seconds, and those of every case's diagnosis."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as place:
        words = [
            sys.executable,
            "-m",
            "pamid_cli",
            "trial",
            "--part",
            "calibration",
            "--seed",
            str(options.seed),
            "--cases",
            str(options.cases),
            "--jobs",
            str(jobs),
            "--output",
            f"{place}/trial",
            "--json",
        ]
        begun = time.perf_counter()
        done = subprocess.run(
            words, capture_output=True, text=True, env={**os.environ, **ONE_BLAS_THREAD}
        )
        seconds = time.perf_counter() - begun
        if done.returncode not in (0, 6):
            raise SystemExit(done.stderr)
        results = [
            json.loads(p.read_text()) for p in sorted(Path(place, "trial", "cases").iterdir())
        ]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, spent, [r["seconds"] for r in results if not r["failed"]]


def together(copies: int, options: argparse.Namespace) -> tuple[float, float]:
    """Seconds on the clock and processor seconds of one diagnosis, mean over copies that run at the
    same time."""
    with tempfile.TemporaryDirectory() as place:
        words = [sys.executable, "-c", PURE, str(options.case), str(options.seed), place]
        running = [
            subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, **ONE_BLAS_THREAD},
            )
            for _ in range(copies)
        ]
        for process in running:
            assert process.stdout is not None and process.stdout.readline() == "warm\n"
        for process in running:
            assert process.stdin is not None
            process.stdin.write("go\n")
            process.stdin.flush()
        found = [[float(x) for x in process.communicate()[0].split()] for process in running]
    return statistics.mean(f[0] for f in found), statistics.mean(f[1] for f in found)


def best_order(seconds: list[float], count: int = 2) -> float:
    """Length of the schedule that takes the longest first, over half of all the work."""
    ends = [0.0] * count
    for s in sorted(seconds, reverse=True):
        ends[ends.index(min(ends))] += s
    return max(ends) / (sum(seconds) / count)


def measured(options: argparse.Namespace) -> dict[str, Any]:
    rounds = []
    for _ in range(options.repeats):
        one, two = trial(1, options), trial(2, options)
        alone, beside = together(1, options), together(2, options)
        rounds.append(
            {
                "jobs_1_s": one[0],
                "jobs_2_s": two[0],
                "ratio": one[0] / two[0],
                "jobs_1_cpu_s": one[1],
                "jobs_2_cpu_s": two[1],
                "alone_s": alone[0],
                "beside_s": beside[0],
                "ceiling": 2.0 * alone[0] / beside[0],
                "alone_cpu_s": alone[1],
                "beside_cpu_s": beside[1],
                "tail": best_order(one[2]),
            }
        )
        print(
            json.dumps({k: round(v, 3) for k, v in rounds[-1].items()}), file=sys.stderr, flush=True
        )
    return {k: statistics.median(r[k] for r in rounds) for k in rounds[0]}


def main() -> None:
    asked = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    asked.add_argument("--cases", type=int, default=8, help="cases of the trial")
    asked.add_argument(
        "--case", type=int, default=0, help="number of the case that the ceiling is measured on"
    )
    asked.add_argument("--repeats", type=int, default=3)
    asked.add_argument("--seed", type=int, default=1)
    options = asked.parse_args()
    m = measured(options)
    print(f"pamid trial, {options.cases} cases, medians of {options.repeats}")
    print(f"  --jobs 1            {m['jobs_1_s']:8.1f} s   {m['jobs_1_cpu_s']:8.1f} s processor")
    print(f"  --jobs 2            {m['jobs_2_s']:8.1f} s   {m['jobs_2_cpu_s']:8.1f} s processor")
    print(f"  ratio               {m['ratio']:8.2f}")
    print(f"one diagnosis, case {options.case}")
    print(f"  alone               {m['alone_s']:8.1f} s   {m['alone_cpu_s']:8.1f} s processor")
    print(f"  two at once, each   {m['beside_s']:8.1f} s   {m['beside_cpu_s']:8.1f} s processor")
    print(f"  ceiling             {m['ceiling']:8.2f}")
    print(
        f"ratio over ceiling    {m['ratio'] / m['ceiling']:8.2f}   (undivided cases alone: "
        f"{1.0 / m['tail']:.2f})"
    )


if __name__ == "__main__":
    main()
