"""All that is wanted of the speed of pamid in one table: measured now, beside the peer of the same
run, with the goal and whether it is reached.

    OMP_NUM_THREADS=1 python benchmarks/speed.py [--rows pass,free-run] [--long] [--json FILE]
    [--environment FOLDER] [--samples 66667] [--jobs 2]

The rows are those of the other benchmarks, whose functions measure here too: elman_pass.py,
elman_peers.py, paper_training.py, engine.py, arm.py, scale.py. CPU seconds where nothing else is
said, medians or the fastest of several; by the clock where several cores work, or a person waits.
The processor's widest vectors decide some goals and stand above the table: figures of two machines
are not compared. Long rows (the paper's training, a diagnosis of 200 s, a million samples: half an
hour and more) only with --long, or where --rows names them. A row whose peer cannot be installed
says so and is not counted as reached. Where other work holds the cores, a goal missed by little
says nothing: run again when the machine is quiet.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

from peers.environment import CACHE, python_with
from published import vectors

Figures = dict[str, float]
LONG_SAMPLES = 1_000_000
SHARE = 0.02  # above its best, where a training counts as done


@dataclass(frozen=True)
class Wanted:
    """A goal: at most or at least so much; None where there is none for this processor."""

    bound: float | None = None
    at_least: bool = False


@dataclass(frozen=True)
class Line:
    """A line of the table. peer: in words, with its figure; share: of dgemm's rate."""

    row: str
    work: str
    figure: float | None
    unit: str
    goal: Wanted = Wanted()
    peer: str = ""
    share: float | None = None
    remark: str = ""

    @property
    def reached(self) -> bool | None:
        if self.goal.bound is None or self.figure is None:
            return None
        if self.goal.at_least:
            return self.figure >= self.goal.bound
        return self.figure <= self.goal.bound


@dataclass(frozen=True)
class Asked:
    """What the rows are given: samples of a free run, cores, the peers' environment, and the
    processor's widest vectors."""

    samples: int
    jobs: int
    environment: Path
    vectors: str
    folder: Path


def most(bound: float | None) -> Wanted:
    return Wanted(bound)


def least(bound: float | None) -> Wanted:
    return Wanted(bound, True)


def by_vectors(asked: Asked, wide: float | None, narrow: float | None) -> float | None:
    """The bound for this processor: of AVX-512, of AVX2."""
    return {"AVX-512": wide, "AVX2": narrow}.get(asked.vectors)


# ---- from figures to lines: nothing is measured here ---------------------------------------------


def pass_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("pass", "LM pass (66667 x 171), share of dgemm's rate", f["share"], "of dgemm",
             least(0.85), f"dgemm {f['dgemm'] / 1e9:.1f} GF/s", f["share"], seconds(f["pass"])),
        Line("pass", "iteration with its trials", f["iteration"] / f["pass"], "passes", most(1.2),
             remark=f"{seconds(f['iteration'])}, {f['trials']:.1f} trials"),
    ]  # fmt: skip


def core_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("two-cores", "two cores: a pass", f["pass"], "times faster", least(1.85)),
        Line("two-cores", "two cores: two starts", f["starts"], "times faster", least(1.85)),
    ]


def peer_lines(f: Figures, asked: Asked) -> list[Line]:
    """f: CPU seconds of an iteration, `ours` and by peer; a peer that is absent has none."""
    ours, lines = f["ours"], []
    for name, work, bound in (
        ("inside", "JAX, everything inside its scan", 8.0),
        ("by-hand", "our sensitivities by hand in JAX", 3.0),
        ("pyrenn", "pyrenn", 100.0),
    ):
        figure = f[name] / ours if name in f else None
        remark = f"ours {seconds(ours)}" if figure else "not measured: no environment of the peers"
        peer = seconds(f[name]) if figure else ""
        lines.append(Line("peers", work, figure, "times ours", least(bound), peer, remark=remark))
    return lines


