"""The two-link arm: a free run and one with sensitivities, beside MuJoCo on the links alone.

    python benchmarks/arm.py

66667 samples of 3 ms under random commands at both joints, as a fit would step them. CPU seconds,
medians of 9. MuJoCo steps a double pendulum of the same links by RK4, once per sample and without
muscles, valves or air; its loop over the samples runs in Python, so a loop that does nothing is
taken off. The last lines say how far the two are apart on accelerations, relative to the largest of
the two joints, at 1000 random states.
"""

from __future__ import annotations

import os

from pamid.engine.sampled_inputs import SampledInputs

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import sys
from pathlib import Path

import numpy as np
from timing import cpu

from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.simulation.free_runs import choose_stepping

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path[:0] = [str(TESTS / "unit"), str(TESTS / "support")]  # test_two_link.py and its helpers

SAMPLES, PERIOD_S = 66667, 0.003
WANTED_S = 0.15


def measured() -> dict[str, float]:
    """CPU seconds of a free run and of one with nine sensitivities; steps per sample."""
    rig = rig_named("two-link")
    a = Assembly(rig, outputs=tuple(c for c in rig.outputs if not c.startswith("force")))
    p, random = a.values(), np.random.default_rng(0)
    u = np.zeros((SAMPLES, 4))
    for joint in (0, 1):
        u[:, joint] = np.repeat(random.uniform(-0.5, 0.5, SAMPLES // 300 + 1), 300)[:SAMPLES]
    step = choose_stepping(a, u, p, PERIOD_S, a.start(p))
    chosen = np.full(len(p), -1, np.int64)
    chosen[np.flatnonzero([b.fitted for b in a.parameters])[:9]] = np.arange(9)

    def run(columns: int = 0) -> None:
        memory = a.program.memory(a.start(p), columns, stepping=step, period_s=PERIOD_S)
        _, _, bad = a.program.run(
            memory,
            SampledInputs(u, PERIOD_S),
            p,
            stepping=step,
            columns=chosen if columns else None,
        )
        assert bad < 0, "the arm became unstable"

    return {"free": cpu(run), "nine": cpu(lambda: run(9)), "substeps": step.substeps}


def beside_mujoco() -> tuple[float, float]:
    """MuJoCo's CPU seconds for the links alone, and how far accelerations are apart; ImportError
    where there is no MuJoCo."""
    import mujoco
    from test_two_link import arm, furthest_acceleration, judge

    a = arm()
    model, data = judge(a, a.values(), step=PERIOD_S)

    def stepped() -> None:
        mujoco.mj_resetData(model, data)
        for _ in range(SAMPLES):
            mujoco.mj_step(model, data)

    def idle() -> None:
        for _ in range(SAMPLES):
            mujoco.mj_version()

    return cpu(stepped) - cpu(idle), furthest_acceleration()


def main() -> None:
    """Print all figures."""
    ours = measured()
    free = ours["free"]
    print(
        f"free run of {SAMPLES} samples, {ours['substeps']} step(s) each: {1e3 * free:.1f} ms "
        f"({'within' if free <= WANTED_S else 'MISSES'} the {1e3 * WANTED_S:.0f} ms wanted)"
    )
    print(
        f"with 9 exact sensitivities: {1e3 * ours['nine']:.1f} ms ({ours['nine'] / free:.1f} times)"
    )
    try:
        peer, apart = beside_mujoco()
    except ImportError as error:
        print(f"MuJoCo: left out ({error})")
        return
    print(
        f"MuJoCo, links only, RK4, one step per sample: {1e3 * peer:.1f} ms ({peer / free:.1f} "
        "times the whole arm)"
    )
    print(f"accelerations apart by {apart:.1e} at most")


if __name__ == "__main__":
    main()
