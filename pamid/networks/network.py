"""What every network of this package is: five things of its own, and what follows from them.

A kind of network is a module with a frozen dataclass derived from `Network`, its sizes as fields
(`repr` ties a checkpoint to them, network.json holds them). Weights are one flat float64 vector,
passed to every verb; inputs and target are scaled into [-1, 1]. Choose weights whose natural value
is zero: regularisation pulls them there.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.base.errors import DataError
from pamid.networks.normal_equations import Rows, summed
from pamid.symbolic.memory_cells import Cell
from pamid.symbolic.vocabulary import Expr, expression

Array = NDArray[np.float64]

ASIDE = 0.1  # of a step: where its second derivative is probed
Records = Sequence[tuple[Array, Array]]


def weighted(weights: Array, values: Sequence[Expr], added: Iterable[Expr | float]) -> list[Expr]:
    """weights (rows, columns) @ values + added, as equations."""
    return [
        sum((w * v for w, v in zip(row, values, strict=True)), start=expression(first))
        for row, first in zip(weights.tolist(), added, strict=True)
    ]


class Network(ABC):
    """A map from inputs (N, m) to an output (N,), from a zero state; error is target - output, J
    the output's derivative with respect to the weights.

    Weights so wild that numbers overflow give inf or NaN, never an exception; DataError is for
    wrong shapes.
    """

    kind: ClassVar[str]
    inputs: int

    @property
    @abstractmethod
    def n_weights(self) -> int: ...

    @property
    def linear(self) -> slice:
        """The weights in which the output is linear: simulate(w, u) = features(w, u) @
        w[linear]."""
        return slice(0, 0)

    @abstractmethod
    def initial(self, seed: int) -> Array:
        """A random start that knows no data."""

    def start(self, records: Records, washout: int, seed: int) -> Array:
        """A random start for these recordings, (inputs (N, m), target (N,)) each."""
        return self.initial(seed)

    @abstractmethod
    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Output (N,)."""

    def equations(
        self, weights: ArrayLike, inputs: Sequence[Expr], name: str
    ) -> tuple[Expr, tuple[Cell, ...]]:
        """The output as an equation of the inputs (scaled), and the cells, led by `name`, in which
        it remembers: sample by sample the same as `simulate`. DataError where a kind of network has
        none."""
        raise DataError(
            f"A network of kind {self.kind!r} has no equations, so that it cannot run beside a "
            "model."
        )

    def features(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """What the weights `linear` multiply (N, number of these)."""
        return np.empty((len(np.asarray(inputs)), 0))

    @abstractmethod
    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """(first sample, y (n,), dy/dw (n, n_weights)) chunk by chunk, exact.

        Arrays may be overwritten by the next chunk but one.
        """

    def flat(self, weights: ArrayLike) -> Array:
        """The weights (n_weights,) as they are computed with; DataError when there are not that
        many."""
        flat = np.ascontiguousarray(weights, dtype=np.float64)
        if flat.shape != (self.n_weights,):
            raise DataError(
                f"{self!r} has {self.n_weights} weights in one vector, not an array of shape "
                f"{flat.shape}."
            )
        return flat

    def table(self, inputs: ArrayLike) -> Array:
        """The inputs (N, m) as they are computed with; DataError where they have another shape."""
        u = np.ascontiguousarray(inputs, dtype=np.float64)
        if u.ndim != 2 or u.shape[1] != self.inputs:
            raise DataError(f"{self!r} takes inputs (N, {self.inputs}), not {u.shape}.")
        return u

    def normal_equations(
        self,
        weights: ArrayLike,
        inputs: ArrayLike,
        target: ArrayLike,
        washout: int = 0,
        threads: int = 1,
    ) -> tuple[float, Array, Array]:
        """One pass: (sum of e^2, J'J, J'e) over samples `washout` .. N-1; J is never held whole.

        Sensitivities run from sample 0 on, so washed-out samples only leave the sums. With two
        threads one makes a chunk while the other adds the one before: the same result in less time.
        """
        wanted = np.ascontiguousarray(target, dtype=np.float64)
        if wanted.shape != (len(np.asarray(inputs)),):
            raise DataError(
                f"Target has shape {wanted.shape} for {len(np.asarray(inputs))} samples of input."
            )
        return summed(self.sweep(weights, inputs), wanted, self.n_weights, washout, threads)

    def curvature(
        self, weights: ArrayLike, step: ArrayLike, inputs: ArrayLike, washout: int = 0
    ) -> Array:
        """J' times the second derivative of the output along a change of the weights, over samples
        `washout` .. N-1; here the latter by a central difference."""
        w, v = np.asarray(weights, dtype=np.float64), ASIDE * np.asarray(step, dtype=np.float64)
        with np.errstate(all="ignore"):
            forward, here, backward = (self.simulate(at, inputs) for at in (w + v, w, w - v))
            second = (forward - 2.0 * here + backward) / ASIDE**2
            second[:washout] = 0.0
            return np.sum(
                [second[k : k + len(j)] @ j for k, _, j in self.sweep(weights, inputs)], axis=0
            )

    def jacobian(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """dy/dw (N, n_weights), the whole record at once: for tests and small records."""
        return np.concatenate(
            [np.empty((0, self.n_weights))] + [j.copy() for _, _, j in self.sweep(weights, inputs)]
        )
