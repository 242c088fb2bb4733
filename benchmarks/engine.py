"""CPU time of the engine and of grey-box fits on the one-dof rig, against their targets.

    OMP_NUM_THREADS=1 python benchmarks/engine.py

One process, one thread, CPU seconds, medians of several calls. The record is 200 s at 3 ms (66667
samples) of the rig's own closed loop, replayed on its recorded command. Compilation is timed apart;
everything else runs from the cache.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from timing import cpu

from pamid.base.arrays import Array
from pamid.engine import jit_cache as machine
from pamid.engine.program import Program, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.estimation.problem import Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.virtual_rig import simulate_virtual_rig

PERIOD_S = 0.003
SAMPLES = 66_667
SPECIMEN = {
    "damping_m2_s": 7.5e-4,
    "scale": 1.1,
    "conductance_in_m3_per_s_pa": 4.2e-9,
    "critical_ratio": 0.38,
    "viscous_n_m_s": 0.08,
    "contraction_0": 0.104,
    "dead_volume_cm3": 7.0,
    "polytropic": 1.15,
}
# one parameter each beside the rig's nine: twelve columns
HELD_OPEN = ("coulomb-friction", "dead-time", "leak")


@dataclass(frozen=True)
class Row:
    what: str
    seconds: float
    target: str = ""
    met: bool | None = None
    ratio: str = ""


def once(call: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.process_time()
    result = call()
    return time.process_time() - begun, result


def recorded(folder: Path, samples: int) -> Recording:
    """A virtual specimen in its own loop, with sensor noise."""
    reference = aprbs(samples * PERIOD_S, PERIOD_S, 35.0, seed=1)[:samples]
    stamps = np.arange(len(reference)) * PERIOD_S
    write_recording(folder / "reference.csv", stamps, {"reference_deg": reference})
    made = simulate_virtual_rig(
        "one-dof",
        read_recording(folder / "reference.csv"),
        (),
        {"inertia_kg_m2": 0.0896},
        SPECIMEN,
        1.0,
        1,
    )
    write_recording(folder / "rec.csv", stamps, made.columns, made.meta)
    return read_recording(folder / "rec.csv")


# ---- runs --------------------


@dataclass(frozen=True)
class Setting:
    """An assembly at a point, ready to run."""

    assembly: Assembly
    u: Array
    p: Array
    stepping: Stepping

    def run(self, columns: list[int] | None = None) -> Array:
        program: Program = self.assembly.program
        memory = program.memory(
            self.assembly.start(self.p),
            len(columns or []),
            stepping=self.stepping,
            period_s=PERIOD_S,
        )
        chosen = None
        if columns is not None:
            chosen = np.full(len(self.p), -1, np.int64)
            chosen[columns] = np.arange(len(columns))
        y, _, bad = program.run(
            memory, SampledInputs(self.u, PERIOD_S), self.p, stepping=self.stepping, columns=chosen
        )
        assert bad == -1, f"blew up at sample {bad}"
        return y


def setting(assembly: Assembly, recording: Recording) -> Setting:
    p = assembly.values({"inertia_kg_m2": 0.0896, **SPECIMEN})
    u = data_of(assembly.rig, recording).inputs(assembly)
    return Setting(assembly, u, p, choose_stepping(assembly, u, p, PERIOD_S, assembly.start(p)))


def rig_columns(a: Assembly) -> list[int]:
    return [i for i, b in enumerate(a.parameters) if b.fitted and not b.owner]


def of_the_rig(s: Setting) -> Setting:
    """The same with derivatives by the rig's own parameters alone."""
    keys = frozenset(s.assembly.parameters[i].key for i in rig_columns(s.assembly))
    return replace(s, assembly=replace(s.assembly, sensitive=keys))


def problem_of(recording: Recording, background: bool) -> Problem:
    """The fit of a recording, with the background's terms or without."""
    a = Assembly(rig_named("one-dof"), background=background)
    track = track_of(a, data_of(a.rig, recording), a.program.outputs)
    return Problem(a, (track,), free_parameters(a, (track,)))


# ---- compiling --------------------


def compile_seconds(assembly: Assembly, folder: Path) -> tuple[float, float]:
    """Cold, and again from the files (equations traced, differentiated and written both times)."""
    before, kept = os.environ.get("PAMID_CACHE"), machine._loaded
    os.environ["PAMID_CACHE"] = str(folder)
    times = []
    for _ in range(2):
        machine._loaded = {}
        fresh = replace(assembly)
        times.append(once(lambda fresh=fresh: fresh.program)[0])
        kept = {**kept, **machine._loaded}  # code that is still in use must live
    machine._loaded = kept
    if before is None:
        del os.environ["PAMID_CACHE"]
    else:
        os.environ["PAMID_CACHE"] = before
    return times[0], times[1]


