"""Equations compiled without a rig around them, and run: for tests of the language and of the
engine."""

from collections.abc import Sequence

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.program import Memory, Program, Stepping, build_program
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.memory_cells import Cell, expand_memory
from pamid.engine.symbolic.vocabulary import Expr

PERIOD_S = 0.01


def state(name: str) -> Expr:
    return symbol("state", name)


def signal(name: str = "u") -> Expr:
    """An input, held over the sample."""
    return symbol("input", name)


def parameter(name: str) -> Expr:
    return symbol("parameter", name)


def program(
    rates: dict[str, Expr],
    outputs: dict[str, Expr],
    parameters: Sequence[str] = (),
    inputs: Sequence[str] = ("u",),
    cells: tuple[Cell, ...] = (),
    linear: tuple[str, ...] = (),
) -> Program:
    return build_program(
        expand_memory(rates, outputs, cells, linear),
        tuple(inputs),
        tuple(parameters),
        tuple(outputs),
        linear=linear,
    )


def begin(made: Program, x: Sequence[float], stepping: Stepping, columns: int = 0) -> Memory:
    """Fresh memory at x (states that memory operators added start at zero)."""
    full = np.zeros(len(made.states))
    full[: len(x)] = x
    return made.memory(full, columns, stepping=stepping, period_s=PERIOD_S)


def run(
    made: Program,
    u: Array,
    p: Sequence[float] = (),
    x: Sequence[float] = (),
    stepping: Stepping | None = None,
) -> Array:
    """Outputs (samples x outputs) from state x; u is (samples,) or (samples x inputs)."""
    step = stepping or Stepping()
    table = np.asarray(u, float).reshape(len(u), -1)
    y, _, bad = made.run(
        begin(made, x, step), SampledInputs(table, PERIOD_S), np.array(p, float), stepping=step
    )
    assert bad == -1
    return y


def sensitivities(
    made: Program, u: Array, p: Sequence[float], x: Sequence[float], stepping: Stepping
) -> Array:
    """d outputs / d (parameters, given states), samples x outputs x columns, as the engine carries
    them."""
    k, n = len(p), len(x)
    memory = begin(made, x, stepping, k + n)
    memory.S[:n, k : k + n] = np.eye(n)
    table = np.asarray(u, float).reshape(len(u), -1)
    _, J, bad = made.run(
        memory,
        SampledInputs(table, PERIOD_S),
        np.array(p, float),
        stepping=stepping,
        columns=np.arange(k, dtype=np.int64),
    )
    assert bad == -1
    return J[:, :, : k + n]


def differences(
    made: Program, u: Array, p: Sequence[float], x: Sequence[float], stepping: Stepping
) -> Array:
    """The same by central differences."""
    z, k = np.concatenate([p, x]).astype(float), len(p)
    columns = []
    for i, value in enumerate(z):
        h = 1e-6 * max(abs(value), 1e-2)
        sides = []
        for sign in (1.0, -1.0):
            moved = z.copy()
            moved[i] += sign * h
            sides.append(run(made, u, moved[:k].tolist(), moved[k:].tolist(), stepping))
        columns.append((sides[0] - sides[1]) / (2.0 * h))
    return np.stack(columns, axis=2)


def steps(seed: int, samples: int, hold: int = 7, size: float = 1.0) -> Array:
    """A held random signal."""
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-size, size, samples // hold + 1), hold)[:samples]