def paper_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("paper-job", f"the paper's job to within {SHARE:.0%} of its best, 4 starts, "
             f"{asked.jobs} cores, by the clock", f["clock"], "s", most(20.0),
             "the paper: 36101 s", remark=f"{f['cpu']:.0f} s CPU; its end {f['whole_clock']:.0f} s "
             f"by the clock, {f['iterations']:.0f} iterations, MSE {f['mse']:.2e}"),
    ]  # fmt: skip


def run_lines(f: Figures, asked: Asked) -> list[Line]:
    peer = f"solve_ivp, restarted: {f['scipy'] / f['free']:.0f} times"
    whole = asked.samples == 66_667
    bounds = [by_vectors(asked, *b) if whole else None for b in ((6.5, 16.0), (24.0, 52.0))]
    return [
        Line("free-run", f"free run, {asked.samples} samples", 1e3 * f["free"], "ms",
             most(bounds[0]), peer),
        Line("free-run", "with 9 sensitivities", 1e3 * f["nine"], "ms", most(bounds[1]),
             remark=f"{f['nine'] / f['free']:.1f} times the free run"),
    ]  # fmt: skip


def effect_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("all-effects", f"all {f['effects']:.0f} effects attached, free", 1e3 * f["all"], "ms",
             remark=f"{f['all'] / f['free']:.1f} times the plain run"),
        Line("all-effects", "all effects attached, 9 sensitivities", f["all_nine"] / f["nine"],
             "times the plain run with them", most(8.0),
             remark=f"{1e3 * f['all_nine']:.0f} ms beside {1e3 * f['nine']:.0f} ms"),
    ]  # fmt: skip


def fit_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("fit", f"fit of {f['length_s']:.0f} s with background ({f['free']:.0f} parameters)",
             f["seconds"], "s", most(5.0 if f["length_s"] > 199.0 else None),
             remark="the goal is meant for AVX2, at half this rate"
             if asked.vectors == "AVX-512" else ""),
    ]  # fmt: skip


def arm_lines(f: Figures, asked: Asked) -> list[Line]:
    peer = f"MuJoCo, links alone: {1e3 * f['mujoco']:.0f} ms" if "mujoco" in f else ""
    return [
        Line("arm", "arm: free run", 1e3 * f["free"], "ms", peer=peer),
        Line("arm", "arm: 9 sensitivities", f["nine"] / f["free"], "times its free run", most(3.5),
             remark=f"{1e3 * f['nine']:.0f} ms"),
    ]  # fmt: skip


def diagnosis_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("diagnosis", f"diagnosis of 200 s, --jobs {asked.jobs}, by the clock", f["clock"], "s",
             most(by_vectors(asked, 21.0, 60.5)), remark=f"{f['cpu']:.0f} s CPU"),
    ]  # fmt: skip


def million_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("million", "diagnosis of a million samples: memory", f["memory_gb"], "GB", most(2.5)),
        Line("million", "diagnosis of a million samples: CPU", f["cpu"], "s", most(400.0)),
    ]


def cold_lines(f: Figures, asked: Asked) -> list[Line]:
    return [
        Line("cold-start", "cold start: the sweep compiled, CPU", f["cold"], "s", most(8.0),
             remark=f"{seconds(f['cached'])} from the cache; `make` compiles it when it installs"),
    ]  # fmt: skip


# ---- measuring -----------------------------------------------------------------------------------


def measure_pass(asked: Asked) -> Figures:
    from elman_pass import on_one_core

    return on_one_core()


def measure_cores(asked: Asked) -> Figures:
    from elman_pass import on_two_cores

    return on_two_cores()


def measure_peers(asked: Asked) -> Figures:
    """Every row a process of its own, bound to one core as elman_peers.py binds them."""
    import elman_peers

    own, path = Path(sys.executable), asked.folder / "record.npz"
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        elman_peers.write_record(path, 66_667)
        figures = elman_peers.figures
        found = {"ours": figures(elman_peers.Row("pamid", "ours.py"), own, path)["cpu_s"]}
        try:
            theirs = python_with(asked.environment, elman_peers.REQUIRED)
        except (subprocess.CalledProcessError, OSError):
            return found
        rows = {r.arguments[0] if r.arguments else "pyrenn": r
                for name in ("jax", "pyrenn") for r in elman_peers.PEERS[name]}  # fmt: skip
        for name in ("inside", "by-hand", "pyrenn"):
            found[name] = figures(rows[name], theirs, path)["cpu_s"]
        return found
    finally:
        if cores:
            os.sched_setaffinity(0, cores)


