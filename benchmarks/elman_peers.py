"""CPU time of Levenberg-Marquardt training of the paper's Elman network: pamid against what else a
user would take.

    python benchmarks/elman_peers.py [--environment FOLDER] [--peers jax,pyrenn,scipy,torch]
    [--samples 66667]

One run, one core, float64, the same record and first weights for all. Every row is a process of its
own (benchmarks/peers/), one after the other, bound to one core by its affinity, BLAS and XLA held
to one thread; seconds are CPU seconds of all the process's threads, so a busy machine disturbs them
little (it still shares caches and memory with others). A step is one iteration from derivative pass
to derivative pass, trial simulations included. JAX and pyrenn live in an environment of their own,
made once; nothing is installed into pamid's.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from peers.environment import CACHE, python_with

HERE = Path(__file__).resolve().parent
REQUIRED = ["jax", "numpy>=2,<3", "pyrenn==0.1"]
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
MEMORY_TARGET_MB = 300.0
EXACT = 1e-8  # deviation of J'e, as a share of its largest entry


@dataclass(frozen=True)
class Row:
    what: str
    script: str
    arguments: tuple[str, ...] = ()
    target: float | None = None  # how many times our step it should take
    own_environment: bool = False


PEERS = {
    "jax": [
        Row("JAX, jacfwd, input product outside the scan", "jax_lm.py", ("outside",), 12.0, True),
        Row("JAX, jacfwd, everything inside the scan", "jax_lm.py", ("inside",), 12.0, True),
        Row("JAX, our sensitivities written by hand", "jax_lm.py", ("by-hand",), None, True),
    ],
    "pyrenn": [Row("pyrenn train_LM", "pyrenn_lm.py", (), 70.0, True)],
    "scipy": [
        Row("scipy least_squares lm, our Jacobian", "scipy_lm.py", ("lm",)),
        Row("scipy least_squares trf, our Jacobian", "scipy_lm.py", ("trf",)),
    ],
    "torch": [Row("torch jacfwd, the pass alone", "torch_pass.py")],
}


def write_record(path: Path, samples: int) -> None:
    """A teacher network's answer (measuring.py) and weights to start from."""
    from peers.measuring import teacher_record

    from pamid.networks.elman import Elman

    u, target = teacher_record(samples)
    np.savez(path, u=u, target=target, weights=Elman().initial(2))


def figures(row: Row, python: Path, path: Path) -> dict[str, Any]:
    """What a script tells in the last line it prints."""
    command = [str(python), str(HERE / "peers" / row.script), str(path), *row.arguments]
    variables = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(HERE)}
    done = subprocess.run(command, env=variables, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{row.script} {' '.join(row.arguments)} failed:\n{done.stderr[-2000:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def exactness(jte: list[float] | None, ours: list[float]) -> str:
    if jte is None:
        return "-"
    apart = np.abs(np.subtract(jte, ours)).max() / np.abs(ours).max()
    return f"{'exact' if apart <= EXACT else 'NOT exact'} ({apart:.0e})"


def line(row: Row, found: dict[str, Any], ours: dict[str, Any]) -> str:
    ratio = found["cpu_s"] / ours["cpu_s"]
    target = (
        "" if row.target is None else f">= {row.target:g} {'ok' if ratio >= row.target else 'NO'}"
    )
    wall = "-" if found["wall_s"] is None else f"{found['wall_s']:.3f}"
    remark = f"{found['version']}, {found['steps']} steps" if found["steps"] else found["version"]
    if "measured_samples" in found:
        remark += f", SCALED from {found['measured_samples']} samples"
    return (
        f"{row.what:46s} {found['cpu_s']:9.3f} {wall:>9s} {ratio:8.1f} {target:>9s} "
        f"{found['peak_mb']:9.0f}  {exactness(found['jte'], ours['jte']):18s} {remark}"
    )


def show_ours(ours: dict[str, Any], samples: int, core: str) -> None:
    memory = "ok" if ours["peak_mb"] <= MEMORY_TARGET_MB else "NO"
    print(
        f"Elman 5-10-1, 171 weights, N = {samples}, float64; {core}; load "
        f"{os.getloadavg()[0]:.1f} at the start"
    )
    print(
        f"dgemm in our process {ours['dgemm_gf_s']:.1f} GF/s; our pass alone {ours['pass_s']:.4f} "
        "s CPU; "
        f"our peak memory {ours['peak_mb']:.0f} MB, target <= {MEMORY_TARGET_MB:g} MB {memory}"
    )
    print(
        f"{'':46s} {'CPU s':>9s} {'wall s':>9s} {'times':>8s}  {'':8s} {'peak MB':>9s}  "
        f"{'gradient J’e':18s}"
    )
    print(f"{'':46s} {'per step':>9s} {'per step':>9s} {'ours':>8s} {'target':>9s}")
    print(
        f"{'pamid train, Bayesian regularisation':46s} {ours['cpu_s']:9.3f} {ours['wall_s']:9.3f} "
        f"{1.0:8.1f} {'':9s} {ours['peak_mb']:9.0f}  {'(the measure)':18s} {ours['steps']} steps",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--environment", type=Path, default=CACHE / "peers")
    parser.add_argument("--peers", default=",".join(PEERS), help="of " + ", ".join(PEERS))
    parser.add_argument("--samples", type=int, default=66_667)
    options = parser.parse_args()
    chosen = options.peers.split(",")
    for name in chosen:
        if name not in PEERS:
            parser.error(f"no peer named {name!r}; there are {', '.join(PEERS)}")
    rows = [row for name in chosen for row in PEERS[name]]
    own = Path(sys.executable)
    theirs = (
        python_with(options.environment, REQUIRED)
        if any(row.own_environment for row in rows)
        else own
    )
    core = "not bound to a core (this system cannot)"
    if hasattr(os, "sched_setaffinity"):
        number = max(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {number})  # the processes started from here inherit it
        core = f"bound to core {number}"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.npz"
        write_record(path, options.samples)
        ours = figures(Row("pamid", "ours.py"), own, path)
        show_ours(ours, options.samples, core)
        for row in rows:
            print(
                line(row, figures(row, theirs if row.own_environment else own, path), ours),
                flush=True,
            )


if __name__ == "__main__":
    main()
