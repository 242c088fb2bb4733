"""A model made executable: compiled equations, their sparsity, and runs over recorded inputs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.engine.emitter import DECLARATIONS, function_text, with_partials
from pamid.engine.lowering import TICKS, Lowered, cell_update
from pamid.engine.machine import addresses
from pamid.equations import Expr, expression

Array = NDArray[np.float64]


@dataclass
class Memory:
    """Everything a run carries from one call to the next: states, cells, delay lines and their sensitivities.

    x (nx), cells (nc), buffers (delays, length), S (nx + 2 nc, columns), heads (delays); begin until the first run.
    """

    x: Array
    cells: Array
    past: Array
    S: Array
    buffers: Array
    buffer_S: Array
    heads: NDArray[np.int64]
    begin: bool = True

    def copy(self) -> Memory:
        return Memory(self.x.copy(), self.cells.copy(), self.past.copy(), self.S.copy(), self.buffers.copy(),
                      self.buffer_S.copy(), self.heads.copy(), self.begin)


@dataclass(frozen=True)
class Stepping:
    """How a sample is integrated: steps per sample, and whether the L-stable implicit step is used."""

    substeps: int = 1
    implicit: bool = False

    def doubled(self) -> Stepping:
        return Stepping(2 * self.substeps, self.implicit)


@dataclass(frozen=True)
class Program:
    """Compiled equations. `states`, `inputs`, `parameters`, `outputs` give the order of every array."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    cells: tuple[str, ...]
    delays: tuple[float, ...]
    operations: int
    _address: NDArray[np.int64] = field(repr=False)
    _phase: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] = field(repr=False)
    _pattern: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] = field(repr=False)

    def memory(self, x: Array, columns: int = 0, *, stepping: Stepping | None = None, period_s: float = 1.0) -> Memory:
        """Fresh memory at state x with room for `columns` sensitivities (all zero)."""
        nx, nc = len(self.states), len(self.cells)
        step = period_s / (stepping or Stepping()).substeps
        size = max([int(np.ceil(d / step)) + 3 for d in self.delays], default=1)
        nd = len(self.delays)
        return Memory(np.array(x, float), np.zeros(nc), np.zeros(nc), np.zeros((nx + 2 * nc, columns)),
                      np.zeros((nd, size)), np.zeros((nd, size, columns)), np.zeros(nd, np.int64))

    def run(self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0,
            stepping: Stepping | None = None, columns: NDArray[np.int64] | None = None) -> tuple[Array, Array, int]:
        """Simulate over the rows of u (samples x inputs), carrying `memory` on.

        columns: for each parameter its sensitivity column or -1; None runs without sensitivities.
        Returns outputs (samples x outputs), their sensitivities (samples x outputs x columns; empty without), and the
        first sample at which the state blew up (-1: none).
        """
        from pamid.engine.driver import sweep

        step = stepping or Stepping()
        n, ns = u.shape[0], memory.S.shape[1] if columns is not None else 0
        Y = np.empty((n, len(self.outputs)))
        JY = np.empty((n, len(self.outputs), ns) if columns is not None else (1, 1, 0))
        S = memory.S if columns is not None else memory.S[:, :0].copy()
        buffer_S = memory.buffer_S if columns is not None else memory.buffer_S[:, :, :0].copy()
        chosen = columns if columns is not None else np.full(len(self.parameters), -1, np.int64)
        at, pointer, columns_at, column = self._pattern
        phase_n, phase_first, phase_delay = self._phase
        bad = sweep(self._address, phase_n, phase_first, phase_delay, at, pointer, columns_at, column,
                    memory.x, memory.cells, memory.past, np.ascontiguousarray(u, float),
                    np.ascontiguousarray(p, float), chosen, S, memory.buffers, buffer_S, memory.heads,
                    float(time_s), float(period_s), step.substeps, step.implicit, memory.begin,
                    columns is not None, Y, JY)
        memory.begin = False
        return Y, JY, int(bad)

    def rate_matrix(self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0) -> Array:
        """df/dx (nx x nx) where `memory` stands, at the held input u (inputs,)."""
        from pamid.engine.driver import rate_matrix

        return rate_matrix(self._address, self._pattern[1], self._pattern[3], memory.x, memory.cells, memory.past,
                           np.ascontiguousarray(u, float), np.ascontiguousarray(p, float), time_s, period_s, period_s)


