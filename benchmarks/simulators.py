"""What a MuJoCo model of seven joints costs as equations: CPU seconds to read and to assemble it,
cold and from the cache, of a free run of 66667 steps, and of one with the sensitivities of a fit.

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


def main() -> None:
    if len(sys.argv) > 1:
        _costs(Path(sys.argv[1]))
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
                    [sys.executable, __file__, file], env={**os.environ, **cache}, check=True
                )


if __name__ == "__main__":
    main()
