"""Where a training stands, on disk: enough to go on exactly as if nobody had stopped it."""

import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.files import write_atomically
from pamid.base.npz import load_arrays
from pamid.networks.bayes import Evidence


class TrainingStep(NamedTuple):
    """A row of the trace, after an accepted step (row 0: the start).

    `mse` is the mean squared error over the samples used; `gradient` the norm of dF/dw; `mu` the
    damping the next step begins with; `gamma`, `alpha`, `beta` as re-estimated at these weights;
    `trials` how many steps were simulated until a step was accepted. No times: the same training
    always gives the same rows.
    """

    iteration: int
    mse: float
    gradient: float
    mu: float
    gamma: float
    alpha: float
    beta: float
    trials: int


@dataclass(frozen=True)
class Attempt:
    """A random start: weights it has reached, trace, and why it stopped ("" while it runs)."""

    start: int
    weights: Array
    mu: float
    evidence: Evidence
    steps: tuple[TrainingStep, ...]
    why: str = ""
    converged: bool = False

    @property
    def mse(self) -> float:
        return self.steps[-1].mse if self.steps else float("inf")


_STORED = ("weights", "numbers", "steps", "why")


def save_checkpoint(path: Path, problem: str, attempts: Iterable[Attempt]) -> None:
    """Write all attempts so far as a whole; `problem` identifies data, network, options."""
    arrays: dict[str, NDArray] = {"problem": np.array(problem)}
    for k, a in enumerate(attempts):
        e = a.evidence
        arrays[f"weights_{k}"] = a.weights
        arrays[f"numbers_{k}"] = np.array(
            [a.start, a.mu, e.gamma, e.alpha, e.beta, a.converged], dtype=np.float64
        )
        arrays[f"steps_{k}"] = np.array(a.steps, dtype=np.float64).reshape(
            len(a.steps), len(TrainingStep._fields)
        )
        arrays[f"why_{k}"] = np.array(a.why)
    # In memory first: the file is replaced as a whole, so that an interruption leaves the
    # checkpoint before.
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write_atomically(Path(path), buffer.getvalue())


def load_checkpoint(path: Path, problem: str, n_weights: int) -> dict[int, Attempt]:
    """Attempts, by the number of their start, in a checkpoint of this very problem; FileError when
    it is another's, or no checkpoint at all."""
    # The fingerprint comes first: weights of another network could have the right shape by chance.
    arrays = load_arrays(Path(path))
    if "problem" not in arrays or str(arrays["problem"]) != problem:
        raise FileError(
            f"{path} belongs to another training: its data, network, seed or options differ.",
            "Train afresh, or repeat the options of the interrupted training.",
        )
    attempts = {}
    for k in range((len(arrays) - 1) // len(_STORED)):
        try:
            weights, numbers, steps, why = (arrays[f"{field}_{k}"] for field in _STORED)
        except KeyError as missing:
            raise FileError(
                f"{path} is not a complete checkpoint: {missing} is missing.", "Train afresh."
            ) from None
        if (
            weights.shape != (n_weights,)
            or numbers.shape != (6,)
            or steps.shape[1:] != (len(TrainingStep._fields),)
        ):
            raise FileError(f"{path}: attempt {k} has arrays of the wrong shape.", "Train afresh.")
        # Whole numbers are stored as floats. A NaN among them would only fail later, in a
        # comparison.
        counts = (numbers[:1], steps[:, 0], steps[:, -1])
        if not all(c.dtype.kind in "fiu" and np.isfinite(c).all() for c in counts):
            raise FileError(
                f"{path}: attempt {k} has counts that are not finite numbers.", "Train afresh."
            )
        start, mu, gamma, alpha, beta, converged = numbers.tolist()
        rows = tuple(TrainingStep._make((int(r[0]), *r[1:-1], int(r[-1]))) for r in steps.tolist())
        evidence = Evidence(gamma, alpha, beta)
        attempts[int(start)] = Attempt(
            int(start), weights, mu, evidence, rows, str(why), bool(converged)
        )
    return attempts
