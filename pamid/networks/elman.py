"""Elman network: one hidden tanh layer that feeds its own state back, one linear output.

Equations (Hosovsky, Mizakova, Pitel: improved modeling of pneumatic muscle actuator, eq. 9-10)
    x(k+1) = tanh(Cw x(k) + Iw u(k) + b1),   x(0) = 0
    y(k)   = Lw x(k+1) + b2                  (eq. 10: the output sees the state that has already taken u(k) in)

Weights are one flat vector, unit by unit:
    for hidden unit i = 0 .. h-1:  Cw[i, 0..h-1], Iw[i, 0..m-1], b1[i]
    then Lw[0..h-1], then b2
so 5 inputs and 10 hidden units make 10 (10 + 5 + 1) + 10 + 1 = 171.

Derivatives are exact: sensitivities of the state are carried through time (Williams and Zipser 1989, Neural
Computation 1(2)). A static derivative, which takes x(k) as a given input, points elsewhere and
trains to a larger error.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.blas import dsyrk

from pamid.engine.recurrence import run_sensitivities, run_states
from pamid.errors import DataError

Array = NDArray[np.float64]

MEMORY = (2.0, 100.0)  # samples: shortest and longest time constant of a random start
CHUNK = 1024  # samples whose Jacobian rows are held at once: 1.4 MB at 171 weights, inside the second-level cache


class Layers(NamedTuple):
    """The weight vector taken apart: context (h, h), input (h, m), bias (h,), output (h,), output_bias."""

    context: Array
    input: Array
    bias: Array
    output: Array
    output_bias: float


@dataclass(frozen=True)
class Elman:
    """An Elman network's sizes; weights are passed to every verb as one flat float64 vector (layout: module)."""

    kind: ClassVar[str] = "elman"
    inputs: int = 5
    hidden: int = 10

    def __post_init__(self) -> None:
        for name in ("inputs", "hidden"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise DataError(f"Elman: {name} must be a whole number of at least 1, not {value!r}.")

    @property
    def n_weights(self) -> int:
        return self.hidden * (self.hidden + self.inputs + 1) + self.hidden + 1

    def layers(self, weights: ArrayLike) -> Layers:
        """Take the weight vector apart; DataError when it has not `n_weights` entries."""
        flat = np.ascontiguousarray(weights, dtype=np.float64)
        if flat.shape != (self.n_weights,):
            raise DataError(
                f"Elman {self.inputs}-{self.hidden}-1 has {self.n_weights} weights in one vector, "
                f"not an array of shape {flat.shape}."
            )
        h = self.hidden
        units = flat[: -h - 1].reshape(h, h + self.inputs + 1)
        return Layers(
            np.ascontiguousarray(units[:, :h]), units[:, h:-1], units[:, -1], flat[-h - 1 : -1].copy(), float(flat[-1])
        )

    def flatten(self, layers: Layers) -> Array:
        """The inverse of `layers`."""
        units = np.column_stack([layers.context, layers.input, layers.bias])
        return np.concatenate([units.ravel(), layers.output, [layers.output_bias]])

    def initial(self, seed: int) -> Array:
        """Random start, for inputs and target scaled into [-1, 1].

        The hidden units begin as damped oscillators in pairs (an odd last one as a lag), their time constants spread
        from `MEMORY[0]` to `MEMORY[1]` samples, with input weights that bring each to about half of tanh's bend. The
        output weights are nearly zero, so that the first training step is close to a linear regression on these modes.
        Why: on a lightly damped 1.4 Hz gap sampled at 3 ms (10000 samples, 60 steps), starts from a dense random
        context matrix of spectral radius 0.9, a memory of ten samples, ended at a mean squared error of 1.4e-2 to
        2.3e-2; of six starts from this one, three ended at 2e-4 and three at 1.0e-2 to 1.5e-2. Take several starts.
        """
        draw = np.random.default_rng(seed)
        h, m = self.hidden, self.inputs
        context, loss = np.zeros((h, h)), np.empty(h)
        for first in range(0, h, 2):
            memory = np.exp(draw.uniform(*np.log(MEMORY)))
            decay, turn = np.exp(-1.0 / memory), draw.uniform(0.0, 3.0) / memory
            pair = slice(first, min(first + 2, h))
            if first + 1 < h:
                rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
                context[pair, pair], loss[pair] = decay * rotation, abs(1.0 - decay * np.exp(1j * turn))
            else:
                context[pair, pair], loss[pair] = decay, 1.0 - decay
        entering = 0.5 * np.sqrt(3.0 / m) * draw.uniform(-1.0, 1.0, (h, m)) * loss[:, None]
        bias = 0.5 * draw.uniform(-1.0, 1.0, h) * loss
        output = 0.01 * draw.uniform(-1.0, 1.0, h) / np.sqrt(h)
        return self.flatten(Layers(context, entering, bias, output, 0.0))

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Output y (N,) for inputs (N, m) from a zero state."""
        layers, u = self.layers(weights), self._checked(inputs)
        y = np.empty(len(u))
        with np.errstate(all="ignore"):  # wild trial weights may overflow: the caller judges the outcome
            drive = u @ layers.input.T + layers.bias
        h = self.hidden
        run_states(layers.context, layers.output, layers.output_bias, drive, np.zeros(h), np.empty(h), y)
        return y

    def jacobian(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """dy/dw (N, n_weights), the whole record at once: for tests and small records."""
        return np.concatenate([np.empty((0, self.n_weights))] + [j.copy() for _, _, j in self._sweep(weights, inputs)])

    def normal_equations(
        self, weights: ArrayLike, inputs: ArrayLike, target: ArrayLike, washout: int = 0
    ) -> tuple[float, Array, Array]:
        """One pass: (sum of e^2, J'J, J'e) with e = target - y and J = dy/dw, over samples `washout` .. N-1.

        Sensitivities run from sample 0 on, so washed-out samples only leave the sums. The Jacobian is held `CHUNK`
        rows at a time. Weights so wild that numbers overflow give inf or NaN, not an exception.
        """
        wanted = np.ascontiguousarray(target, dtype=np.float64)
        if wanted.shape != (len(np.asarray(inputs)),):
            raise DataError(f"Target has shape {wanted.shape} for {len(np.asarray(inputs))} samples of input.")
        sse, jte = 0.0, np.zeros(self.n_weights)
        jtj = np.zeros((self.n_weights, self.n_weights), order="F")
        with np.errstate(all="ignore"):
            for start, y, jacobian in self._sweep(weights, inputs):
                skip = min(max(washout - start, 0), len(y))
                error = wanted[start + skip : start + len(y)] - y[skip:]
                rows = jacobian[skip:]
                if len(error):
                    sse += float(error @ error)
                    jte += error @ rows
                    jtj = dsyrk(1.0, rows.T, beta=1.0, c=jtj, overwrite_c=1, lower=1)
        return sse, np.tril(jtj) + np.tril(jtj, -1).T, jte

    def _sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[tuple[int, Array, Array]]:
        """Yield (first sample, y, dy/dw) chunk by chunk; the arrays are overwritten by the next chunk."""
        layers, u = self.layers(weights), self._checked(inputs)
        h, carried = self.hidden, self.hidden * (self.hidden + self.inputs + 1)
        state, state_scratch = np.zeros(h), np.empty(h)
        sensitivity, scratch = np.zeros((h, carried)), np.empty((h, carried))
        y, jacobian = np.empty(CHUNK), np.empty((CHUNK, self.n_weights))
        for start in range(0, len(u), CHUNK):
            part = u[start : start + CHUNK]
            n = len(part)
            with np.errstate(all="ignore"):
                drive = part @ layers.input.T + layers.bias
            run_sensitivities(
                layers.context, layers.output, layers.output_bias, drive, part,
                state, sensitivity, state_scratch, scratch, y[:n], jacobian[:n],
            )
            yield start, y[:n], jacobian[:n]

    def _checked(self, inputs: ArrayLike) -> Array:
        u = np.ascontiguousarray(inputs, dtype=np.float64)
        if u.ndim != 2 or u.shape[1] != self.inputs:
            raise DataError(f"Elman {self.inputs}-{self.hidden}-1 takes inputs (N, {self.inputs}), not {u.shape}.")
        return u
