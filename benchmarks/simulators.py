"""What a MuJoCo model of seven joints costs as equations: CPU seconds to read and to assemble it,
cold and from the cache, of a free run of 66667 steps, and of one with the sensitivities of a fit;
beside it MuJoCo's own steps over the same commands, alone and with its Jacobians of a step by the
states and the commands (mjd_transitionFD, forward differences; by Euler where the model says RK4,
which it does not take). Those say nothing of parameters: each of them costs one more run there.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/simulators.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SAMPLES, PERIOD_S, REPEATS = 66667, 0.002, 5


def _costs(file: Path) -> None:
    """Print what one process needs; the cache is what $PAMID_CACHE holds."""
    from pamid.engine import integrator  # noqa: F401  its own start is not the model's
    from pamid.model.assembly import Assembly
    from pamid.model.registry import rig_named

    begun = time.process_time()
    assembly = Assembly(rig_named(str(file))).for_fitting()
    read = time.process_time()
    program = assembly.program
    made = time.process_time()
    random = np.random.default_rng(0)
    levels = random.uniform(-1.0, 1.0, (SAMPLES // 200 + 1, len(program.inputs)))
    size = [assembly.rig.excited[name] for name in program.inputs]
    u = np.repeat(levels * size, 200, axis=0)[:SAMPLES]
    p = assembly.values()
    columns = np.full(len(program.parameters), -1, np.int64)
    wanted = [i for i, name in enumerate(program.parameters) if name in program.sensitive]
    columns[wanted] = np.arange(len(wanted))

    def once(width: int) -> float:
        memory = program.memory(assembly.start(p), width)
        before = time.process_time()
        program.run(memory, u, p, period_s=PERIOD_S, columns=columns if width else None)
        return time.process_time() - before

    plain = float(np.median([once(0) for _ in range(REPEATS)]))
    wide = float(np.median([once(len(wanted)) for _ in range(REPEATS)]))
    print(
        f"  read {read - begun:.2f} s, assembled {made - read:.2f} s; "
        f"{SAMPLES} steps {plain:.3f} s, "
        f"with {len(wanted)} sensitivities {wide:.2f} s ({wide / plain:.1f} times)"
    )


def _mujoco_costs(file: Path) -> None:
    """Print what MuJoCo's own steps cost; the Jacobians over a tenth of them."""
    import mujoco

    from pamid.model.registry import rig_named

    rig = rig_named(str(file))
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.timestep = PERIOD_S
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    levels = random.uniform(-1.0, 1.0, (SAMPLES // 200 + 1, model.nu))
    size = [rig.excited[name] for name in rig.inputs]
    u = np.repeat(levels * size, 200, axis=0)[:SAMPLES]
    states = 2 * model.nv + model.na
    a, b = np.zeros((states, states)), np.zeros((states, model.nu))

    def once(samples: int, *, jacobians: bool) -> float:
        mujoco.mj_resetData(model, data)
        before = time.process_time()
        for row in u[:samples]:
            data.ctrl[:] = row
            if jacobians:
                mujoco.mjd_transitionFD(model, data, 1e-6, False, a, b, None, None)
            mujoco.mj_step(model, data)
        return time.process_time() - before

    part = SAMPLES // 10
    plain = float(np.median([once(SAMPLES, jacobians=False) for _ in range(REPEATS)]))
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    tenth = float(np.median([once(part, jacobians=True) for _ in range(REPEATS)]))
    print(
        f"  {SAMPLES} steps {plain:.3f} s; with mjd_transitionFD ({states} states, {model.nu} "
        f"commands) {tenth:.2f} s for a tenth of them, {tenth * SAMPLES / part:.1f} s for all "
        f"({tenth * SAMPLES / part / plain:.0f} times)"
    )


def main() -> None:
    if len(sys.argv) > 1:
        (_costs if sys.argv[1] == "pamid" else _mujoco_costs)(Path(sys.argv[2]))
        return
    sys.path.insert(0, str(ROOT / "tests/support"))
    import mechanisms

    models = {
        "two joints": mechanisms.TWO,
        "seven joints without friction losses": mechanisms.SEVEN.replace(' frictionloss="0.1"', ""),
        "seven joints with friction losses": mechanisms.SEVEN,
    }
    with tempfile.TemporaryDirectory() as folder:
        for name, text in models.items():
            file = Path(folder) / "model.xml"
            file.write_text(text)
            cache = {"PAMID_CACHE": str(Path(folder) / name.replace(" ", "_"))}
            for state in ("cold", "from the cache"):
                print(f"{name}, {state}:", flush=True)
                subprocess.run(
                    [sys.executable, __file__, "pamid", file],
                    env={**os.environ, **cache},
                    check=True,
                )
            print(f"{name}, MuJoCo's own steps:", flush=True)
            subprocess.run([sys.executable, __file__, "mujoco", file], check=True)


if __name__ == "__main__":
    main()
