"""What the compiled functions of `pamid.engine.integrator` are given: named tuples, which numba
knows. Arrays are C-contiguous, float64 where nothing else is said.

Sizes: nx states, nc cells, ns sensitivity columns.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Equations(NamedTuple):
    """A compiled model; all arrays are int64.

    address         (3 functions + 1): of each function plain, with partials, and the sparse product
                    of its partials with the sensitivities; last what fills the derived parameters
    phase_n, phase_first, phase_delay
                    (phases): number of cells, place of the first one, delay line after it or -1
    pointer, columns
                    sparsity of the rates' partials, row by row (CSR)
    direct_at, direct
                    (functions + 1) and (entries, 3): row, parameter and place of the partials by
                    parameters
    """

    address: Any
    phase_n: Any
    phase_first: Any
    phase_delay: Any
    pointer: Any
    columns: Any
    direct_at: Any
    direct: Any


class MemoryArrays(NamedTuple):
    """What is carried on from step to step, in place.

    x (nx,) states; cells, past (nc,); S (nx + 2 nc, ns) their sensitivities, in this order; buffers
    (delays, length), buffer_S (delays, length, ns) and heads (delays,) of the delay lines.
    """

    x: Any
    cells: Any
    past: Any
    S: Any
    buffers: Any
    buffer_S: Any
    heads: Any


class Inputs(NamedTuple):
    """What a run is given: u (samples, inputs), p (parameters and derived ones), column
    (parameters) of each one's sensitivity or -1, and whether sensitivities are asked for."""

    u: Any
    p: Any
    column: Any
    sensitive: bool


class Times(NamedTuple):
    """begin: at the very first step; join: the state was set anew since the last one."""

    time_s: float
    period_s: float
    substeps: int
    implicit: bool
    begin: bool
    join: bool


class Results(NamedTuple):
    """Y (samples, outputs), and JY (samples, outputs, ns), which is multiplied by weights
    (outputs,)."""

    Y: Any
    JY: Any
    weights: Any


class Work(NamedTuple):
    """Scratch of a sweep.

    out                 values of a function, then its partials
    D                   its partials times S
    ticks (6,)          as in `pamid.symbolic.memory_cells.TICKS`
    x0, S0              state and sensitivities at the start of the step
    slope, slope_S      their weighted sums (RK4) or first slopes (SDIRK2)
    M, pivots           LU of Newton's matrix
    step, next_step     Newton's steps (nx, 1), from here and from where the step would lead
    before, base        the state before a Newton step; the known part of the stage
    """

    out: Any
    D: Any
    ticks: Any
    x0: Any
    slope: Any
    S0: Any
    slope_S: Any
    M: Any
    pivots: Any
    step: Any
    next_step: Any
    before: Any
    base: Any
