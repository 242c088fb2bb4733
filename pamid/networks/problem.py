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
    """What training asks of a network; error is target - output, J the output's derivative (bayes.py, elman.py)."""

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
    """Reaching one of these ends a training as converged: mean squared error, or norm of dF/dw.

    Below the default mse, float64 signals in [-1, 1] are fitted exactly and beta would run away.
    """

    mse: float = 1e-24
    gradient: float = 1e-7


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


def check_problem(problem: Problem, iterations: int, starts: int) -> None:
    """DataError where there is nothing to fit, or less data than weights."""
    if iterations < 0 or starts < 1 or problem.washout < 0:
        raise DataError(
            f"Training takes iterations >= 0, starts >= 1 and washout >= 0, "
            f"not {iterations}, {starts} and {problem.washout}."
        )
    shortest = min(len(t) for _, t in problem.records)
    if shortest <= problem.washout:
        raise DataError(f"A washout of {problem.washout} samples leaves nothing of a recording of {shortest}.")
    if problem.samples < problem.network.n_weights:
        raise DataError(
            f"{problem.samples} samples cannot decide {problem.network.n_weights} weights.",
            "record longer, shorten the washout, or take fewer hidden units",
        )


def fingerprint(problem: Problem, seed: int) -> str:
    """Identifies what a checkpoint belongs to; how long to train is not part of it."""
    digest = hashlib.sha256()
    for u, t in problem.records:
        digest.update(repr(u.shape).encode() + u.tobytes() + t.tobytes())
    settings = (problem.network, problem.washout, problem.regularise, problem.damping, seed)
    digest.update(repr(settings).encode())
    return digest.hexdigest()
