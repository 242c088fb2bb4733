"""What a training is asked to do: network, recordings, what counts, when to stop; all of it checked."""

import hashlib
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.errors import DataError
from pamid.networks.scaling import check_finite

Array = NDArray[np.float64]


class Network(Protocol):
    """What training asks of a network; error is target - output, J the output's derivative (bayes.py, elman.py).

    `repr` must tell the network's sizes: it is what ties a checkpoint to the network.
    """

    @property
    def n_weights(self) -> int: ...
    def initial(self, seed: int) -> Array: ...
    def simulate(self, weights: Array, inputs: Array) -> Array: ...
    def normal_equations(
        self, weights: Array, inputs: Array, target: Array, washout: int
    ) -> tuple[float, Array, Array]: ...


@dataclass(frozen=True)
class Damping:
    """The schedule of mu."""

    start: float = 0.005
    decrease: float = 0.1
    increase: float = 10.0
    largest: float = 1e10
    smallest: float = 1e-20


@dataclass(frozen=True)
class Goals:
    """When a training has converged: any one of mse, gradient, or promise together with drift.

    `mse` is the mean squared error (below the default, float64 signals in [-1, 1] are fitted exactly and beta would run
    away); `gradient` the norm of dF/dw; `promise` the share of F that a full step could still take away, `drift` the
    share by which alpha and beta moved in the last step. `stuck`: with mu at its largest, a full step that promises
    less than this share of F is taken for rounding at a minimum.
    """

    mse: float = 1e-24
    gradient: float = 1e-7
    promise: float = 1e-10
    drift: float = 1e-6
    stuck: float = 1e-4


@dataclass(frozen=True)
class Problem:
    """Recordings are (inputs (N, m), target (N,)) pairs, each simulated from a zero state."""

    network: Network
    records: tuple[tuple[Array, Array], ...]
    washout: int
    regularise: bool
    damping: Damping
    goals: Goals

    @property
    def samples(self) -> int:
        return sum(len(t) - self.washout for _, t in self.records)

    def residual(self, weights: Array) -> list[Array]:
        with np.errstate(all="ignore"):
            return [(t - self.network.simulate(weights, u))[self.washout :] for u, t in self.records]

    def sse(self, weights: Array) -> float:
        with np.errstate(all="ignore"):
            return float(sum(e @ e for e in self.residual(weights)))

    def evaluate(self, weights: Array) -> tuple[float, Array, Array] | None:
        """Sums over all recordings; None where weights are so wild that a number overflows."""
        sse, jtj, jte = 0.0, np.zeros((len(weights), len(weights))), np.zeros(len(weights))
        for u, t in self.records:
            part = self.network.normal_equations(weights, u, t, self.washout)
            sse, jtj, jte = sse + part[0], jtj + part[1], jte + part[2]
        return (sse, jtj, jte) if np.isfinite(sse) and np.isfinite(jtj).all() and np.isfinite(jte).all() else None


def recordings(inputs: object, target: object) -> tuple[tuple[Array, Array], ...]:
    """One recording or a list of them as checked pairs; DataError names recording, row and column."""
    several = isinstance(inputs, list | tuple) and len(inputs) > 0 and np.ndim(inputs[0]) == 2
    us, ts = (inputs, target) if several else ([inputs], [target])
    if len(us) != len(ts):  # type: ignore[arg-type]
        raise DataError(f"{len(us)} recordings of inputs but {len(ts)} of targets.")  # type: ignore[arg-type]
    pairs = []
    for number, (u, t) in enumerate(zip(us, ts, strict=True)):  # type: ignore[call-overload]
        u, t = np.ascontiguousarray(u, dtype=np.float64), np.ascontiguousarray(t, dtype=np.float64)
        if u.ndim != 2 or t.shape != (len(u),):
            raise DataError(f"Recording {number}: inputs (N, m) and target (N,) expected, not {u.shape} and {t.shape}.")
        check_finite(u, [f"input {j}" for j in range(u.shape[1])])
        check_finite(t[:, None], ["target"])
        pairs.append((u, t))
    return tuple(pairs)


def check_problem(problem: Problem, iterations: int, starts: int, seed: int) -> None:
    """DataError where there is nothing to fit, or less data than weights."""
    least = {"iterations": (iterations, 0), "starts": (starts, 1), "seed": (seed, 0), "washout": (problem.washout, 0)}
    for name, (value, low) in least.items():
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < low:
            raise DataError(f"Training needs {name} to be a whole number of at least {low}, not {value!r}.")
    shortest = min(len(t) for _, t in problem.records)
    if shortest <= problem.washout:
        raise DataError(f"A washout of {problem.washout} samples leaves nothing of a recording of {shortest}.")
    if problem.samples < problem.network.n_weights:
        raise DataError(
            f"{problem.samples} samples cannot decide {problem.network.n_weights} weights.",
            "Record longer, shorten the washout, or take fewer hidden units.",
        )


def fingerprint(problem: Problem, seed: int) -> str:
    """Identifies what a checkpoint belongs to; how long to train is not part of it."""
    digest = hashlib.sha256()
    for u, t in problem.records:
        digest.update(repr(u.shape).encode() + u.tobytes() + t.tobytes())
    options = (int(problem.washout), bool(problem.regularise), problem.damping, problem.goals, int(seed))
    digest.update(repr((problem.network, *options)).encode())
    return digest.hexdigest()
