"""The speed of whole commands, beside an older commit in the same run.

    OMP_NUM_THREADS=1 python benchmarks/speed.py --old c717fac [--rows joint,pair] [--long]

Each row runs the same command with this tree and with the old commit, in turn, and prints both
figures and their ratio: figures of two machines or of two hours are not compared. CPU seconds of
the processes together, by the clock where two jobs work. "First run" starts with an empty cache of
compiled models; "warm" is the run after it. The old commit is checked out in a temporary folder
and runs in this environment. Rows that take more than five minutes run with --long, or where
--rows names them.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from published import vectors

from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

ROOT = Path(__file__).resolve().parents[1]
PAIR = ("coulomb-friction", "backlash")
SERVO_SECONDS, SERVO_PERIOD_S, SERVO_SEED = 40.0, 0.005, 3
LONG_SAMPLES, MILLION = 66_667, 1_000_000
STARTERS = (
    "dc-motor",
    "thermal-block",
    "servo-pendulum",
    "two-masses",
    "damper-bench",
    "cylinder-bench",
    "cascaded-tanks",
)


@dataclass(frozen=True)
class Spent:
    """CPU (of all processes) and clock, s; largest resident set of one process, GB."""

    cpu_s: float
    clock_s: float
    memory_gb: float


@dataclass(frozen=True)
class Tree:
    """A version of pamid that runs in this environment; folder: on its PYTHONPATH, for caches."""

    folder: Path

    def run(self, *words: str, cold: bool = False) -> Spent:
        """`pamid` with these arguments in a process of its own."""
        cache = tempfile.mkdtemp(dir=self.folder) if cold else str(self.folder / "cache")
        environment = {**os.environ, "PYTHONPATH": str(self.folder), "PAMID_CACHE": cache}
        begun, log = time.monotonic(), self.folder / "log"
        child = os.posix_spawn(
            sys.executable,
            # -P: without the folder it is called from, where another version may lie
            [sys.executable, "-P", "-m", "pamid_cli", *words],
            environment,
            file_actions=[
                (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
                (os.POSIX_SPAWN_OPEN, 2, str(log), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600),
            ],
        )
        _, status, used = os.wait4(child, 0)
        if code := os.waitstatus_to_exitcode(status):
            words_of = log.read_text()[-300:]
            raise SystemExit(f"pamid {words[0]} of {self.folder.name}: exit {code}: {words_of}")
        clock = time.monotonic() - begun
        return Spent(used.ru_utime + used.ru_stime, clock, used.ru_maxrss / 1e6)


@contextmanager
def checked_out(commit: str, folder: Path) -> Iterator[Tree]:
    """The tree of a commit; SystemExit where there is none of that name."""
    place = folder / "old-tree"
    add = ["git", "-C", str(ROOT), "worktree", "add", "--force", "--detach", str(place), commit]
    done = subprocess.run(add, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"no commit {commit!r} to compare with: {done.stderr.strip()}")
    try:
        yield linked(place, folder / "old")
    finally:
        remove = ["git", "-C", str(ROOT), "worktree", "remove", "--force", str(place)]
        subprocess.run(remove, capture_output=True, check=False)


def linked(tree: Path, folder: Path) -> Tree:
    """A tree whose packages are found in `folder`."""
    folder.mkdir()
    (folder / "pamid").symlink_to(tree / "pamid")
    (folder / "pamid_cli").symlink_to(tree / "cli")
    return Tree(folder)


# ---- recordings ----------------------------------------------------------------------------------


def joint_recording(folder: Path) -> Path:
    """The example that is shipped."""
    return ROOT / "data" / "example" / "joint.csv"


def pair_recording(folder: Path) -> Path:
    """Two effects under the excitation of the example."""
    table = read_recording(joint_recording(folder))
    sent = {"reference_deg": table.signal("reference_deg")}
    return simulated(folder / "pair.csv", "one-dof", table.time, sent, PAIR)


def servo_recording(folder: Path) -> Path:
    """A servo whose driver has a dead zone."""
    sent = aprbs(SERVO_SECONDS, SERVO_PERIOD_S, 60.0, (0.2, 1.6), seed=SERVO_SEED)
    time_s = SERVO_PERIOD_S * np.arange(len(sent))
    columns = {"reference_deg": sent}
    return simulated(folder / "servo.csv", "servo-pendulum", time_s, columns, ("dead-zone@driver",))


def simulated(
    path: Path, rig: str, time_s: np.ndarray, sent: dict[str, np.ndarray], effects: tuple[str, ...]
) -> Path:
    """A virtual recording of a rig with these effects."""
    write_recording(path, time_s, sent)
    made = simulate_virtual_rig(rig, read_recording(path), effects, {}, {}, 1.0, SERVO_SEED)
    write_recording(path, time_s, made.columns, made.meta)
    return path


def long_recording(folder: Path, samples: int = LONG_SAMPLES) -> Path:
    """So many samples of the joint with friction."""
    import scale

    return scale.record(folder, "one-dof", f"joint-{samples}", samples, 0)


# ---- rows ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Figure:
    """A row of the table. unit: of both figures; goal: most of the new one."""

    work: str
    old: float | None
    new: float
    unit: str
    goal: float

    @property
    def ratio(self) -> float | None:
        return self.new / self.old if self.old else None

    @property
    def text(self) -> str:
        """The row in Markdown."""
        old = "-" if self.old is None else f"{self.old:.3g}"
        ratio = "-" if self.ratio is None else f"{self.ratio:.2f}"
        reached = "reached" if self.new <= self.goal else "missed"
        cells = (self.work, old, f"{self.new:.3g}", ratio, f"{self.goal:g}", self.unit, reached)
        return f"| {' | '.join(cells)} |"


@dataclass(frozen=True)
class Pair:
    """The two trees, and a folder for recordings and runs."""

    old: Tree
    new: Tree
    folder: Path

    def diagnosed(self, recording: Path, rig: str, *words: str, cold: bool = False) -> list[Spent]:
        """Both diagnose a recording, the old one first."""
        output = ("--output", str(self.folder / "run"), "--overwrite")
        words = ("diagnose", str(recording), "--rig", rig, *output, *(words or ("--jobs", "1")))
        return [tree.run(*words, cold=cold) for tree in (self.old, self.new)]


def joint_rows(pair: Pair) -> list[Figure]:
    path = joint_recording(pair.folder)
    first = [s.cpu_s for s in pair.diagnosed(path, "one-dof", cold=True)]
    pair.diagnosed(path, "one-dof")
    warm = [s.cpu_s for s in pair.diagnosed(path, "one-dof")]
    work = "diagnose data/example/joint.csv"
    return [Figure(f"{work}, warm", *warm, "s CPU", 20.0),
            Figure(f"{work}, first run", *first, "s CPU", 30.0)]  # fmt: skip


def pair_rows(pair: Pair) -> list[Figure]:
    path = pair_recording(pair.folder)
    pair.diagnosed(path, "one-dof")
    spent = [s.cpu_s for s in pair.diagnosed(path, "one-dof")]
    return [Figure("Coulomb friction and backlash, 20 s, warm", *spent, "s CPU", 35.0)]


def servo_rows(pair: Pair) -> list[Figure]:
    spent = pair.diagnosed(servo_recording(pair.folder), "servo-pendulum", cold=True)
    work = "servo-pendulum, 40 s, dead zone, first run"
    return [Figure(work, *(s.cpu_s for s in spent), "s CPU", 10.0)]


def long_rows(pair: Pair) -> list[Figure]:
    spent = pair.diagnosed(long_recording(pair.folder), "one-dof", "--jobs", "2")
    return [Figure("200 s of the joint, two jobs", *(s.clock_s for s in spent), "s clock", 45.0)]


def million_rows(pair: Pair) -> list[Figure]:
    """This tree alone: the old one needs 4 GB and a quarter of an hour."""
    output = ("--output", str(pair.folder / "run"), "--overwrite", "--jobs", "1")
    path = long_recording(pair.folder, MILLION)
    spent = pair.new.run("diagnose", str(path), "--rig", "one-dof", *output)
    return [Figure("a million samples of the joint", None, spent.cpu_s, "s CPU", 400.0),
            Figure("a million samples of the joint", None, spent.memory_gb, "GB", 2.5)]  # fmt: skip


def lane_rows(pair: Pair) -> list[Figure]:
    """A hypothesis in lanes against a run by itself, both of this tree."""
    import lanes

    alone, lane = lanes.seconds_per_hypothesis()
    work = f"free run of {LONG_SAMPLES} samples: alone, and a hypothesis in lanes"
    return [Figure(work, 1e3 * alone, 1e3 * lane, "ms CPU", 8.0)]


def robot_rows(name: str, work: str, goal: float) -> Callable[[Pair], list[Figure]]:
    """A diagnosis of a MuJoCo model, as of mujoco_diagnoses.py."""

    def rows(pair: Pair) -> list[Figure]:
        import mujoco_diagnoses as robots

        if name == "hopper":
            robots.write_hopper(pair.folder)
        else:
            robots.write_case(pair.folder, name)
        model, path = str(pair.folder / "model.xml"), pair.folder / "rec.csv"
        spent = pair.diagnosed(path, model, "--jobs", "2", cold=True)
        return [Figure(work, *(s.cpu_s for s in spent), "s CPU", goal)]

    return rows


def trial_rows(pair: Pair, cases: int = 4) -> list[Figure]:
    """One case of the blind trial, the median over the starter rigs of their mean."""
    took = []
    for rig in STARTERS:
        words = ("trial", "--rig", rig, "--seed", "11", "--cases", str(cases), "--jobs", "1")
        output = ("--overwrite", "--output", str(pair.folder / "trial"))
        spent = [tree.run(*words, *output).cpu_s / cases for tree in (pair.old, pair.new)]
        took.append(spent)
    old, new = (statistics.median(column) for column in zip(*took, strict=True))
    work = "a case of the trial, median of the starter rigs"
    return [Figure(work, old, new, "s CPU", 8.0)]


@dataclass(frozen=True)
class Row:
    """How a row is measured; long: more than five minutes."""

    figures: Callable[[Pair], list[Figure]]
    long: bool = False


ROWS = {
    "joint": Row(joint_rows),
    "pair": Row(pair_rows),
    "servo": Row(servo_rows),
    "lanes": Row(lane_rows),
    "long-joint": Row(long_rows),
    "seven": Row(robot_rows("seven", "MuJoCo, seven joints, 60 s, first run", 180.0), True),
    "hopper": Row(robot_rows("hopper", "hopper, 6 s, first run", 600.0), True),
    "trial": Row(trial_rows, True),
    "million": Row(million_rows, True),
}
HEAD = "| work | old | new | ratio | goal | unit | |\n|---|---:|---:|---:|---:|---|---|"


def chosen_rows(words: str, long: bool) -> list[str]:
    """Names of rows, in the order of the table; SystemExit for an unknown one."""
    wanted = words.split(",") if words else [n for n, row in ROWS.items() if long or not row.long]
    if unknown := [name for name in wanted if name not in ROWS]:
        raise SystemExit(f"there is no row {unknown[0]!r}; there are {', '.join(ROWS)}")
    return [name for name in ROWS if name in wanted]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--old", required=True, help="commit to compare with")
    parser.add_argument("--rows", default="", help="of " + ", ".join(ROWS))
    parser.add_argument("--long", action="store_true", help="the long rows, too")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    options = parser.parse_args()
    names, about = chosen_rows(options.rows, options.long), Path("/proc/cpuinfo")
    widest = vectors(about.read_text() if about.exists() else "")
    load = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    print(f"{date.today()}, widest vectors {widest}, {load}, old commit {options.old}\n\n{HEAD}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with checked_out(options.old, folder) as old:
            pair = Pair(old, linked(ROOT, folder / "new"), folder)
            figures = []
            for row in names:
                for figure in ROWS[row].figures(pair):
                    figures.append(figure)
                    print(figure.text, flush=True)
    if options.json:
        rows = [{**vars(f), "ratio": f.ratio} for f in figures]
        options.json.write_text(json.dumps({"vectors": widest, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