def measure_paper(asked: Asked) -> Figures:
    from paper_training import seconds_until
    from threadpoolctl import threadpool_limits

    from pamid.replications.joint_paper import JointPlan, record_twin
    from pamid.replications.joint_twin import Twin

    with threadpool_limits(1, "blas"):
        records = record_twin(asked.folder, Twin(), JointPlan(seed=0, seconds=200.0))
        return seconds_until(records, SHARE, asked.jobs)


def measure_runs(asked: Asked) -> Figures:
    """Free runs, plain and with every effect, and the rate of scipy's solver beside them."""
    import engine

    from pamid.model.assembly import Assembly
    from pamid.model.attachment import attachments
    from pamid.model.registry import effects, rig_named

    rig = rig_named("one-dof")
    found = attachments(rig, effects().values())
    recording = engine.recorded(asked.folder, asked.samples)
    plain = engine.setting(Assembly(rig), recording)
    wide = engine.setting(Assembly(rig, tuple(found)), recording)
    narrow = engine.of_the_rig(wide)
    nine, own = engine.rig_columns(plain.assembly), engine.rig_columns(wide.assembly)
    free = engine.cpu(plain.run)
    samples = min(engine.RESTARTED, asked.samples)
    scipy, _ = engine.once(
        lambda: engine.Transcription(plain).restarted("LSODA", samples, rtol=1e-6, atol=1e-9)
    )
    return {
        "free": free,
        "nine": engine.cpu(lambda: plain.run(nine)),
        "scipy": scipy * asked.samples / samples,
        "effects": len(found),
        "all": engine.cpu(wide.run, 5),
        "all_nine": engine.cpu(lambda: narrow.run(own), 3),
    }


def measure_fit(asked: Asked) -> Figures:
    import engine

    from pamid.estimation.robust_fit import fit_robustly

    problem = engine.problem_of(engine.recorded(asked.folder, asked.samples), True)
    taken = engine.cpu(lambda: fit_robustly(problem), 3)
    length = asked.samples * engine.PERIOD_S
    return {"seconds": taken, "free": len(problem.free), "length_s": length}


def measure_arm(asked: Asked) -> Figures:
    import arm

    found = arm.measured()
    try:
        found["mujoco"] = arm.beside_mujoco()[0]
    except ImportError:
        say("MuJoCo is not there: the arm stands without its peer")
    return found


def measure_diagnosis(asked: Asked) -> Figures:
    return diagnosed(asked, asked.samples, asked.jobs)


def measure_million(asked: Asked) -> Figures:
    return diagnosed(asked, LONG_SAMPLES, 1)


def diagnosed(asked: Asked, samples: int, jobs: int) -> Figures:
    """`pamid diagnose` of so many samples of the joint, as a process of its own."""
    import scale

    path = scale.record(asked.folder, "one-dof", f"rec-{samples}", samples, 0)
    output = asked.folder / f"run-{samples}"
    words = ["diagnose", str(path), "--rig", "one-dof", "--jobs", str(jobs)]
    spent = scale.spent_on(*words, "--output", str(output))
    if spent.code:
        raise SystemExit(f"pamid diagnose ended with {spent.code}")
    return {"clock": spent.clock_s, "cpu": spent.cpu_s, "memory_gb": spent.memory_gb}


def measure_cold(asked: Asked) -> Figures:
    import engine

    cold, cached = engine.driver_seconds(asked.folder / "numba")
    return {"cold": cold, "cached": cached}


@dataclass(frozen=True)
class Row:
    """How a row is measured and what lines follow; long: only where it is asked for."""

    measure: Callable[[Asked], Figures]
    lines: Callable[[Figures, Asked], list[Line]]
    long: bool = False


