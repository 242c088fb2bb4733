"""Time integration: compiled once, serves every model through function addresses.

`sweep_windows` runs over the windows of a recording, `sweep` over samples in a row. At the start of
every step it updates the cells, at
the start of every sample it reads the outputs, and it moves the states by a step of

    RK4     the classical Runge-Kutta method of order 4 (Hairer, Norsett and Wanner 1993, II.1)
    SDIRK2  the L-stable, singly diagonally implicit method of order 2 of Alexander (1977), for
            stiff models (see `_sdirk2`)

with every input held over the sample or linear in time over it
(`pamid.engine.symbolic.memory_cells` writes the latter with the ticks `part` and `along`, which are
set for every stage). On request it carries exact forward sensitivities of that recursion, not of
the differential equation. With z = (states, cells) and z(k+1) = F(z(k), p), the columns S = dz/dp
follow S(k+1) = dF/dz S(k) + dF/dp. They are the derivative of the computed values.

    Alexander (1977), SIAM J. Numer. Anal. 14(6), 1006-1021
    Deuflhard (2004), Newton Methods for Nonlinear Problems, section 3.3
    Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I
    Hairer and Wanner (1996), Solving Ordinary Differential Equations II

Steps are of equal length throughout a run. A step control would choose other steps for other
parameters, so that outputs jump between neighbouring ones and have no derivative. The length of the
steps is checked outside (`choose_stepping` before a fit, `rechecked` after it).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pamid.engine.function_calls import borrowed, call, multiply
from pamid.engine.lu import factor, solve
from pamid.engine.numba_cache import njit

# diagonal of SDIRK2: g^2 - 2 g + 1/2 = 0 makes it L-stable and of order 2
GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
BLOWN_UP = 1e15
NEWTON_STEPS, HALVINGS = 40, 20
# relative changes: above DAMPED a Newton step may be shortened, below LAST_STEP it was the last
DAMPED, LAST_STEP = 1e-3, 1e-9
RATES, OUTPUTS, PHASES = 0, 1, 2  # numbers of functions; the phases of the cells follow each other


# ---- arguments of the functions ----------------------------------------------------------------
# Arrays are C-contiguous, float64 by default; nx states, nc cells, ns sensitivity
# columns. The classes stand in this file because numba takes its cache of these functions for stale
# by the stamp of this file alone; they keep their names because the cache refers to them by name.


class CompiledEquations(NamedTuple):
    """A compiled model; all arrays are int64.

    address         (3 functions + 1): of each function plain, with partials, and the sparse product
                    of its partials with the sensitivities; last what fills the derived parameters
    phase_n, phase_first, phase_delay
                    (phases): number of cells, place of the first cell, delay line after it or -1
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
    """Memory that a run carries from step to step, in place.

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
    """Inputs of a run: u (samples, inputs), p (parameters and derived ones), column (parameters) of
    each parameter's sensitivity or -1, and whether sensitivities are wanted."""

    u: Any
    p: Any
    column: Any
    sensitive: bool


class Times(NamedTuple):
    """begin: at the very first step; join: the state was set anew since the last step; only: of the
    steps of a sample this step alone, or -1 for all of them."""

    time_s: float
    period_s: float
    substeps: int
    implicit: bool
    begin: bool
    join: bool
    only: int


class Results(NamedTuple):
    """Y (samples, outputs), and JY (samples, outputs, ns), which is multiplied by weights
    (outputs,)."""

    Y: Any
    JY: Any
    weights: Any


class WindowTable(NamedTuple):
    """Windows in order, and the states that are set anew where each of them begins.

    edges (windows, 2)      first row of u, and the row behind the last row
    time_s (windows,)       of the first sample
    starts (windows, n)     the first n states; the others are carried on
    column                  sensitivity column of the first start state: it and those behind it
                            begin anew with every window
    end (windows, nx), S (windows, n, ns)
                            filled: the states behind the last sample, and the rows of the first n
                            of them in the sensitivities
    """

    edges: Any
    time_s: Any
    starts: Any
    column: int
    end: Any
    S: Any