def build_program(lowered: Lowered, inputs: tuple[str, ...], parameters: tuple[str, ...],
                  outputs: tuple[str, ...]) -> Program:
    """Compile lowered equations (from the cache where they were compiled before)."""
    cells = lowered.cells
    nx, nc = len(lowered.states), len(cells)
    place = {("state", n): i for i, n in enumerate(lowered.states)}
    place |= {(space, c.name): i for i, c in enumerate(cells) for space in ("cell", "past")}
    place |= {("input", n): i for i, n in enumerate(inputs)}
    place |= {("parameter", n): i for i, n in enumerate(parameters)}
    place |= {("tick", n): i for i, n in enumerate(TICKS)}
    base = {"state": 0, "cell": nx, "past": nx + nc, "parameter": nx + 2 * nc}

    phases, phase_n, phase_first, phase_delay, delays = _phases(lowered)
    groups: list[list[Expr]] = [list(lowered.rates), list(lowered.outputs), *phases]
    parts, names = [DECLARATIONS], []
    at, pointer_all, columns_at, column_all = [], [], [], []
    operations = 0
    for i, roots in enumerate(groups):
        def index(space: str, name: str) -> int:
            return place[space, name]

        def column(space: str, name: str) -> int:
            return base[space] + place[space, name]

        values, pointer, columns = with_partials(roots, column)
        parts += [function_text(f"f{i}", roots, index), function_text(f"d{i}", values, index)]
        names += [f"f{i}", f"d{i}"]
        operations += parts[-2].count("\n") if i == 0 else 0
        at.append(len(pointer_all))
        columns_at.append(len(column_all))
        pointer_all += pointer
        column_all += columns
    address = addresses("\n".join(parts), names)
    as_int = [np.array(v, np.int64) for v in (address, phase_n, phase_first, phase_delay, at, pointer_all, columns_at,
                                               column_all)]
    return Program(lowered.states, inputs, parameters, outputs, tuple(c.name for c in cells), tuple(delays),
                   operations, as_int[0], (as_int[1], as_int[2], as_int[3]),
                   (as_int[4], as_int[5], as_int[6], as_int[7]))


def _phases(lowered: Lowered) -> tuple[list[list[Expr]], list[int], list[int], list[int], list[float]]:
    """Cut the ordered cells after every delay line: the driver moves the line between two phases.

    Inside a phase a cell may read another one's new value only if that one stands in an earlier phase; where it
    reads one of its own phase the new value is written out.
    """
    from pamid.equations import substitute

    phases: list[list[Expr]] = []
    counts: list[int] = []
    firsts: list[int] = []
    delayed: list[int] = []
    lengths: list[float] = []
    current: list[Expr] = []
    inline: dict[Expr, Expr] = {}
    first = 0
    for i, cell in enumerate(lowered.cells):
        if cell.buffer_s > 0.0:
            goes_in, seconds = substitute([cell.update, expression(0.0 if cell.seconds is None else cell.seconds)], inline)
            phases.append([*current, goes_in, seconds])
            counts.append(len(current))
            firsts.append(first)
            delayed.append(len(lengths))
            lengths.append(cell.buffer_s)
            current, inline, first = [], {}, i + 1
        else:
            (update,) = substitute([cell_update(cell)], inline)
            current.append(update)
            inline[cell.here] = update
    if current:
        phases.append(current)
        counts.append(len(current))
        firsts.append(first)
        delayed.append(-1)
    return phases, counts, firsts, delayed, lengths
