"""NARX network: a hidden tanh layer that sees past inputs and the network's past outputs, a linear
output.

Equations (Chen, Billings, Grant 1990, Int. J. Control 51(6); run free, so that it fits the
simulated output)
    y(k) = Lw tanh(W z(k) + b1) + b2
    z(k) = [u(k), u(k-s), ..., u(k-ns), y(k-s), y(k-2s), ..., y(k-ls)]
n input lags, l output lags, s samples of stride between taps. The y fed back are the network's:
the target is not known when it predicts. Before the record begins the inputs hold their first value
and the outputs are zero.

Weights are a flat vector, unit by unit:
    for hidden unit i = 0 .. h-1:  W[i, .] for u(k) (m entries), u(k-s) (m), ..., then for y(k-s),
    ..., y(k-ls), b1[i] then Lw[0..h-1], then b2
so 5 inputs, 10 hidden units and two lags of each make 10 (15 + 2 + 1) + 10 + 1 = 191.

Derivatives are exact forward sensitivities through the outputs that are fed back, to the record's
first sample (Narendra and Parthasarathy 1991, IEEE TNN 2(2)):
    dy(k)/dw = direct(k) + sum over j of dy(k)/dy(k-js) dy(k-js)/dw,   0 before the record
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.engine.feedback_kernels import run_output_sensitivities, run_outputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.memory_cells import Cell
from pamid.engine.symbolic.vocabulary import ZERO, Expr, tanh
from pamid.networks.network import CHUNK, Network, Rows, weighted
from pamid.networks.onnx_nodes import OnnxNodes, affine

LONGEST_TIME_CONSTANT = 100.0  # samples: longest time constant of a random start
TAP_S = 0.03  # between the taps: 10 samples at 3 ms, where this was measured


class NarxLayers(NamedTuple):
    """The weights: taps (h, (n + 1) m), feedback (h, l), bias (h,), output (h,), output_bias."""

    taps: Array
    feedback: Array
    bias: Array
    output: Array
    output_bias: float


@dataclass(frozen=True)
class Narx(Network):
    """A NARX network's sizes; weights are passed to every verb as a flat float64 vector (layout:
    module).

    `input_lags` counts the delayed taps of every input after the present tap, `output_lags` those
    of the output. `stride` is the number of samples between taps; 10 are 30 ms at 3 ms.
    Neighbouring samples are nearly the same, so that the recursion must be right to many digits,
    while a wide stride overlooks what happens between taps. Mean squared errors on the first of the
    plants of `initial`: stride 1 2.7e-2 to 2.9e-2, stride 5 2.8e-4 to 4.9e-3, stride 10 3.7e-4 to
    4.1e-4, stride 20 1.1e-3 to 1.2e-3; on the second 5.4e-2 to 5.7e-2, 1.3e-3 to 1.8e-2, 1.3e-3 to
    1.5e-3 and 3.6e-3 to 4.2e-3.
    """

    kind: ClassVar[str] = "narx"
    size_options: ClassVar[dict[str, tuple[int, int, str, str]]] = {
        "hidden": (1, 200, "Hidden units", "10, or fewer if the samples are too few")
    }
    inputs: int = 5
    hidden: int = 10
    input_lags: int = 2
    output_lags: int = 2
    stride: int = 10

    def __post_init__(self) -> None:
        self.require_sizes(inputs=1, hidden=1, input_lags=0, output_lags=1, stride=1)

    @classmethod
    def at_period(cls, period_s: float) -> dict[str, int]:
        return {"stride": max(1, round(TAP_S / period_s))}

    def words(self) -> str:
        return (
            f"narx {self.inputs}-{self.hidden}-1 seeing {self.input_lags} earlier inputs and "
            f"{self.output_lags} earlier outputs, {self.stride} samples apart"
        )

    @property
    def n_weights(self) -> int:
        return self.hidden * (self._taps + self.output_lags + 1) + self.hidden + 1

    @property
    def _taps(self) -> int:
        return self.inputs * (self.input_lags + 1)

    @property
    def _reach(self) -> int:
        """Samples back to the oldest fed-back output."""
        return self.output_lags * self.stride

    def layers(self, weights: ArrayLike) -> NarxLayers:
        """Take the weight vector apart; DataError when it has not `n_weights` entries."""
        flat = self.flat(weights)
        h, q = self.hidden, self._taps
        units = flat[: -h - 1].reshape(h, q + self.output_lags + 1)
        # The kernel reads these weights at every sample; a strided view would miss the cache.
        feedback = np.ascontiguousarray(units[:, q:-1])
        return NarxLayers(
            units[:, :q], feedback, units[:, -1], flat[-h - 1 : -1].copy(), float(flat[-1])
        )

    def flatten(self, layers: NarxLayers) -> Array:
        """The inverse of `layers`."""
        units = np.column_stack([layers.taps, layers.feedback, layers.bias])
        return np.concatenate([units.ravel(), layers.output, [layers.output_bias]])

    def initial(self, seed: int) -> Array:
        """Random start, for inputs and target scaled into [-1, 1].

        Dense random weights. Where their recursion of the output has a time constant above
        `LONGEST_TIME_CONSTANT`, the feedback is weakened, so that the free run and its
        sensitivities stay bounded. Why: two noise-free lightly damped 1.4 Hz plants sampled at 3 ms
        (10000 samples, held random levels), 4 starts each, 100 steps. The first, with a saturated
        input, was fitted to a mean squared error of 3.7e-4 to 4.1e-4 (Elman, 10 units: 4e-5 to
        1.0e-4); the second, with a hardening spring and a saturated reading, to 1.3e-3 to 1.5e-3
        (Elman: 1.5e-5, 1.8e-4, 1.1e-2, 1.5e-2). So a single start usually does, and the grid of
        taps sets the floor. Starts of which half the units are a linear recursion with drawn poles
        came no lower.
        """
        layers = self.layers(np.random.default_rng(seed).uniform(-1.0, 1.0, self.n_weights))
        # of variance 1 / (number of taps), so that what a unit sees adds up to size 1
        scale, output = (
            np.sqrt(3.0 / (self._taps + self.output_lags)),
            layers.output / np.sqrt(self.hidden),
        )
        feedback = scale * layers.feedback
        # of the linear recursion at tanh's middle
        poles = np.roots(np.concatenate([[1.0], -(output @ feedback)]))
        shrink = min(1.0, np.exp(-self.stride / LONGEST_TIME_CONSTANT) / np.abs(poles).max())
        # moves every pole by the factor `shrink`
        feedback *= shrink ** np.arange(1, self.output_lags + 1)
        return self.flatten(NarxLayers(scale * layers.taps, feedback, layers.bias, output, 0.0))

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Output y (N,) for inputs (N, m), nothing having come before."""
        layers, u = self.layers(weights), self.table(inputs)
        y = np.zeros(self._reach + len(u))
        # wild trial weights may overflow: the caller judges the outcome
        with np.errstate(all="ignore"):
            drive = self.tapped(u, 0, len(u)) @ layers.taps.T + layers.bias
        run_outputs(layers.feedback, layers.output, layers.output_bias, drive, self.stride, y)
        return y[self._reach :]

    def equations(
        self, weights: ArrayLike, inputs: Sequence[Expr], name: str
    ) -> tuple[Expr, tuple[Cell, ...]]:
        """A chain of cells holds each input's and the output's past samples."""
        layers = self.layers(weights)
        seen = [f"{name}_input_{i}" for i in range(self.inputs)]
        taps = [
            u if lag == 0 else symbol("cell", f"{n}_{lag * self.stride}")
            for lag in range(self.input_lags + 1)
            for n, u in zip(seen, inputs, strict=True)
        ]
        back = [
            symbol("cell", f"{name}_output_{lag * self.stride}")
            for lag in range(1, self.output_lags + 1)
        ]
        driven = weighted(layers.feedback, back, weighted(layers.taps, taps, layers.bias))
        (output,) = weighted(layers.output[None], [tanh(d) for d in driven], [layers.output_bias])
        # Every sample between the taps has a cell, because a shift register moves by a sample at
        # a time.
        cells = _chain(f"{name}_output", output, before=ZERO, length=self._reach)
        for n, u in zip(seen, inputs, strict=True):
            cells += _chain(n, u, before=u, length=self.input_lags * self.stride)
        return symbol("cell", f"{name}_output_0"), tuple(cells)

    @property
    def memory_size(self) -> int:
        return self.stride * (self.input_lags * self.inputs + self.output_lags)

    def onnx_nodes(
        self, g: OnnxNodes, weights: Array, given: str, memory: str, first: str
    ) -> tuple[str, str]:
        """Memory: past inputs, sample by sample, then past outputs, the newest first."""
        layers, m = self.layers(weights), self.inputs
        reach_in, reach_out = self.input_lags * self.stride, self._reach
        taps, past_inputs, outputs = given, [], memory
        if reach_in:
            inputs, outputs = g.parts(memory, [reach_in * m, reach_out])
            inputs = g.choose(first, g.add("Tile", given, g.index(reach_in)), inputs)
            rows = [
                np.arange(m) + (lag * self.stride - 1) * m for lag in range(1, self.input_lags + 1)
            ]
            seen = g.index(*np.concatenate(rows).tolist())
            taps = g.joined([given, g.add("Gather", inputs, seen, axis=0)])
            past = g.parts(inputs, [(reach_in - 1) * m, m])[:1] if reach_in > 1 else []
            past_inputs = [given, *past]
        fed_back = g.index(*(lag * self.stride - 1 for lag in range(1, self.output_lags + 1)))
        back = g.add("Gather", outputs, fed_back, axis=0)
        driven = affine(
            g, layers.feedback, back, affine(g, layers.taps, taps, g.array(layers.bias))
        )
        output = affine(g, layers.output[None], g.add("Tanh", driven), g.number(layers.output_bias))
        older = g.parts(outputs, [reach_out - 1, 1])[:1] if reach_out > 1 else []
        return output, g.joined([*past_inputs, output, *older])

    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """Yield (first sample, y, dy/dw) chunk by chunk; the arrays are overwritten two chunks
        later."""
        layers, u, reach = self.layers(weights), self.table(inputs), self._reach
        rows = reach + min(CHUNK, len(u))
        buffers = [(np.zeros(rows), np.zeros((rows, self.n_weights))) for _ in range(2)]
        hidden = np.empty(self.hidden)
        for number, start in enumerate(range(0, len(u), CHUNK)):
            (y, jacobian), (y_before, jacobian_before) = (
                buffers[number % 2],
                buffers[number % 2 - 1],
            )
            # The recursion of a chunk starts from the outputs that the chunk before has ended
            # with, derivatives included.
            y[:reach], jacobian[:reach] = y_before[-reach:], jacobian_before[-reach:]
            taps = self.tapped(u, start, min(start + CHUNK, len(u)))
            end = reach + len(taps)
            with np.errstate(all="ignore"):
                drive = taps @ layers.taps.T + layers.bias
            run_output_sensitivities(
                layers.feedback,
                layers.output,
                layers.output_bias,
                drive,
                taps,
                self.stride,
                hidden,
                y[:end],
                jacobian[:end],
            )
            yield start, y[reach:end], jacobian[reach:end]

    def tapped(self, u: Array, start: int, stop: int) -> Array:
        """Inputs (stop - start, (n + 1) m) at samples start .. stop - 1: u(k), ..., u(k-ns)."""
        k = np.arange(start, stop)
        return np.hstack(
            [u[np.maximum(k - lag * self.stride, 0)] for lag in range(self.input_lags + 1)]
        )


def _chain(name: str, value: Expr, *, before: Expr, length: int) -> list[Cell]:
    """Cells name_0 .. name_length with the value 0 .. length samples ago; `before` stands for what
    lies before the first sample."""
    first = Cell(f"{name}_0", value, value, sampled=True)
    return [
        first,
        *(
            Cell(f"{name}_{k}", symbol("past", f"{name}_{k - 1}"), before, sampled=True)
            for k in range(1, length + 1)
        ),
    ]