DRIVER = """
import time
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
import numpy as np
a = Assembly(rig_named("one-dof"))
program, p = a.program, a.values()
begun = time.process_time()
program.run(program.memory(a.start(p), period_s=0.003), SampledInputs(np.zeros((2, 2)), 0.003), p)
print(time.process_time() - begun)
"""


def driver_seconds(folder: Path) -> tuple[float, float]:
    """The sweep itself, compiled once per installation: cold and from its cache, in processes of
    their own."""
    times = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", DRIVER],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
        )
        times.append(float(done.stdout))
    return times[0], times[1]


# ---- the table --------------------


def against(what: str, seconds: float, target: float, base: float | None = None) -> Row:
    ratio = "" if base is None else f"{seconds / base:.1f} x free run"
    return Row(what, seconds, f"<= {target:g} s", seconds <= target, ratio)


def engine_rows(plain: Setting, wide: Setting, everything: Setting) -> list[Row]:
    nine = rig_columns(plain.assembly)
    more = [i for i, b in enumerate(wide.assembly.parameters) if b.owner and b.fitted][
        : 12 - len(nine)
    ]
    twelve = rig_columns(wide.assembly) + more
    free, with_nine = cpu(plain.run), cpu(lambda: plain.run(nine))
    rows = [
        against(f"free run, {SAMPLES} samples", free, 0.025, free),
        against(f"with {len(nine)} exact sensitivities", with_nine, 0.080, free),
        Row(f"free run with {', '.join(HELD_OPEN)}", cpu(wide.run)),
        against(
            f"  with {len(twelve)} exact sensitivities, 3 of them of effects",
            cpu(lambda: wide.run(twelve)),
            0.080,
        ),
    ]
    own, narrow = rig_columns(everything.assembly), of_the_rig(everything)
    for what, seconds, base in (
        (
            f"all {len(everything.assembly.attachments)} effects at once, free run",
            cpu(everything.run, 5),
            free,
        ),
        (
            f"all effects at once, {len(own)} sensitivities",
            cpu(lambda: narrow.run(own), 3),
            with_nine,
        ),
    ):
        target = 10.0 * (0.025 if base is free else 0.080)
        rows.append(
            Row(
                what,
                seconds,
                f"<= {target:g} s",
                seconds <= target,
                f"{seconds / base:.1f} x plain",
            )
        )
    made, how = (
        everything.assembly.program,
        "implicit" if everything.stepping.implicit else "explicit",
    )
    rows.append(
        Row(
            f"  {len(made.states)} states, {len(made.cells)} cells, {everything.stepping.substeps} "
            f"{how} step(s) per sample; none had to be left out",
            math.nan,
        )
    )
    return rows


def fit_rows(short: Recording, long: Recording) -> list[Row]:
    rows = []
    for recording, seconds, target in ((short, 20, 1.0), (long, 200, 10.0)):
        for background in (False, True):
            problem = problem_of(recording, background)
            done = fit_robustly(problem)
            state = "converged" if done.converged else f"not converged: {done.why}"
            taken = cpu(lambda problem=problem: fit_robustly(problem), 3)
            what = (
                f"fit of {seconds} s, {len(problem.free)} "
                f"parameters{' (with background)' if background else ''}"
            )
            rows.append(Row(what, taken, f"<= {target:g} s", taken <= target, state))
    return rows


def show(rows: list[Row]) -> None:
    print(f"{'':86s} {'CPU':>11s}  {'target':>14s}      ratio")
    for r in rows:
        time_ = (
            ""
            if math.isnan(r.seconds)
            else f"{1e3 * r.seconds:.1f} ms"
            if r.seconds < 1
            else f"{r.seconds:.2f} s"
        )
        met = "" if r.met is None else "ok" if r.met else "NO"
        print(f"{r.what:86s} {time_:>11s}  {r.target:>14s} {met:2s}   {r.ratio}".rstrip())


def main() -> None:
    rig = rig_named("one-dof")
    found = attachments(rig, effects().values())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        long = recorded(folder, SAMPLES)
        (folder / "short").mkdir()
        short = recorded(folder / "short", round(20.0 / PERIOD_S))
        plain = setting(Assembly(rig), long)
        wide = setting(Assembly(rig, tuple(a for a in found if a.label in HELD_OPEN)), long)
        everything = setting(Assembly(rig, tuple(found)), long)
        rows = engine_rows(plain, wide, everything)
        rows += fit_rows(short, long)
        for what, a in (("plain rig", plain.assembly), ("all effects", everything.assembly)):
            cold, cached = compile_seconds(a, folder / what)
            rows += [
                Row(f"compile {what}, cold", cold),
                Row(f"compile {what}, from the cache", cached),
            ]
        cold, cached = driver_seconds(folder / "numba")
        rows += [
            Row("compile the sweep (once per installation), cold", cold),
            Row("load the sweep from its cache", cached),
        ]
        show(rows)


if __name__ == "__main__":
    main()
