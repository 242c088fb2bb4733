"""Implicit steps of several hypotheses side by side: Newton's method of `pamid.engine.integrator`
with a separate matrix, damping and end in each lane.

Systems of equations are those of `pamid.engine.lu`, M (n, n, LANES) with pivots (n, LANES): a lane
exchanges its rows by itself, all lanes eliminate together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic as _intrinsic

from pamid.engine.function_calls import call
from pamid.engine.integrator import DAMPED, GAMMA, HALVINGS, LAST_STEP, NEWTON_STEPS, RATES
from pamid.engine.numba_cache import njit
from pamid.engine.simd import INT64, LANES, Vectors

# numba's annotation keeps the typing context that a call leaves out
intrinsic: Any = _intrinsic
SIZE_FLOOR = 1e-6  # added to a state's size, of which steps are a share


def _lane_codegen(change):  # type: ignore[no-untyped-def]
    """Code that changes the lanes in row i of an array by those in row j of another, and in row k
    of the first."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        to, i, other, j, k = args
        data = [
            context.make_array(sig.args[n])(context, builder, array).data
            for n, array in ((0, to), (2, other))
        ]
        v = Vectors(builder)
        i, j, k = (builder.mul(row, INT64(LANES)) for row in (i, j, k))
        values = v.load(data[0], i), v.load(data[1], j), v.load(data[0], k)
        v.store(change(v, *values), data[0], i)
        return context.get_dummy_value()

    return codegen


@intrinsic
def _subtract_product(typingctx, to, i, other, j, k):  # type: ignore[no-untyped-def]
    """to[i] -= other[j] * to[k], in all lanes."""
    return types.void(to, types.intp, other, types.intp, types.intp), _lane_codegen(
        lambda v, value, factor, row: v.builder.fsub(value, v.builder.fmul(factor, row))
    )


@intrinsic
def _divide(typingctx, to, i, other, j):  # type: ignore[no-untyped-def]
    """to[i] /= other[j], in all lanes."""
    codegen = _lane_codegen(lambda v, value, divisor, _: v.builder.fdiv(value, divisor))
    return types.void(to, types.intp, other, types.intp), lambda c, builder, sig, args: codegen(
        c, builder, sig, [*args, args[1]]
    )


@njit(cache=True)
def factor_lanes(M, pivots):  # type: ignore[no-untyped-def]
    """L and U in the place of M; pivots int64."""
    n = M.shape[0]
    for j in range(n):
        # Pivots differ from lane to lane, so that only the exchange of rows is done lane by lane.
        for lane in range(LANES):
            best = j
            for i in range(j + 1, n):
                if abs(M[i, j, lane]) > abs(M[best, j, lane]):
                    best = i
            pivots[j, lane] = best
            if best != j:
                for k in range(n):
                    M[j, k, lane], M[best, k, lane] = M[best, k, lane], M[j, k, lane]
            if M[j, j, lane] == 0.0:
                M[j, j, lane] = 1e-300
        for i in range(j + 1, n):
            _divide(M, i * n + j, M, j * n + j)
            for k in range(j + 1, n):
                _subtract_product(M, i * n + k, M, i * n + j, j * n + k)


@njit(cache=True)
def solve_lanes(M, pivots, b):  # type: ignore[no-untyped-def]
    """Solve M x = b with the factors by `factor_lanes`: b (n, LANES) becomes x."""
    n = b.shape[0]
    for j in range(n):
        for lane in range(LANES):
            best = pivots[j, lane]
            if best != j:
                b[j, lane], b[best, lane] = b[best, lane], b[j, lane]
    for j in range(n):
        for i in range(j + 1, n):
            _subtract_product(b, i, M, i * n + j, j)
    for j in range(n - 1, -1, -1):
        _divide(b, j, M, j * n + j)
        for i in range(j):
            _subtract_product(b, i, M, i * n + j, j)


@njit(cache=True)
def _newton_matrix(equations, nx, gh, out, M):  # type: ignore[no-untyped-def]
    """M = I - gh df/dx; the partials follow the rates in out."""
    pointer, columns, entries = equations.pointer, equations.columns, M.ravel()
    for i in range(entries.shape[0]):
        entries[i] = 0.0
    for i in range(nx):
        for lane in range(LANES):
            entries[i * (nx + 1) * LANES + lane] = 1.0
        for e in range(pointer[i], pointer[i + 1]):
            to, at = (i * nx + columns[e]) * LANES, (nx + e) * LANES
            for lane in range(LANES):
                entries[to + lane] -= gh * out[at + lane]


