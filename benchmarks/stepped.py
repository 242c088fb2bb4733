"""What stepping costs: the pendulum on a cart of the tests, with equations and stepped by Python, a
leg with contacts stepped by MuJoCo; CPU microseconds per sample and exchange: plain, with slopes,
with slopes known from an earlier run, and with steps predicted by them.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/stepped.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pamid.engine.known_slopes import PREDICTION_LIMIT
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.model.rig import Rig

sys.path[:0] = [
    str(Path(__file__).resolve().parents[1] / "tests" / part) for part in ("", "support")
]

EXAMPLE = Path(__file__).resolve().parents[1] / "data/rigs/stepped_pendulum.py"
ROUNDS = 3


def cost(
    rig: Rig, u: np.ndarray, slopes: bool = False, limit: float | None = None
) -> tuple[float, int]:
    """CPU microseconds per sample, the least of some rounds, and the number of slopes; limit:
    slopes are kept, and how far a step may be off that is not made."""
    a = Assembly(rig).for_fitting()
    program = a.program
    p, n = a.values(), len(rig.states)
    free = [i for i, b in enumerate(a.parameters) if b.fitted]
    columns = np.full(len(p), -1, np.int64)
    columns[free] = np.arange(len(free))
    wide = len(free) + n if slopes else 0
    room = None if limit is None else program.room(len(u), 1, columns)
    if room is not None:
        program = program.with_slopes(room._replace(prediction_limit=limit))
    best = np.inf
    for _ in range(ROUNDS + 1):  # the first one compiles
        memory = program.memory(a.start(p), wide, period_s=rig.period_s)
        if slopes:
            memory.S[:n, len(free) : wide] = np.eye(n)
        begun = time.process_time()
        program.run(memory, SampledInputs(u, rig.period_s), p, columns=columns if slopes else None)
        best = min(best, time.process_time() - begun)
    return 1e6 * best / len(u), wide


def main() -> None:
    from integration.test_stepped_mujoco import COMMANDS, LEG
    from pendulums import SteppedTwin, WrittenPendulum

    pushed = np.random.default_rng(0).standard_normal((2000, 1))
    with tempfile.TemporaryDirectory() as folder:
        leg = Path(folder) / "leg.xml"
        leg.write_text(LEG.format(thigh=1.0, damping=0.1, kp=8.0))
        rigs: list[tuple[str, Rig, np.ndarray]] = [
            ("equations, compiled", WrittenPendulum(), pushed),
            ("Python step (midpoint, twice)", rig_named(str(EXAMPLE)), pushed),
            ("Python step (NumPy, Runge-Kutta)", SteppedTwin(), pushed),
            ("MuJoCo, two joints and a floor", rig_named(str(leg)), COMMANDS),
        ]
        print(
            f"{'us CPU per sample':34s} {'plain':>8s} {'slopes':>8s} {'known':>8s} {'told':>8s}  by"
        )
        for name, rig, u in rigs:
            plain, (full, wide) = cost(rig, u)[0], cost(rig, u, slopes=True)
            known, told = (cost(rig, u, True, off)[0] for off in (0.0, PREDICTION_LIMIT))
            print(f"{name:34s} {plain:8.1f} {full:8.1f} {known:8.1f} {told:8.1f}  {wide}")


if __name__ == "__main__":
    main()