ROWS = {
    "pass": Row(measure_pass, pass_lines),
    "two-cores": Row(measure_cores, core_lines),
    "peers": Row(measure_peers, peer_lines),
    "paper-job": Row(measure_paper, paper_lines, True),
    "free-run": Row(measure_runs, run_lines),
    "all-effects": Row(measure_runs, effect_lines),
    "fit": Row(measure_fit, fit_lines),
    "arm": Row(measure_arm, arm_lines),
    "diagnosis": Row(measure_diagnosis, diagnosis_lines, True),
    "million": Row(measure_million, million_lines, True),
    "cold-start": Row(measure_cold, cold_lines),
}


# ---- the table -----------------------------------------------------------------------------------


def seconds(value: float) -> str:
    return f"{1e3 * value:.0f} ms" if value < 1.0 else f"{value:.3g} s"


def say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def printed(line: Line) -> str:
    """A line as a row of a table in Markdown."""
    figure = "-" if line.figure is None else f"{line.figure:.3g} {line.unit}"
    goal = line.goal.bound
    words = "" if goal is None else f"{'>=' if line.goal.at_least else '<='} {goal:g}"
    verdict = {True: "reached", False: "missed", None: ""}[line.reached]
    share = "" if line.share is None else f"{line.share:.0%}"
    cells = (line.work, figure, line.peer, share, words, verdict, line.remark)
    return f"| {' | '.join(cells)} |"


HEAD = (
    "| work | measured | peer, same run | of dgemm's rate | goal | | remark |",
    "|---|---:|---|---:|---:|---|---|",
)


def as_json(lines: list[Line], asked: Asked) -> dict[str, Any]:
    return {
        "date": str(date.today()),
        "vectors": asked.vectors,
        "load": os.getloadavg()[0],
        "lines": [{**asdict(line), "reached": line.reached} for line in lines],
    }


def table(names: list[str], asked: Asked, show: Callable[[str], None] = print) -> list[Line]:
    """Measure these rows and show each as it is done; two that are measured alike, once."""
    known: dict[Callable[[Asked], Figures], Figures] = {}
    lines: list[Line] = []
    for text in HEAD:
        show(text)
    for name in names:
        row = ROWS[name]
        if row.measure not in known:
            say(f"measuring {name} ...")
            known[row.measure] = row.measure(asked)
        for line in row.lines(known[row.measure], asked):
            lines.append(line)
            show(printed(line))
    return lines


def chosen_rows(words: str, long: bool) -> list[str]:
    """Names of rows, in the order of the table; SystemExit for one that is none."""
    asked = words.split(",") if words else [n for n, row in ROWS.items() if long or not row.long]
    if unknown := [name for name in asked if name not in ROWS]:
        raise SystemExit(f"there is no row {unknown[0]!r}; there are {', '.join(ROWS)}")
    return [name for name in ROWS if name in asked]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", default="", help="of " + ", ".join(ROWS))
    parser.add_argument("--long", action="store_true", help="the long rows, too")
    parser.add_argument("--json", type=Path, help="write the lines to this file, too")
    parser.add_argument("--environment", type=Path, default=CACHE / "peers")
    parser.add_argument("--samples", type=int, default=66_667, help="of the joint's runs")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    names = chosen_rows(options.rows, options.long)
    about = Path("/proc/cpuinfo")
    widest = vectors(about.read_text() if about.exists() else "")
    with tempfile.TemporaryDirectory() as name:
        asked = Asked(options.samples, options.jobs, options.environment, widest, Path(name))
        print(
            f"{date.today()}, widest vectors {widest}, {os.cpu_count()} cores, load "
            f"{os.getloadavg()[0]:.1f} at the start\n"
        )
        lines = table(names, asked)
        judged = [line.reached for line in lines if line.reached is not None]
        print(f"\n{sum(judged)} of {len(judged)} goals reached; load {os.getloadavg()[0]:.1f}")
        if options.json:
            options.json.write_text(json.dumps(as_json(lines, asked), indent=1) + "\n")


if __name__ == "__main__":
    main()
