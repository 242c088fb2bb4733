"""Elman network: a hidden tanh layer that feeds its state back, a linear output.

Equations (Hosovsky, Mizakova, Pitel: improved modeling of pneumatic muscle actuator, eq. 9-10)
    x(k+1) = tanh(Cw x(k) + Iw u(k) + b1),   x(0) = 0                                (eq. 9)
    y(k)   = Lw x(k+1) + b2                                                          (eq. 10)
where the output sees the state that u(k) has entered already.

Weights are a flat vector, unit by unit:
    for hidden unit i = 0 .. h-1:  Cw[i, 0..h-1], Iw[i, 0..m-1], b1[i]
    then Lw[0..h-1], then b2;
so 5 inputs and 10 hidden units make 10 (10 + 5 + 1) + 10 + 1 = 171.

The Jacobian is exact, by forward sensitivities S(k) = dx(k)/dw (real-time recurrent learning;
Williams and Zipser 1989, Neural Computation 1(2)), with D(k) = diag(1 - x(k+1)^2):
    S(k+1) = D(k) (Cw S(k) + d(Cw x + Iw u + b1)/dw at fixed x),   S(0) = 0
    dy(k)/dw = Lw S(k+1) + d(Lw x + b2)/dw at fixed x
A static derivative, which takes x(k) as a given input (S(k) = 0 on the right), points elsewhere and
trains to a larger error. Products J'v with a sequence v(k) need no J: the adjoint runs back in
time (backpropagation through time; Werbos 1990, Proc. IEEE 78(10)),
    a(k) = D(k) (Lw' v(k) + Cw' a(k+1)),   J'v = sum over k of a(k) [x(k), u(k), 1]'
and serves `curvature` at a sixth of the cost of a pass.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.engine.recurrence_kernels import (
    LANES,
    run_adjoint,
    run_bend,
    run_growth,
    run_sensitivities,
    run_states,
)
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.memory_cells import Cell
from pamid.engine.symbolic.vocabulary import Expr, tanh
from pamid.networks.modal_start import find_modes
from pamid.networks.network import CHUNK, Network, Records, Rows, weighted
from pamid.networks.onnx_nodes import OnnxNodes, affine

TIME_CONSTANTS = (2.0, 100.0)  # samples: shortest and longest time constant of a random start
BEND = 0.3  # largest state of a start from a linear model: tanh(x) is x to 3 %

ACTIVE = 2.0  # arguments of tanh beyond which it is flat (MATLAB's `tansig`: -2 .. 2)


class ElmanLayers(NamedTuple):
    """The weights: units (h, h + m + 1) = [context, input, bias], output (h,), output_bias."""

    units: Array
    output: Array
    output_bias: float

    @property
    def context(self) -> Array:
        return self.units[:, : len(self.units)]

    @property
    def input(self) -> Array:
        return self.units[:, len(self.units) : -1]

    @property
    def bias(self) -> Array:
        return self.units[:, -1]


@dataclass(frozen=True)
class Elman(Network):
    """An Elman network's sizes; verbs take its weights as a flat float64 vector (module)."""

    kind: ClassVar[str] = "elman"
    size_options: ClassVar[dict[str, tuple[int, int, str, str]]] = {
        "hidden": (1, 200, "Hidden units", "10, or fewer if the samples are too few")
    }
    inputs: int = 5
    hidden: int = 10

    def __post_init__(self) -> None:
        self.require_sizes(inputs=1, hidden=1)

    def words(self) -> str:
        return f"elman {self.inputs}-{self.hidden}-1"

    @property
    def n_weights(self) -> int:
        return self.hidden * (self.hidden + self.inputs + 1) + self.hidden + 1

    def layers(self, weights: ArrayLike) -> ElmanLayers:
        """Take the weight vector apart; DataError when it has not `n_weights` entries."""
        flat = self.flat(weights)
        h = self.hidden
        units = flat[: -h - 1].reshape(h, h + self.inputs + 1).copy()
        return ElmanLayers(units, flat[-h - 1 : -1].copy(), float(flat[-1]))

    def flatten(self, layers: ElmanLayers) -> Array:
        """The inverse of `layers`."""
        return np.concatenate([layers.units.ravel(), layers.output, [layers.output_bias]])

    def initial(self, seed: int) -> Array:
        """Random start without data, for inputs and target scaled into [-1, 1].

        The hidden units begin as damped oscillators in pairs (an odd last unit as a lag), their
        time constants spread over `TIME_CONSTANTS`, with input weights that bring each
        to about half of tanh's bend; the output weights are nearly zero.
        """
        draw = np.random.default_rng(seed)
        h, m = self.hidden, self.inputs
        context, loss = np.zeros((h, h)), np.empty(h)
        for first in range(0, h, 2):
            memory = np.exp(draw.uniform(*np.log(TIME_CONSTANTS)))
            # A turn in proportion to the decay gives slow units slow oscillations, and few that
            # ring for many periods.
            decay, turn = np.exp(-1.0 / memory), draw.uniform(0.0, 3.0) / memory
            pair = slice(first, min(first + 2, h))
            if first + 1 < h:
                rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
                context[pair, pair], loss[pair] = (
                    decay * rotation,
                    abs(1.0 - decay * np.exp(1j * turn)),
                )
            else:
                context[pair, pair], loss[pair] = decay, 1.0 - decay
        # sqrt(3 / m) times a uniform number has variance 1 / m, so that m inputs add up to the size
        # of 1; `loss` takes off the static gain 1 / |1 - pole|, which is large for a slow unit
        entering = 0.5 * np.sqrt(3.0 / m) * draw.uniform(-1.0, 1.0, (h, m)) * loss[:, None]
        bias = 0.5 * draw.uniform(-1.0, 1.0, h) * loss
        # Nearly zero, so that the first output is near the target's middle whatever the states do.
        # Zero exactly would leave the context without a gradient.
        output = 0.01 * draw.uniform(-1.0, 1.0, h) / np.sqrt(h)
        return self.flatten(ElmanLayers(np.column_stack([context, entering, bias]), output, 0.0))

    def start(self, records: Records, washout: int, seed: int) -> Array:
        """A linear model of the data: a pair of units for each of its modes (modal_start), scaled
        so that tanh bends them little (an odd last unit as in `initial`). Every fourth seed, and a
        single unit, begins at `initial` instead.

        Why both: where the gap rings for seconds (the first paper's task on a twin; 15000 samples,
        100 steps) starts from `initial` mostly end at a mean squared error of 2e-2 to 5e-2, starts
        from modes at 4e-4 to 4e-3; where it forgets within a few samples (a random network as
        teacher; 10000 samples, 80 steps, noise 4e-4) four of four starts from `initial` come down
        to the noise, two of four from modes. Several starts race, and have both.
        """
        if seed % 4 == 3 or self.hidden == 1:
            return self.initial(seed)
        layers = self.layers(self.initial(seed))
        modes = find_modes(records, washout, self.hidden // 2, seed)
        largest = np.max(
            # Over all recordings: a mode that is small in a recording would otherwise saturate in
            # another.
            [np.abs(modes.states(u)).max(axis=0, initial=1e-300) for u, _ in records],
            axis=0,
        )
        paired = slice(0, 2 * len(modes.poles))
        layers.units[paired] = layers.output[paired] = 0.0
        for k, (pole, residues, size) in enumerate(
            zip(modes.poles, modes.residues, largest / BEND, strict=True)
        ):
            first, second = 2 * k, 2 * k + 1
            # z(k+1) = p z(k) + r u(k) as two real states, Re z and Im z; the output reads Re z
            layers.context[first : second + 1, first : second + 1] = [
                [pole.real, -pole.imag],
                [pole.imag, pole.real],
            ]
            layers.input[first], layers.input[second] = residues.real / size, residues.imag / size
            layers.output[first] = size
        return self.flatten(layers._replace(output_bias=modes.bias))

    def random_start(self, seed: int) -> Array:
        """The start of MATLAB's Elman network, `initnw`: every unit's weights a random direction of
        the length with which the units share out the range of their arguments (Nguyen and Widrow
        1990, IJCNN vol. 3, pp. 21-26), that of tanh being -2 .. 2; the linear output, for which
        that rule has no value, uniform in -1 .. 1."""
        draw = np.random.default_rng(seed)
        h, seen = self.hidden, self.hidden + self.inputs
        direction = draw.uniform(-1.0, 1.0, (h, seen))
        length = ACTIVE * 0.7 * h ** (1.0 / seen)
        weights = length * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        spread = np.linspace(-1.0, 1.0, h) if h > 1 else np.zeros(1)
        bias = length * spread * np.sign(weights[:, 0])
        output = draw.uniform(-1.0, 1.0, h + 1)
        return self.flatten(
            ElmanLayers(np.column_stack([weights, bias]), output[:-1], float(output[-1]))
        )

    @property
    def linear(self) -> slice:
        """Output weights and output bias."""
        return slice(self.n_weights - self.hidden - 1, self.n_weights)

    def features(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """States x(k+1) and ones (N, h + 1), from a zero state: the output is linear in them."""
        layers, u = self.layers(weights), self.table(inputs)
        # Padding to whole vectors lets the kernel run without a remainder loop.
        states = np.ones((len(u), self.hidden + 1))
        run_states(_padded(layers.units.T), u, np.zeros(self.hidden), states)
        return states

    def growth(self, weights: ArrayLike, features: Array) -> float:
        with np.errstate(all="ignore"):
            return float(run_growth(_padded(self.layers(weights).context.T), features))

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Output y (N,) for inputs (N, m) from a zero state."""
        with np.errstate(all="ignore"):
            return np.asarray(
                self.features(weights, inputs) @ np.asarray(weights, dtype=np.float64)[self.linear]
            )

    def equations(
        self, weights: ArrayLike, inputs: Sequence[Expr], name: str
    ) -> tuple[Expr, tuple[Cell, ...]]:
        """Every unit's state is a cell."""
        layers = self.layers(weights)
        names = [f"{name}_unit_{i}" for i in range(self.hidden)]
        driven = weighted(layers.input, inputs, layers.bias)
        moved = weighted(layers.context, [symbol("past", n) for n in names], driven)
        cells = tuple(
            Cell(n, tanh(after), tanh(first), sampled=True)
            for n, after, first in zip(names, moved, driven, strict=True)
        )
        (output,) = weighted(layers.output[None], [c.here for c in cells], [layers.output_bias])
        return output, cells

    @property
    def memory_size(self) -> int:
        return self.hidden

    def onnx_nodes(
        self, g: OnnxNodes, weights: Array, given: str, memory: str, first: str
    ) -> tuple[str, str]:
        layers = self.layers(weights)
        seen = g.joined([memory, given])
        state = g.add("Tanh", affine(g, layers.units[:, :-1], seen, g.array(layers.bias)))
        return affine(g, layers.output[None], state, g.number(layers.output_bias)), state

    def curvature(
        self, weights: ArrayLike, step: ArrayLike, inputs: ArrayLike, washout: int = 0
    ) -> Array:
        """J' times the second derivative of the output along a change of the weights, exact:
        forward, then backward in time, a sixth of a pass."""
        layers, along, u = self.layers(weights), self.layers(step), self.table(inputs)
        states, bend = self.features(weights, inputs), np.empty(len(u))
        run_bend(
            _padded(layers.units.T),
            _padded(along.units.T),
            u,
            states,
            layers.output,
            along.output,
            bend,
        )
        # Washed-out samples have no error to weigh, though their states still feed the later ones.
        bend[:washout] = 0.0
        gradient = np.zeros_like(layers.units)
        run_adjoint(_padded(layers.context), layers.output, states, u, bend, gradient)
        with np.errstate(all="ignore"):
            return np.concatenate([gradient.ravel(), bend @ states])

    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """Yield (first sample, y, dy/dw) chunk by chunk; the arrays are overwritten two chunks
        later."""
        layers, u = self.layers(weights), self.table(inputs)
        h, carried = self.hidden, self.hidden * (self.hidden + self.inputs + 1)
        state = np.zeros(h)
        # Two copies, the state before and after: the recursion reads all units while it writes
        # half.
        sensitivity = aligned(2, h, _multiple_of_lanes(carried))
        size = min(CHUNK, max(len(u), 1))
        # Two buffers in turn, so that a second thread can add up a chunk while the next is
        # computed.
        buffers = [(np.empty(size), aligned(size * self.n_weights + LANES)) for _ in range(2)]
        columns = _padded(layers.units.T)
        for number, start in enumerate(range(0, len(u), CHUNK)):
            part, (y, flat) = u[start : start + CHUNK], buffers[number % 2]
            run_sensitivities(
                layers.units,
                columns,
                layers.output,
                layers.output_bias,
                part,
                state,
                sensitivity,
                y,
                flat,
            )
            n = len(part)
            yield start, y[:n], flat[: n * self.n_weights].reshape(n, self.n_weights)


def aligned(*shape: int) -> Array:
    """Zeros (C order) that begin at a line of the cache, 64 bytes: vectors that straddle two lines
    load at half speed."""
    # numpy may align to 16 bytes only.
    raw = np.zeros(int(np.prod(shape)) + 8)
    skip = (-raw.ctypes.data % 64) // 8
    return raw[skip : skip + int(np.prod(shape))].reshape(shape)


def _padded(values: Array) -> Array:
    """Rows filled up with zeros to whole vectors."""
    rows, columns = values.shape
    padded = np.zeros((rows, _multiple_of_lanes(columns)))
    padded[:, :columns] = values
    return padded


def _multiple_of_lanes(columns: int) -> int:
    """Columns of as many whole vectors."""
    return columns + -columns % LANES