@njit(cache=True)
def _step_from(base, gh, out, x, step):  # type: ignore[no-untyped-def]
    """The right-hand side of a Newton step: base + gh f(x) - x."""
    known, state, right = base.ravel(), x.ravel(), step.ravel()
    for i in range(state.shape[0]):
        right[i] = known[i] + gh * out[i] - state[i]


@njit(cache=True, error_model="numpy")  # without a test for a divisor of zero, which stops vectors
def _sizes(step, x, sizes):  # type: ignore[no-untyped-def]
    """Largest |step_i| / (SIZE_FLOOR + |x_i|) of each lane; NaN counts as nothing."""
    for lane in range(LANES):
        sizes[lane] = 0.0
    for i in range(x.shape[0]):
        for lane in range(LANES):
            size = abs(step[i, lane]) / (SIZE_FLOOR + abs(x[i, lane]))
            # no max(), which numba compiles to branches
            sizes[lane] = size if size > sizes[lane] else sizes[lane]


@njit(cache=True)
def _move(before, step, reach, x):  # type: ignore[no-untyped-def]
    """x = before + reach step; reach is 0 in a lane that stays."""
    for i in range(x.shape[0]):
        for lane in range(LANES):
            moved = before[i, lane] + reach[lane] * step[i, lane]
            x[i, lane] = moved if reach[lane] > 0.0 else before[i, lane]


@njit(cache=True)
def _copy(values, to):  # type: ignore[no-untyped-def]
    old, new = values.ravel(), to.ravel()
    for i in range(old.shape[0]):
        new[i] = old[i]


@njit(cache=True)
def _newton(equations, memory, u, row, p, gh, lost, work):  # type: ignore[no-untyped-def]
    """Solve x = base + gh f(x) in place, in all lanes but those that are lost; see
    `pamid.engine.integrator._newton`. A lane that does not converge becomes NaN."""
    address, x, c, b = equations.address, memory.x, memory.cells, memory.past
    t, out, M, pivots = work.ticks, work.out, work.M, work.pivots
    step, following, before, base = work.step, work.next_step, work.before, work.base
    worst, left, reach, trying = work.worst, work.left, work.reach, work.trying
    going = work.going
    remaining = 0
    for lane in range(LANES):
        going[lane] = lost[lane] < 0
        remaining += going[lane]
    for _ in range(NEWTON_STEPS):
        if remaining == 0:
            return
        call(address[-1], x, c, b, u, row, p, t, out)
        _newton_matrix(equations, x.shape[0], gh, out, M)
        factor_lanes(M, pivots)
        _step_from(base, gh, out, x, step)
        solve_lanes(M, pivots, step)
        _sizes(step, x, worst)
        _copy(x, before)
        damped = 0
        for lane in range(LANES):
            reach[lane] = 1.0 if going[lane] else 0.0
            trying[lane] = going[lane] and worst[lane] > DAMPED
            damped += trying[lane]
        _move(before, step, reach, x)
        for _ in range(HALVINGS):
            if damped == 0:
                break
            call(address[RATES], x, c, b, u, row, p, t, out)
            _step_from(base, gh, out, x, following)
            solve_lanes(M, pivots, following)
            _sizes(following, before, left)
            for lane in range(LANES):
                if trying[lane]:
                    if left[lane] <= (1.0 - 0.25 * reach[lane]) * worst[lane]:
                        trying[lane] = False
                        damped -= 1
                    else:
                        reach[lane] *= 0.5
            if damped > 0:
                _move(before, step, reach, x)
        for lane in range(LANES):
            if going[lane] and worst[lane] < LAST_STEP:
                going[lane] = False
                remaining -= 1
    for lane in range(LANES):
        # A lane that has not converged must be seen. A number that looks like a result would be
        # used.
        if going[lane]:
            x[:, lane] = np.nan


@njit(cache=True, error_model="numpy")
def sdirk2_lanes(equations, memory, u, row, p, h, lost, work):  # type: ignore[no-untyped-def]
    """A step of h in all lanes, as `pamid.engine.integrator._sdirk2` does it."""
    x, x0, k1, base, t = memory.x.ravel(), work.x0, work.slope, work.base.ravel(), work.ticks
    gh, begun, share = GAMMA * h, t[6], h / t[2]
    for i in range(x.shape[0]):
        x0[i] = x[i]
        k1[i] = 0.0
    for stage in range(2):
        carry = 0.0 if stage == 0 else (1.0 - GAMMA) * h
        t[7] = GAMMA if stage == 0 else 1.0
        t[6] = begun + t[7] * share
        for i in range(x.shape[0]):
            base[i] = x0[i] + carry * k1[i]
        _newton(equations, memory, u, row, p, gh, lost, work)
        if stage == 0:
            for i in range(x.shape[0]):
                k1[i] = (x[i] - x0[i]) / gh
