"""What the gate before a fit costs: CPU seconds of the blocking checks and of the search for shared
samples.

    python benchmarks/gate.py

100 000 samples of the joint with all seven channels; 1 000 000 samples of two channels in two
recordings; 200 recordings of 5000 samples. Last: how many recordings of the trial's own machines
the gate stops (it should stop none).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pamid.checks.recording_quality import blocking
from pamid.excitation.aprbs import aprbs
from pamid.model.registry import rig_named
from pamid.recording.overlap import overlaps
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.virtual_rig import simulate_virtual_rig
from pamid.trial.case_machine import CaseMachine
from pamid.trial.cases import draw_cases

PERIOD_S = 0.003


def seconds(work: Callable[[], Any], repeats: int = 3) -> float:
    """The least CPU time of some runs; the first one compiles, as the fit would."""
    work()
    taken = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        taken.append(time.process_time() - begun)
    return min(taken)


def joint(folder: Path, samples: int) -> Recording:
    reference = aprbs(samples * PERIOD_S, PERIOD_S, 35.0, seed=1)[:samples]
    stamps = PERIOD_S * np.arange(samples)
    write_recording(folder / "sent.csv", stamps, {"reference_deg": reference})
    made = simulate_virtual_rig("one-dof", read_recording(folder / "sent.csv"), (), {}, {}, 1.0, 1)
    write_recording(folder / "rec.csv", stamps, made.columns, made.meta)
    return read_recording(folder / "rec.csv")


def noisy(samples: int, seed: int) -> Recording:
    random, stamps = np.random.default_rng(seed), PERIOD_S * np.arange(samples)
    columns = {
        name: np.round(30.0 * np.sin(2.0 * stamps) + random.standard_normal(samples), 6)
        for name in ("angle_deg", "pressure_1_kpa")
    }
    return Recording(f"r{seed}", Path(f"r{seed}.csv"), str(seed), stamps, columns, PERIOD_S)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--cases",
        type=int,
        default=40,
        help="recordings of the trial's joint to put before the gate",
    )
    cases = parser.parse_args().cases
    rig, outputs = rig_named("one-dof"), ("angle_deg", "pressure_1_kpa")
    with tempfile.TemporaryDirectory() as place:
        recording = joint(Path(place), 100_000)
        print(
            "blocking checks, 100000 samples, 7 channels: "
            f"{seconds(lambda: blocking(recording, rig)):.3f} s CPU"
        )
        names = tuple(rig.outputs)
        halves = [replace(recording.slice(a, a + 50_000), sha256=str(a)) for a in (0, 50_000)]
        print(
            "shared samples, the same in two halves: "
            f"{seconds(lambda: list(overlaps(names, halves))):.3f} s CPU"
        )
        for what, recordings in (
            ("2 recordings of 1000000 samples, 2 channels", [noisy(1_000_000, k) for k in (1, 2)]),
            ("200 recordings of 5000 samples", [noisy(5000, k) for k in range(200)]),
        ):
            print(
                f"shared samples, {what}: "
                f"{seconds(lambda r=recordings: list(overlaps(outputs, r)), 2):.3f} s CPU"
            )
        stopped = 0
        for case in draw_cases("calibration", cases, 901, "one-dof"):
            made = CaseMachine.of(case).recording(case.planted, Path(place) / "case.csv")
            stopped += bool(blocking(made, rig))
        print(f"recordings of the trial's joint that the gate stops: {stopped} of {cases}")


if __name__ == "__main__":
    main()
