"""What the scripts of this folder do alike: read the record, time steps, tell the result as one
line of JSON.

NumPy only, so that it runs in the peers' environment as well as in pamid's.
"""

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
INPUTS, HIDDEN = 5, 10


class Record(NamedTuple):
    """Inputs (N, 5), target (N,), weights to start from (171,) in the order of
    pamid.networks.elman."""

    u: Array
    target: Array
    weights: Array


def record() -> Record:
    """The record named by the first argument of the command."""
    with np.load(sys.argv[1]) as file:
        return Record(*(file[name] for name in Record._fields))


def teacher_record(samples: int, noise: float = 0.02) -> tuple[Array, Array]:
    """(u, target): a teacher network's answer to held random levels, with noise; in pamid's
    environment only."""
    from pamid.networks.elman import Elman

    network, draw = Elman(INPUTS, HIDDEN), np.random.default_rng(0)
    u = np.repeat(draw.uniform(-1.0, 1.0, (samples // 200 + 1, INPUTS)), 200, axis=0)[:samples]
    y = network.simulate(0.3 * np.random.default_rng(1).normal(size=network.n_weights), u)
    return u, y / np.abs(y).max() + noise * draw.normal(size=samples)


class Stamps:
    """CPU seconds (all threads) and wall seconds from one step to the next."""

    def __init__(self) -> None:
        self.taken: list[tuple[float, float]] = []

    def __call__(self, *_: object) -> None:
        self.taken.append((time.process_time(), time.perf_counter()))

    @property
    def step(self) -> dict[str, float]:
        """Mean over the steps between the first stamp and the last."""
        count = len(self.taken) - 1
        cpu, wall = (np.array(self.taken[-1]) - self.taken[0]) / count
        return {"cpu_s": float(cpu), "wall_s": float(wall), "steps": count}


def cpu_seconds(call: Callable[[], object], repeats: int) -> float:
    """The fastest of several calls."""
    stamps = Stamps()
    stamps()
    for _ in range(repeats):
        call()
        stamps()
    return float(np.diff([cpu for cpu, _ in stamps.taken]).min())


def dgemm_rate(repeats: int) -> float:
    """Floating-point operations per second of a square matrix product."""
    a = np.random.default_rng(0).normal(size=(1000, 1000))
    return 2.0 * 1000**3 / cpu_seconds(lambda: a @ a, repeats)


def peak_mb() -> float:
    """Largest resident memory of this process so far, MB (1e6 bytes).

    VmHWM where the system has it: ru_maxrss of a child begins at its parent's memory.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1.024e-3
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit * 1e-6


def tell(jte: Array | None, **figures: object) -> None:
    """Print the figures; `jte` is J'e at the record's weights, in pamid's order."""
    print(json.dumps({"jte": None if jte is None else [float(v) for v in jte], **figures}))
