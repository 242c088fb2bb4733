"""CPU time of eight hypotheses side by side, against runs of each by itself.

    OMP_NUM_THREADS=1 python benchmarks/lanes.py [--narrow]

One process, one thread, CPU seconds, medians of several calls. The record is that of
`benchmarks/engine.py`: 200 s at 3 ms (66667 samples) of the one-dof rig's loop, simulated with the
model that an effect is screened with (background and Coulomb friction). --narrow compiles models
for a processor without AVX-512, whose vectors hold four doubles.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
from engine import PERIOD_S, SAMPLES, Setting, once, recorded, setting
from timing import cpu

from pamid.engine.llvm_ir import LANES
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named

COLUMNS = 48


def run_lanes(s: Setting) -> None:
    program = s.assembly.lane_program
    x = np.repeat(s.assembly.start(s.p)[:, None], LANES, axis=1)
    memory = program.memory(x, stepping=s.stepping, period_s=PERIOD_S)
    _, bad = program.run(memory, SampledInputs(s.u, PERIOD_S), s.p, stepping=s.stepping)
    assert (bad == -1).all()


def narrow_vectors() -> None:
    """Compile for the host without its widest vectors."""
    features = llvm.get_host_cpu_features()
    features.update({name: False for name in features if name.startswith(("avx512", "avx10"))})
    llvm.get_host_cpu_features = lambda: features


def steps_text(s: Setting, what: str) -> list[str]:
    fitted = [i for i, b in enumerate(s.assembly.parameters) if b.fitted]
    columns = [*fitted, *(i for i in range(len(s.p)) if i not in fitted)][:COLUMNS]
    steps = SAMPLES * s.stepping.substeps
    times = {
        f"one run with {len(columns)} columns": cpu(lambda: s.run(columns), 3),
        "one run without": cpu(s.run, 3),
        f"{LANES} lanes": cpu(lambda: run_lanes(s), 3),
    }
    lines = [
        f"{what}, {name}: {1e3 * seconds:.1f} ms, {1e6 * seconds / steps:.3f} us a step"
        for name, seconds in times.items()
    ]
    with_columns, alone, lanes = times.values()
    share = lanes / LANES
    return [
        *lines,
        f"{what}, per hypothesis: {1e3 * share:.2f} ms; {alone / share:.1f} times less than a run "
        f"without columns, {with_columns / share:.1f} times less than one with {COLUMNS}",
    ]


def seconds_per_hypothesis() -> tuple[float, float]:
    """CPU seconds of a run without columns, by itself and as one of the lanes."""
    with tempfile.TemporaryDirectory() as folder:
        s = screened_model(Path(folder))
        return cpu(s.run, 3), cpu(lambda: run_lanes(s), 3) / LANES


def screened_assembly() -> Assembly:
    """The joint's model with background and friction."""
    rig = rig_named("one-dof")
    return Assembly(rig, (attach(rig, "coulomb-friction", effects()),), background=True)


def screened_model(folder: Path) -> Setting:
    """The same over the record."""
    return setting(screened_assembly(), recorded(folder, SAMPLES))


def run_briefly(assembly: Assembly, *, implicit: bool) -> None:
    """Compile the program on lanes, and run it over no sample."""
    program = assembly.lane_program
    x, u = np.zeros((len(program.states), 1)), np.zeros((0, len(program.inputs)))
    program.run(
        program.memory(x), SampledInputs(u, 1.0), assembly.values(), stepping=Stepping(1, implicit)
    )


def compile_text(assembly: Assembly) -> list[str]:
    """CPU seconds to compile from an empty cache. Another model goes first, with which the drivers
    are loaded, or compiled after an installation."""
    other = Assembly(assembly.rig)
    driver, _ = once(lambda: run_briefly(other, implicit=True))
    assembly.traced  # noqa: B018 - traced once for all
    scalar, _ = once(lambda: assembly.program.code.at(assembly.values(), partials=True))
    explicit, _ = once(lambda: run_briefly(assembly, implicit=False))
    implicit, _ = once(lambda: run_briefly(assembly, implicit=True))
    return [
        f"compiling: {scalar:.2f} s with derivatives, {explicit:.2f} s on lanes, {implicit:.2f} s "
        f"on lanes for implicit steps; the drivers {driver:.1f} s (compiled once per installation)"
    ]


def main() -> None:
    if "--narrow" in sys.argv[1:]:
        narrow_vectors()
    wide = llvm.get_host_cpu_features().get("avx512f", False)
    register = LANES if wide else 4
    print(f"vectors of {LANES} doubles, {register} in a register of {llvm.get_host_cpu_name()}")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PAMID_CACHE"] = folder
        lines = compile_text(screened_assembly())
        explicit = screened_model(Path(folder))
        lines += steps_text(explicit, "RK4")
        lines += steps_text(replace(explicit, stepping=Stepping(1, implicit=True)), "SDIRK2")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
