"""A linear model by modes, from which a recurrent network can begin: few damped oscillations, found
in the data.

With complex poles p, |p| < 1, the model is
    z(k+1) = p z(k) + r . u(k),   y(k) = b + sum over modes of Re z(k+1)
Given the poles it is linear in the residues r: poles are drawn at random and chosen greedily, each
with the residues of all inputs that lower the squared error most (orthogonal least squares; Chen,
Cowan and Grant 1991, IEEE TNN 2(2)). A start with the slow and the lightly damped parts of
what it has to learn matters more than anything that comes after: gradients of a free-running
network say little about memories it does not have yet.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array

Complex = NDArray[np.complex128]

POOL = 80  # poles drawn, of which a few are chosen
TURN = (0.003, 0.5)  # rad per sample: from slowest to fastest oscillation
QUALITY = (0.3, 30.0)  # memory (samples) times turn: from overdamped to ringing
LONGEST_MEMORY = 3000.0  # samples: no longer memory
# samples that choose: more would change the time it takes, not the choice
MOST_SCAN_ROWS = 7000
# of a feature's mean square, on the residues: keeps cancelling pairs small
RESIDUE_RIDGE = 1e-6


@dataclass(frozen=True)
class Modes:
    """poles (n,), residues (n, inputs), bias."""

    poles: Complex
    residues: Complex
    bias: float

    def states(self, inputs: Array) -> Complex:
        """z(k+1) of every mode (N, n) from rest."""
        return np.stack(
            [_from_rest(inputs @ r, p) for p, r in zip(self.poles, self.residues, strict=True)],
            axis=1,
        )


def find_modes(
    records: Sequence[tuple[Array, Array]], washout: int, count: int, seed: int
) -> Modes:
    """`count` modes for recordings of (inputs (N, m), target (N,)), each from rest; another seed
    draws other poles."""
    random = np.random.default_rng(seed)
    turn, quality = (
        # Uniform on logarithms: time constants of a machine span decades, and each decade gets as
        # many poles.
        low * (high / low) ** random.uniform(size=POOL)
        for low, high in (TURN, QUALITY)
    )
    poles = np.exp(-1.0 / np.minimum(quality / turn, LONGEST_MEMORY) + 1j * turn)
    # Responses run over all samples, and only then are rows left out: a pole needs its whole past.
    every = max(1, sum(len(t) - washout for _, t in records) // MOST_SCAN_ROWS)
    rows = slice(washout, None, every)
    target = np.concatenate([t[rows] for _, t in records])
    # Regressors of the real and the imaginary parts of the residues of each mode (N, 2 m), divided
    # by its static gain 1 / |1 - p|, so that slow modes do not look large: the ridge then weighs
    # the residues of all alike.
    parts = []
    for pole in poles:
        responses = [_from_rest(u, pole) * abs(1.0 - pole) for u, _ in records]
        columns = [np.concatenate([z.real, -z.imag], axis=1)[rows] for z in responses]
        parts.append(np.concatenate(columns))
    chosen: list[int] = []
    basis = np.ones((len(target), 1))
    for _ in range(count):
        remaining = target - basis @ _least_squares(basis, target)
        # only what is orthogonal to the modes already chosen can lower the error further
        orthogonal = np.linalg.qr(basis)[0]
        gains = [
            -1.0 if i in chosen else _gain(part - orthogonal @ (orthogonal.T @ part), remaining)
            for i, part in enumerate(parts)
        ]
        chosen.append(int(np.argmax(gains)))
        basis = np.column_stack([basis, parts[chosen[-1]]])
    weights = _least_squares(basis, target)
    pairs = weights[1:].reshape(count, 2, -1)
    chosen_poles = poles[chosen]
    return Modes(
        chosen_poles,
        (pairs[:, 0] + 1j * pairs[:, 1]) * np.abs(1.0 - chosen_poles)[:, None],
        float(weights[0]),
    )


def _from_rest(inputs: Array | Complex, pole: complex) -> Complex:
    """z(k) = pole z(k-1) + inputs(k) from rest, column by column."""
    from scipy.signal import lfilter  # takes half a second to load

    response: Complex = lfilter([1.0], [1.0, -pole], inputs, axis=0)
    return response


def _gain(features: Array, left: Array) -> float:
    """Drop of the squared error by these features."""
    towards = features.T @ left
    return float(towards @ np.linalg.solve(_ridge_gram(features), towards))


def _least_squares(features: Array, target: Array) -> Array:
    return np.asarray(np.linalg.solve(_ridge_gram(features), features.T @ target))


def _ridge_gram(features: Array) -> Array:
    gram = features.T @ features
    # Relative to the features, so that the choice of modes does not depend on a unit.
    gram[np.diag_indices(len(gram))] += RESIDUE_RIDGE * max(np.trace(gram) / len(gram), 1e-300)
    return gram
