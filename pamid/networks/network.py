"""Interface of every network of this package: five abstract methods, and the methods derived from
them.

A kind of network is a module with a frozen dataclass derived from `Network`, its sizes as fields
(`repr` ties a checkpoint to them, network.json holds them). Weights are a flat float64 vector,
passed to every method; inputs and target are scaled into [-1, 1]. Choose weights whose natural
value is zero: regularisation pulls them there.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.engine.symbolic.memory_cells import Cell
from pamid.engine.symbolic.vocabulary import Expr, expression
from pamid.networks.onnx_nodes import OnnxNodes
from pamid.networks.root_sums import RootSums

ASIDE = 0.1  # of a step: where its second derivative is probed
HIDDEN = 10  # default number of units: the first paper's
# samples whose Jacobian rows a network holds at once: 0.8 MB at 95 weights, 1.4 MB at 171, so that
# they stay inside a processor's second-level cache while they are summed
CHUNK = 1024
Records = Sequence[tuple[Array, Array]]
Rows = tuple[int, Array, Array]  # first sample, output (n,), its derivative (n, n_weights)


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
    #: sizes that `pamid train-residual` offers as options: name -> least, most, what it is, what is
    #: taken without it. A literal: the command line reads it from the text of the file.
    size_options: ClassVar[dict[str, tuple[int, int, str, str]]] = {}
    inputs: int

    @classmethod
    def sized(
        cls, inputs: int, period_s: float, samples: int | None = None, **sizes: int
    ) -> "Network":
        """The network for this many inputs, sampled every `period_s`, to be trained on this many
        samples; sizes that are not among `sizes` follow from these: at most `HIDDEN` units, with no
        more weights than samples where there is a network that small. UsageError where it would be
        too large."""
        choices: list[dict[str, int]] = [sizes]
        if "hidden" in cls.size_options and not sizes:
            choices = [{"hidden": hidden} for hidden in range(HIDDEN, 0, -1)]
        networks = [cls(inputs, **cls.at_period(period_s), **choice) for choice in choices]  # type: ignore[call-arg]
        return next(
            (n for n in networks if samples is None or n.n_weights <= samples), networks[-1]
        )

    @classmethod
    def at_period(cls, period_s: float) -> dict[str, int]:
        """Sizes that follow from the sampling period."""
        return {}

    def words(self) -> str:
        """Kind and sizes as people write them."""
        sizes = ", ".join(f"{name} {value}" for name, value in vars(self).items())
        return f"{self.kind} ({sizes})"

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
        """A random start without data."""

    def start(self, records: Records, washout: int, seed: int) -> Array:
        """A random start for these recordings, (inputs (N, m), target (N,)) each."""
        return self.initial(seed)

    def random_start(self, seed: int) -> Array:
        """The start of a training as in the first paper: a start without data."""
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
            f"A network of kind {self.kind!r} has no equations, so that it cannot run with a model."
        )

    @property
    def memory_size(self) -> int:
        """Numbers that `onnx_nodes` carries between samples, all zero before the first."""
        return 0

    def onnx_nodes(
        self, g: OnnxNodes, weights: Array, given: str, memory: str, first: str
    ) -> tuple[str, str]:
        """The same sample in matrices, which ONNX runs faster than single equations: scaled
        output (1,) and next memory (memory_size,), for scaled inputs given (m,); `first` is true at
        the first sample. Without memory that name is passed on. DataError where a kind of network
        has only its equations: a model with it is written with those."""
        raise DataError(f"A network of kind {self.kind!r} by itself cannot be written as ONNX.")

    @property
    def in_matrices(self) -> bool:
        """Whether it has separate `onnx_nodes`."""
        return type(self).onnx_nodes is not Network.onnx_nodes

    def features(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Regressors of the weights `linear` (N, number of these)."""
        return np.empty((len(np.asarray(inputs)), 0))

    def growth(self, weights: ArrayLike, features: Array) -> float:
        """Sum over a record's samples of the logarithm by which a small disturbance of the state
        grows along the run that had these `features`: divided by the samples, the largest Lyapunov
        exponent. -inf where nothing is carried on, and for a kind of network that does not say."""
        return -np.inf

    @abstractmethod
    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """(first sample, y (n,), dy/dw (n, n_weights)) chunk by chunk, exact.

        Arrays may be overwritten two chunks later.
        """

    def require_sizes(self, **least: int) -> None:
        """DataError for a size that is not a whole number of at least this."""
        for name, low in least.items():
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < low:
                raise DataError(
                    f"{type(self).__name__}: {name} must be a whole number of at least {low}, not "
                    f"{value!r}."
                )

    def flat(self, weights: ArrayLike) -> Array:
        """The weights (n_weights,) as float64; DataError when there are not that many."""
        # Compiled kernels are specialised for contiguous float64; another layout would compile
        # them anew.
        flat = np.ascontiguousarray(weights, dtype=np.float64)
        if flat.shape != (self.n_weights,):
            raise DataError(
                f"{self!r} has {self.n_weights} weights in a vector, not an array of shape "
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
        """A pass: (sum of e^2, J'J, J'e) over samples `washout` .. N-1; J is never held whole.

        Sensitivities run from sample 0 on, so washed-out samples only leave the sums. With two
        threads the first makes a chunk while the second adds the chunk before: the same result in
        less time.
        """
        sums = RootSums(self.n_weights)
        self.add_to(sums, weights, inputs, target, washout, threads)
        return sums.sse, sums.jtj, sums.jte

    def add_to(
        self,
        sums: RootSums,
        weights: ArrayLike,
        inputs: ArrayLike,
        target: ArrayLike,
        washout: int = 0,
        threads: int = 1,
    ) -> None:
        """Add the normal equations of a recording to those of the others."""
        wanted = np.ascontiguousarray(target, dtype=np.float64)
        if wanted.shape != (len(np.asarray(inputs)),):
            raise DataError(
                f"Target has shape {wanted.shape} for {len(np.asarray(inputs))} samples of input."
            )
        chunks = self.sweep(weights, inputs)
        with np.errstate(all="ignore"):
            for start, y, jacobian in _computed_ahead(chunks) if threads > 1 else chunks:
                skip = min(max(washout - start, 0), len(y))
                sums.add(jacobian[skip:], wanted[start + skip : start + len(y)] - y[skip:])

    def curvature(
        self, weights: ArrayLike, step: ArrayLike, inputs: ArrayLike, washout: int = 0
    ) -> Array:
        """J' times the second derivative of the output along a change of the weights, over samples
        `washout` .. N-1; here the latter by a central difference."""
        # Probed at a tenth of the step: nearer, rounding enters the second difference; farther,
        # higher derivatives do.
        w, v = np.asarray(weights, dtype=np.float64), ASIDE * np.asarray(step, dtype=np.float64)
        with np.errstate(all="ignore"):
            forward, middle, backward = (self.simulate(at, inputs) for at in (w + v, w, w - v))
            second = (forward - 2.0 * middle + backward) / ASIDE**2
            second[:washout] = 0.0
            return np.sum(
                [second[k : k + len(j)] @ j for k, _, j in self.sweep(weights, inputs)], axis=0
            )

    def jacobian(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """dy/dw (N, n_weights), the whole record at once: for tests and small records."""
        return np.concatenate(
            [np.empty((0, self.n_weights))] + [j.copy() for _, _, j in self.sweep(weights, inputs)]
        )


def _computed_ahead(chunks: Iterator[Rows]) -> Iterator[Rows]:
    """The same chunks, each computed while the chunk before is in use."""
    # A chunk ahead is enough to keep both threads busy, and two buffers hold it.
    with ThreadPoolExecutor(1) as maker:
        coming = maker.submit(next, chunks, None)
        while (chunk := coming.result()) is not None:
            coming = maker.submit(next, chunks, None)
            yield chunk