class SweepScratch(NamedTuple):
    """Scratch of a sweep.

    out                 values of a function, then its partials
    D                   its partials times S
    ticks (8,)          as in `pamid.engine.symbolic.memory_cells.TICKS`
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


# ---- steps ---------------------------------------------------------------------------------------


@njit(cache=True, inline="always")
def _rows(equations, f, n, inputs, S, work):  # type: ignore[no-untyped-def]
    """D[i] = sum_j partial(i, j) S[j] + direct parameter columns, for function f; its partials
    follow n values."""
    direct, out, D = equations.direct, work.out, work.D
    multiply(equations.address[3 * f + 2], out, n, S, D, 0, S.shape[1])
    for e in range(equations.direct_at[f], equations.direct_at[f + 1]):
        k = inputs.column[direct[e, 1]]
        if k >= 0:
            D[direct[e, 0], k] += out[n + direct[e, 2]]


@njit(cache=True)
def _update_cells(equations, memory, inputs, row, work):  # type: ignore[no-untyped-def]
    """All cells at the start of a step. Delay lines sit between phases: push the input, read at the
    delay."""
    address, sensitive = equations.address, inputs.sensitive
    x, c, b, S = memory.x, memory.cells, memory.past, memory.S
    buffers, buffer_S, heads = memory.buffers, memory.buffer_S, memory.heads
    out, D, t = work.out, work.D, work.ticks
    nx, nc, ns = x.shape[0], c.shape[0], S.shape[1]
    for i in range(nc):
        b[i] = c[i]
    # in S the rows of the states come first, then those of the cells, then those of the past
    if sensitive:
        for i in range(nc):
            for k in range(ns):
                S[nx + nc + i, k] = S[nx + i, k]
    for phase in range(equations.phase_n.shape[0]):
        n = equations.phase_n[phase]
        delayed = equations.phase_delay[phase]
        f = PHASES + phase
        call(address[3 * f + (1 if sensitive else 0)], x, c, b, inputs.u, row, inputs.p, t, out)
        at = equations.phase_first[phase]
        for i in range(n):
            c[at + i] = out[i]
        if sensitive:
            _rows(equations, f, n + (2 if delayed >= 0 else 0), inputs, S, work)
            for i in range(n):
                for k in range(ns):
                    S[nx + at + i, k] = D[i, k]
        if delayed >= 0:
            cell = at + n
            size = buffers.shape[1]
            head = (heads[delayed] + 1) % size
            heads[delayed] = head
            if t[4] > 0.5:  # before the run the input stood at its first value
                buffers[delayed, :] = out[n]
                if sensitive:
                    for m in range(size):
                        for k in range(ns):
                            buffer_S[delayed, m, k] = D[n, k]
            buffers[delayed, head] = out[n]
            position = min(max(out[n + 1] / t[1], 0.0), size - 2.0)
            steps = int(position)
            part = position - steps
            near, far = (head - steps) % size, (head - steps - 1) % size
            c[cell] = (1.0 - part) * buffers[delayed, near] + part * buffers[delayed, far]
            if sensitive:
                # of the interpolated value by the delay itself, in its unit (s)
                slope = (buffers[delayed, far] - buffers[delayed, near]) / t[1]
                for k in range(ns):
                    buffer_S[delayed, head, k] = D[n, k]
                    S[nx + cell, k] = (
                        (1.0 - part) * buffer_S[delayed, near, k]
                        + part * buffer_S[delayed, far, k]
                        + slope * D[n + 1, k]
                    )


@njit(cache=True)
def _rk4(equations, memory, inputs, row, h, work):  # type: ignore[no-untyped-def]
    """A step of h: k1 = f(x), k2 = f(x + h/2 k1), k3 = f(x + h/2 k2), k4 = f(x + h k3), and
    x + h/6 (k1 + 2 k2 + 2 k3 + k4); S likewise, with the derivative of every stage."""
    address, sensitive = equations.address, inputs.sensitive
    x, c, b, S = memory.x, memory.cells, memory.past, memory.S
    u, p, t, out = inputs.u, inputs.p, work.ticks, work.out
    x0, acc = work.x0, work.slope
    s, d, s0, total = S.ravel(), work.D.ravel(), work.S0.ravel(), work.slope_S.ravel()
    nx = x.shape[0]
    # Flat views: numba then compiles a single loop over all entries, which LLVM turns into vectors.
    size = nx * S.shape[1]
    begun, share = t[6], h / t[2]
    for i in range(nx):
        x0[i] = x[i]
        acc[i] = 0.0
    if sensitive:
        for i in range(size):
            s0[i] = s[i]
            total[i] = s[i]
    for stage in range(4):
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        reach = 0.5 * h if stage < 2 else h
        t[7] = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0)
        t[6] = begun + t[7] * share
        call(address[1 if sensitive else 0], x, c, b, u, row, p, t, out)
        if sensitive:
            _rows(equations, RATES, nx, inputs, S, work)
            for i in range(size):
                total[i] += weight * d[i]
                s[i] = s0[i] + reach * d[i]
        for i in range(nx):
            acc[i] += weight * out[i]
            x[i] = x0[i] + reach * out[i]
    for i in range(nx):
        x[i] = x0[i] + acc[i]
    if sensitive:
        for i in range(size):
            s[i] = total[i]


@njit(cache=True)
def _newton_matrix(out, pointer, columns, nx, gh, M):  # type: ignore[no-untyped-def]
    """M = I - gh df/dx."""
    for i in range(nx):
        for j in range(nx):
            M[i, j] = 1.0 if i == j else 0.0
        for e in range(pointer[i], pointer[i + 1]):
            if columns[e] < nx:
                M[i, columns[e]] -= gh * out[nx + e]


@njit(cache=True)
def _newton(equations, memory, inputs, row, gh, work):  # type: ignore[no-untyped-def]
    """Solve x = base + gh f(x) in place by damped Newton; return whether it converged to round-off.

    A step dx solves (I - gh df/dx) dx = base + gh f(x) - x. Above DAMPED it is halved until the
    next correction, with the same matrix, is smaller: |dx'| <= (1 - reach/4) |dx|, the
    affine-invariant monotonicity test of Deuflhard (2004, section 3.3). Sizes are the largest
    |dx_i| / (1e-6 + |x_i|). It stops after a step below LAST_STEP: convergence is quadratic, the
    next step would be below round-off.
    """
    address = equations.address
    x, c, b = memory.x, memory.cells, memory.past
    u, p, t, out = inputs.u, inputs.p, work.ticks, work.out
    M, pivots, base, before = work.M, work.pivots, work.base, work.before
    step, following = work.step, work.next_step
    nx = x.shape[0]
    for _ in range(NEWTON_STEPS):
        call(address[1], x, c, b, u, row, p, t, out)
        _newton_matrix(out, equations.pointer, equations.columns, nx, gh, M)
        factor(M, pivots)
        for i in range(nx):
            step[i, 0] = base[i] + gh * out[i] - x[i]
        solve(M, pivots, step)
        worst = 0.0
        for i in range(nx):
            worst = max(worst, abs(step[i, 0]) / (1e-6 + abs(x[i])))
            before[i] = x[i]
        reach = 1.0
        for _ in range(HALVINGS if worst > DAMPED else 1):
            for i in range(nx):
                x[i] = before[i] + reach * step[i, 0]
            if worst <= DAMPED:
                break
            call(address[0], x, c, b, u, row, p, t, out)
            for i in range(nx):
                following[i, 0] = base[i] + gh * out[i] - x[i]
            solve(M, pivots, following)
            left = 0.0
            for i in range(nx):
                left = max(left, abs(following[i, 0]) / (1e-6 + abs(before[i])))
            # With the same matrix the test costs an evaluation and a solve, and no
            # factorisation.
            if left <= (1.0 - 0.25 * reach) * worst:
                break
            reach *= 0.5
        if worst < LAST_STEP:
            return True
    return False


@njit(cache=True)
def _sdirk2(equations, memory, inputs, row, h, work):  # type: ignore[no-untyped-def]
    """A step of h in two stages, each solved by damped Newton to round-off; with g = GAMMA

        x1 = x + g h f(x1),   x2 = x + (1 - g) h f(x1) + g h f(x2),   x2 is the result

    (Alexander 1977; stiffly accurate). Sensitivities by the implicit function theorem, with f_x =
    df/dx and f_p all other parts of df/dp, through cells and parameters:

        (I - g h f_x) S1 = S + g h f_p,   (I - g h f_x) S2 = S + (1 - g) h (S1 - S)/(g h) + g h f_p

    Where Newton does not converge the state becomes NaN, so that the sweep reports it.
    """
    sensitive, x, S, D = inputs.sensitive, memory.x, memory.S, work.D
    c, b = memory.cells, memory.past
    x0, k1, S0, A = work.x0, work.slope, work.S0, work.slope_S
    out, M, pivots = work.out, work.M, work.pivots
    nx, ns = x.shape[0], S.shape[1]
    gh = GAMMA * h
    t = work.ticks
    begun, share = t[6], h / t[2]
    for i in range(nx):
        x0[i] = x[i]
        k1[i] = 0.0
        if sensitive:
            for k in range(ns):
                S0[i, k] = S[i, k]
                A[i, k] = 0.0
    for stage in range(2):
        carry = 0.0 if stage == 0 else (1.0 - GAMMA) * h
        t[7] = GAMMA if stage == 0 else 1.0
        t[6] = begun + t[7] * share
        for i in range(nx):
            work.base[i] = x0[i] + carry * k1[i]
        if not _newton(equations, memory, inputs, row, gh, work):
            x[:] = np.nan
            return
        if sensitive:
            call(equations.address[1], x, c, b, inputs.u, row, inputs.p, t, out)
            _newton_matrix(out, equations.pointer, equations.columns, nx, gh, M)
            factor(M, pivots)
            for i in range(nx):
                for k in range(ns):
                    S[i, k] = 0.0
            # the states' rows of S are zero here, so that D holds f_p alone, without f_x S
            _rows(equations, RATES, nx, inputs, S, work)
            for i in range(nx):
                for k in range(ns):
                    S[i, k] = S0[i, k] + carry * A[i, k] + gh * D[i, k]
            solve(M, pivots, S[:nx])
            if stage == 0:
                for i in range(nx):
                    for k in range(ns):
                        A[i, k] = (S[i, k] - S0[i, k]) / gh
        if stage == 0:
            # f(x1) from the stage's equation, not by a call: an error that Newton's method
            # leaves in x1 would come back times the largest eigenvalue of f_x (Hairer and Wanner
            # 1996, IV.8)
            for i in range(nx):
                k1[i] = (x[i] - x0[i]) / gh


@njit(cache=True)
def _work(equations, memory, n_outputs):  # type: ignore[no-untyped-def]
    nx, nc, ns = memory.x.shape[0], memory.cells.shape[0], memory.S.shape[1]
    width = max(max(nx, n_outputs), nc) + 2
    return SweepScratch(
        np.zeros(width + equations.columns.shape[0] + 2),
        np.zeros((width, ns)),
        np.zeros(8),
        np.zeros(nx),
        np.zeros(nx),
        np.zeros((nx, ns)),
        np.zeros((nx, ns)),
        np.zeros((nx, nx)),
        np.zeros(nx, np.int64),
        np.zeros((nx, 1)),
        np.zeros((nx, 1)),
        np.zeros(nx),
        np.zeros(nx),
    )


@njit(cache=True)
def _read_outputs(equations, memory, inputs, k, row, work, results):  # type: ignore[no-untyped-def]
    """Row k of Y and JY."""
    address, direct, out = equations.address, equations.direct, work.out
    Y, JY, weights, sensitive = results.Y, results.JY, results.weights, inputs.sensitive
    ny, ns = Y.shape[1], memory.S.shape[1]
    call(
        address[4 if sensitive else 3],
        memory.x,
        memory.cells,
        memory.past,
        inputs.u,
        row,
        inputs.p,
        work.ticks,
        out,
    )
    for i in range(ny):
        Y[k, i] = out[i]
    if sensitive:
        multiply(address[5], out, ny, memory.S, JY, k * ny * ns, ns)
        for e in range(equations.direct_at[OUTPUTS], equations.direct_at[OUTPUTS + 1]):
            j = inputs.column[direct[e, 1]]
            if j >= 0:
                JY[k, direct[e, 0], j] += out[ny + direct[e, 2]]
        for i in range(ny):
            for j in range(ns):
                JY[k, i, j] *= weights[i]


@njit(cache=True)
def _run_samples(equations, memory, inputs, times, results, work, rows):  # type: ignore[no-untyped-def]
    """Run over rows first to stop of u, of which `first` fills row `at` of Y and JY; rows: (first,
    stop, at). Returns the first sample, counted from `first`, at which the state is no longer
    finite, or -1."""
    first, stop, at = rows
    x, nc, nu = memory.x, memory.cells.shape[0], inputs.u.shape[1]
    t = work.ticks
    h = times.period_s / times.substeps
    t[1], t[2] = h, times.period_s
    single = times.only >= 0
    begun, ended = (times.only, times.only + 1) if single else (0, times.substeps)
    for k in range(stop - first):
        row = (first + k) * nu
        for sub in range(begun, ended):
            opens = k == 0 and sub == begun
            t[0] = times.time_s + k * times.period_s + sub * h
            t[3] = 1.0 if sub == 0 else 0.0
            t[4] = 1.0 if times.begin and opens else 0.0
            t[5] = 1.0 if times.join and opens else 0.0
            t[6] = sub / times.substeps
            t[7] = 0.0
            if nc > 0:
                _update_cells(equations, memory, inputs, row, work)
            if sub == begun:
                _read_outputs(equations, memory, inputs, at + k, row, work, results)
            if times.implicit:
                _sdirk2(equations, memory, inputs, row, h, work)
            else:
                _rk4(equations, memory, inputs, row, h, work)
        for i in range(x.shape[0]):
            if not abs(x[i]) < BLOWN_UP:
                results.Y[at + k + 1 : at + stop - first] = np.nan
                if inputs.sensitive:
                    results.JY[at + k + 1 : at + stop - first] = np.nan
                return k
    return -1


@njit(cache=True, nogil=True)
def sweep(equations, memory, inputs, times, results):  # type: ignore[no-untyped-def]
    """Run over the rows of u, filling Y and, with sensitivities, JY.

    Memory is carried on in place, so that the next call continues. Returns the first sample at
    which the state is no longer finite, or -1.
    """
    work = _work(equations, memory, results.Y.shape[1])
    bad = _run_samples(
        borrowed(equations),
        borrowed(memory),
        borrowed(inputs),
        times,
        borrowed(results),
        borrowed(work),
        (0, inputs.u.shape[0], 0),
    )
    work.ticks[0] = 0.0  # a last use, up to which the scratch is kept
    return bad


@njit(cache=True, nogil=True)
def sweep_windows(equations, memory, inputs, times, results, windows):  # type: ignore[no-untyped-def]
    """Run over windows, each from its start states, filling Y and JY (whose first row is that of
    the first window), `end` and `S`.

    Sensitivities to the start states begin with each window. All other memory is carried on in
    place. Of `times`, begin holds for the first window and join for all of them. Returns the first
    window in which states or outputs are no longer finite, where it stops, and the sample of it at
    which the state was not; -1 where there is none.
    """
    x, S, edges = memory.x, memory.S, windows.edges
    n, column = windows.starts.shape[1], windows.column
    work = _work(equations, memory, results.Y.shape[1])
    for w in range(edges.shape[0]):
        first, stop = edges[w, 0], edges[w, 1]
        at = first - edges[0, 0]
        for i in range(n):
            x[i] = windows.starts[w, i]
        if inputs.sensitive:
            S[:n] = 0.0
            S[:, column:] = 0.0
            memory.buffer_S[:, :, column:] = 0.0
            for i in range(n):
                S[i, column + i] = 1.0
        window_times = Times(
            windows.time_s[w],
            times.period_s,
            times.substeps,
            times.implicit,
            times.begin and w == 0,
            times.join,
            times.only,
        )
        bad = _run_samples(
            borrowed(equations),
            borrowed(memory),
            borrowed(inputs),
            window_times,
            borrowed(results),
            borrowed(work),
            (first, stop, at),
        )
        work.ticks[0] = 0.0  # a last use, up to which the scratch is kept
        windows.end[w] = x
        if inputs.sensitive:
            windows.S[w] = S[:n]
        if bad >= 0 or not np.isfinite(results.Y[at : at + stop - first]).all():
            return w, bad
    return -1, -1


@njit(cache=True, nogil=True)
def prepare(address, p, derived):  # type: ignore[no-untyped-def]
    """Fill the values that depend on parameters only."""
    call(address, p, p, p, p, 0, p, p, derived)


@njit(cache=True, nogil=True)
def rate_matrix(equations, memory, u, p, time_s, step_s, period_s):  # type: ignore[no-untyped-def]
    """df/dx at a point, nx x nx, at the input u (inputs,)."""
    pointer, columns = equations.pointer, equations.columns
    nx = memory.x.shape[0]
    out = np.zeros(nx + columns.shape[0] + 2)
    t = np.array([time_s, step_s, period_s, 1.0, 0.0, 0.0, 0.0, 0.0])
    call(equations.address[1], memory.x, memory.cells, memory.past, u, 0, p, t, out)
    M = np.zeros((nx, nx))
    for i in range(nx):
        for e in range(pointer[i], pointer[i + 1]):
            if columns[e] < nx:
                M[i, columns[e]] = out[nx + e]
    return M
