"""What a person waits for, in CPU seconds: help, reading, checking, the stories, a page until it is
ready.

    python benchmarks/waiting.py [--stories]

Medians of several calls, each with the first, uncounted one before it. Beside every figure stands
that of a peer in the same run (pandas for reading; an empty Python process for whole commands),
since machines differ: the ratio is what can be compared. `--stories` runs the stories, a minute or
more.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

from browser import CHROMIUM, browser
from synthetic_run import make_run
from timing import cpu

from pamid.intake.checks.recording_quality import examine
from pamid.intake.logs.log_reader import read_log
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.report.writing import write_report

ROOT = Path(__file__).resolve().parent.parent
PERIOD_S, LONG = 0.003, 66_667  # of the residual that the page shows
SECONDS = PERIOD_S * LONG


def long_residual() -> dict[str, np.ndarray]:
    """A measured angle with noise, and three models."""
    random, time = np.random.default_rng(1), PERIOD_S * np.arange(LONG)
    shape = np.sin(0.9 * time) + 0.4 * np.sin(2.3 * time) + 0.3 * np.sign(np.sin(0.37 * time))
    gap = np.tanh(8.0 * np.cos(0.9 * time))
    return {
        "time_s": time,
        "recording": 0 * time,
        "part": 1 * (time >= 140.0),
        "window": np.where(np.arange(LONG) % 767 < 115, -1, np.arange(LONG) // 767),
        "angle_deg": 20.0 * shape + random.normal(0.0, 0.03, LONG),
        "angle_data_sheet_deg": 18.6 * shape + gap,
        "angle_refitted_deg": 20.0 * shape + 0.5 * gap,
        "angle_cause_deg": 20.0 * shape + 0.1 * gap,
    }


def process(*words: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True)


def row(what: str, seconds: float, peer: str, beside: float) -> None:
    print(f"{what:58s} {seconds:8.3f} s {seconds / beside:8.1f} x {peer}", flush=True)


def page_ready_s(folder: Path) -> float:
    """Seconds by the browser's own clock until the plots of four long traces stand."""
    run = make_run(folder / "RUN", without=("residual.csv",))
    columns = long_residual()
    np.savetxt(
        run / "residual.csv",
        np.stack(list(columns.values()), axis=1),
        delimiter=",",
        fmt="%.9g",
        header=",".join(columns),
        comments="",
    )
    page, times = write_report(run).page, []
    with browser() as opened:
        for _ in range(5):
            tab = opened.page()
            tab.open(page)
            times.append(tab.evaluate("pamidReady") / 1000.0)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--stories", action="store_true", help="run the stories of notebooks/, too")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, random = Path(name), np.random.default_rng(0)
        empty = cpu(process("-c", "pass"))
        row("pamid --help", cpu(process("-m", "pamid_cli", "--help")), "an empty Python", empty)

        path = folder / "long.csv"
        write_recording(
            path,
            PERIOD_S * np.arange(LONG),
            {f"x{i}_deg": random.standard_normal(LONG) for i in range(7)},
        )
        pandas = cpu(lambda: pd.read_csv(path))
        row(
            f"reading a recording of {LONG} samples, seven channels",
            cpu(lambda: read_recording(path)),
            "pandas",
            pandas,
        )
        log = folder / "log.csv"
        log.write_text(path.read_text().replace(",", ";").replace(".", ","))
        row(
            "reading it as a foreign log with decimal commas",
            cpu(lambda: read_log(log)),
            "pandas",
            pandas,
        )
        joint = read_recording(ROOT / "data" / "example" / "joint.csv")
        rig = rig_named("one-dof")
        row(
            f"checking the example ({len(joint)} samples, {len(joint.columns)} channels)",
            cpu(lambda: examine(joint, rig)),
            "pandas",
            cpu(lambda: pd.read_csv(joint.path)),
        )
        if CHROMIUM:
            ready = page_ready_s(folder)
            print(
                f"{'a page of four long traces until its plots stand':58s} {ready:8.3f} s by the "
                "clock"
            )
        for story in sorted((ROOT / "notebooks").glob("*.py")) if wanted.stories else ():
            own = {**os.environ, "TMPDIR": str(folder)}
            took = cpu(
                lambda story=story, own=own: subprocess.run(  # type: ignore[misc]
                    [sys.executable, str(story)],
                    cwd=folder,
                    env=own,
                    check=True,
                    capture_output=True,
                ),
                repeats=1,
                warm=False,
            )
            row(f"notebooks/{story.name}", took, "an empty Python", empty)


if __name__ == "__main__":
    main()
