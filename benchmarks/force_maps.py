"""Measured force maps of fluidic muscles against the ideal braid law: where is the gap, what
shrinks it, how far?

    python benchmarks/force_maps.py [--data ../shared/data] [--only plateaus pooled logs map]
    [--jobs 2]

The recordings lie beside the project; they are turned into recordings of the user rig
data/rigs/muscle_bench.py:
    plateaus  10 mm muscle, six lengths x four contractions; the first of three repeats is fitted,
              the last held out
    pooled    the same as if the six specimens were one muscle: no end factor in the rig
    logs      10 mm muscle, 200 mm long, the samples themselves at four contractions; the second
              repeat is held out
    map       20 mm muscle, 6 contractions x 21 pressures; every third pressure is held out
Every point of a table is held for some samples, so that windows hold several points. Prints per
case the verdict, the port, the ranking, the held-out error before and after (RMS, N), and whether
hysteresis is among the causes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pamid.base.arrays import Array
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.replay import Replay

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
RIG = ROOT / "data" / "rigs" / "muscle_bench.py"

LEAST_N = -8.735  # where the load cell of the 10 mm bench bottoms out
PERIOD_S = 0.02  # sampling of what comes from a table, which has no clock of its own
# samples that a plateau, a point of the map is held: 400 make a recording
HOLD, MAP_HOLD = 9, 12
LOG_STEP = 10  # samples averaged into one


@dataclass(frozen=True)
class Outcome:
    """diagnosis.json of a case and its held-out error in N, refitted braid law and with the
    causes."""

    found: dict[str, Any]
    before: float
    after: float

    @property
    def hysteresis(self) -> list[str]:
        return [c["effect"] for c in self.found["causes"] if "hysteresis" in c["family"]]


def _recorded(
    target: Path,
    period: float,
    pressure: Array,
    contraction: Array,
    force: Array,
    known: dict[str, float],
) -> Recording:
    """Inputs act from their sample to the next, so a force measured with them is what they lead to
    a sample later."""
    write_recording(
        target,
        period * np.arange(len(force) - 1),
        {"pressure_kpa": pressure[1:], "contraction": contraction[1:], "force_n": force[:-1]},
        {"recording": {"loop": "open"}, "known": known},
    )
    return read_recording(target)


def plateaus(data: Path, folder: Path, **known: float) -> tuple[list[Recording], list[Recording]]:
    """One recording per run of the 10 mm muscles: every plateau at its mean, with the scatter
    recorded for it."""
    table = pd.read_csv(data / "mckibben_10mm_isometric" / "plateaus.csv")
    first, last = table["test"].min(), table["test"].max()
    random = np.random.default_rng(0)
    fitted: list[Recording] = []
    held_out: list[Recording] = []
    for (length, strain, test), run in table[table["test"].isin((first, last))].groupby(
        ["rest_length_m", "strain", "test"]
    ):
        scatter = np.repeat(run["force_std_N"].to_numpy(), HOLD) * random.standard_normal(
            HOLD * len(run)
        )
        force = np.maximum(np.repeat(run["force_N"].to_numpy(), HOLD) + scatter, LEAST_N)
        pressure = np.repeat(run["pressure_kPa"].to_numpy(), HOLD)
        made = _recorded(
            folder / f"L{1000 * length:.0f}_{1000 * strain:.0f}_{test}.csv",
            PERIOD_S,
            pressure,
            np.full_like(pressure, strain),
            force,
            {"least_n": LEAST_N, "length_m": length, **known},
        )
        (held_out if test == last else fitted).append(made)
    return fitted, held_out


def pooled(data: Path, folder: Path) -> tuple[list[Recording], list[Recording]]:
    """The same as if all six specimens were one muscle: a rig without end factor."""
    return plateaus(data, folder, ends_mm=0.0)


def logs(data: Path, folder: Path) -> tuple[list[Recording], list[Recording]]:
    """The logs of the 200 mm long specimen, thinned by averaging; their stamps are rounded to 1
    ms."""
    source = data / "mckibben_10mm_isometric"
    meta = pd.read_csv(source / "meta.csv").set_index("file")
    fitted: list[Recording] = []
    held_out: list[Recording] = []
    for path in sorted(source.glob("d10_*.csv")):
        log = pd.read_csv(path)
        count = len(log) // LOG_STEP
        mean = log.to_numpy()[: count * LOG_STEP].reshape(count, LOG_STEP, -1).mean(axis=1)
        period = LOG_STEP * float(np.diff(log["time_s"].iloc[[0, -1]])[0]) / (len(log) - 1)
        row = meta.loc[path.name]
        made = _recorded(
            folder / path.name,
            period,
            mean[:, 1],
            np.full(count, float(row["strain"])),
            mean[:, 2],
            {"least_n": LEAST_N, "length_m": float(row["rest_length_m"])},
        )
        (held_out if row["test"] == 10 else fitted).append(made)
    return fitted, held_out


def force_map(data: Path, folder: Path) -> tuple[list[Recording], list[Recording]]:
    """The map of the 20 mm muscle, length by length; the reading scatters by the 1 N that it is
    good for."""
    table = pd.read_csv(data / "festo_force_map" / "martens2017_dmsp20_300.csv")
    random, third = np.random.default_rng(0), np.arange(len(table)) % 3 == 2
    made = []
    for name, rows, hold in (("fitted", ~third, MAP_HOLD), ("held_out", third, 2 * MAP_HOLD)):
        pressure, contraction, force = (
            np.repeat(table.loc[rows, c].to_numpy(float), hold)
            for c in ("pressure_kPa", "contraction", "force_N")
        )
        force = force + random.standard_normal(len(force))
        made.append(
            [
                _recorded(
                    folder / f"map_{name}.csv",
                    PERIOD_S,
                    pressure,
                    contraction,
                    force,
                    {"least_n": 0.0, "length_m": 0.296},
                )
            ]
        )
    return made[0], made[1]


CASES = {"plateaus": plateaus, "pooled": pooled, "logs": logs, "map": force_map}


def rms(replays: tuple[Replay, ...]) -> float:
    """Over everything scored, N."""
    return float(np.sqrt(np.mean(np.concatenate([r.residual[r.scored] for r in replays]) ** 2)))


def run_case(name: str, data: Path = DATA, jobs: int = 1) -> tuple[Outcome, Diagnosis]:
    with tempfile.TemporaryDirectory() as folder:
        fitted, held_out = CASES[name](data, Path(folder))
    diagnosed = diagnose(
        split_recordings(rig_named(str(RIG)), fitted, held_out), effects(), jobs=jobs
    )
    base = diagnosed.budget.baseline
    found = diagnosis_file(diagnosed).as_json()
    return Outcome(found, rms(base.replays), rms((diagnosed.cause or base).replays)), diagnosed


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--only", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    for name in options.only:
        begun, cpu = time.perf_counter(), time.process_time()
        out, diagnosed = run_case(name, options.data, options.jobs)
        found = out.found
        print(
            f"{name}: {found['verdict']} at {found['where']['port']}. {found['sentence']} "
            f"Hysteresis {out.hysteresis or 'not claimed'}; held-out RMS {out.before:.1f} -> "
            f"{out.after:.1f} N; {time.perf_counter() - begun:.0f} s, "
            f"{time.process_time() - cpu:.0f} s CPU"
        )
        # what could not be fitted comes last
        for row, c in zip(found["ranking"], diagnosed.ranking, strict=False):
            print(
                f"    {row['effect']:30s} {row['family']:18s} {row['port']:10s} RMS "
                f"{rms(c.replays):6.1f} N  "
                f"shrinkage {100 * row['shrinkage']:5.1f} %  probability {row['probability']:.2f}"
            )
        for cause in found["causes"]:
            print(
                f"    {cause['effect']}: "
                + ", ".join(
                    f"{k} = {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
                    for k, v in cause["parameters"].items()
                )
            )
        print(
            "    rig: "
            + ", ".join(f"{k} = {v['value']:.4g}" for k, v in found["parameters"].items()),
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
