"""The generic sweep through time: compiled once, serves every model through function addresses.

One sweep carries values and, on request, exact sensitivities of the discrete recursion (not of the
differential equation): the derivative of what was computed. Explicit Runge-Kutta of order 4, or the
L-stable SDIRK2 of Alexander (1977) for stiff models, one or more steps per sample, inputs held over
the sample.

Rows of the sensitivity matrix: states, cells, past cells. Function numbers: 0 rates, 1 outputs, 2..
cell phases; each has three addresses: plain, with partials, and the sparse product of its partials
with the sensitivities.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic as _intrinsic

from pamid.engine.lu import factor, solve
from pamid.engine.numba_cache import njit

GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
BLOWN_UP = 1e15
# numba's own annotation keeps the typing context that a call leaves out
intrinsic: Any = _intrinsic


def _data(context, builder, kind, value):  # type: ignore[no-untyped-def]
    """Address of an array's first element, without touching its reference count."""
    return builder.ptrtoint(context.make_array(kind)(context, builder, value).data, ir.IntType(64))


@intrinsic
def _call(typingctx, address, x, c, b, u, k, p, t, out):  # type: ignore[no-untyped-def]
    """Call the compiled function at `address` with seven arrays; the inputs start k numbers into
    u."""
    signature = types.void(types.intp, x, c, b, u, types.intp, p, t, out)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 7)
        words = [_data(context, builder, sig.args[i], args[i]) for i in (1, 2, 3, 4, 6, 7, 8)]
        words[3] = builder.add(words[3], builder.mul(args[5], ir.IntType(64)(8)))
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), words)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def _multiply(typingctx, address, partials, skip, S, D, at, n):  # type: ignore[no-untyped-def]
    """Call a compiled sparse product D = P S; partials stand `skip`, the result `at` numbers into
    their arrays."""
    signature = types.void(types.intp, partials, types.intp, S, D, types.intp, types.intp)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [word] * 4)
        first = builder.add(
            _data(context, builder, sig.args[1], args[1]), builder.mul(args[2], word(8))
        )
        result = builder.add(
            _data(context, builder, sig.args[4], args[4]), builder.mul(args[5], word(8))
        )
        builder.call(
            builder.inttoptr(args[0], kind.as_pointer()),
            [first, _data(context, builder, sig.args[3], args[3]), result, args[6]],
        )
        return context.get_dummy_value()

    return signature, codegen


@njit(cache=True, inline="always")
def _rows(address, f, out, n, direct_at, direct, p_column, S, D):  # type: ignore[no-untyped-def]
    """D[i] = sum_j partial(i, j) S[j] + direct parameter columns, for function f; its partials
    follow n values."""
    _multiply(address[3 * f + 2], out, n, S, D, 0, S.shape[1])
    for e in range(direct_at[f], direct_at[f + 1]):
        k = p_column[direct[e, 1]]
        if k >= 0:
            D[direct[e, 0], k] += out[n + direct[e, 2]]


@njit(cache=True, inline="always")
def _update_cells(
    address,
    n_phase,
    phase_first,
    phase_delay,
    direct_at,
    direct,
    sens,
    x,
    c,
    b,
    u,
    row,
    p,
    t,
    out,
    S,
    D,
    p_column,
    buffers,
    buffer_S,
    heads,
):  # type: ignore[no-untyped-def]
    """All cells at the start of a step. Delay lines sit between phases: push the input, read at the
    delay."""
    nx, nc, ns = x.shape[0], c.shape[0], S.shape[1]
    for i in range(nc):
        b[i] = c[i]
    if sens:
        for i in range(nc):
            for k in range(ns):
                S[nx + nc + i, k] = S[nx + i, k]
    for phase in range(n_phase.shape[0]):
        n = n_phase[phase]
        delayed = phase_delay[phase]
        f = 2 + phase
        _call(address[3 * f + (1 if sens else 0)], x, c, b, u, row, p, t, out)
        at = phase_first[phase]
        for i in range(n):
            c[at + i] = out[i]
        if sens:
            _rows(
                address, f, out, n + (2 if delayed >= 0 else 0), direct_at, direct, p_column, S, D
            )
            for i in range(n):
                for k in range(ns):
                    S[nx + at + i, k] = D[i, k]
        if delayed >= 0:
            cell = at + n
            size = buffers.shape[1]
            head = (heads[delayed] + 1) % size
            heads[delayed] = head
            if t[4] > 0.5:
                buffers[delayed, :] = out[n]
                if sens:
                    for m in range(size):
                        buffer_S[delayed, m] = D[n]
            buffers[delayed, head] = out[n]
            position = min(max(out[n + 1] / t[1], 0.0), size - 2.0)
            whole = int(position)
            part = position - whole
            near, far = (head - whole) % size, (head - whole - 1) % size
            c[cell] = (1.0 - part) * buffers[delayed, near] + part * buffers[delayed, far]
            if sens:
                slope = (buffers[delayed, far] - buffers[delayed, near]) / t[1]
                for k in range(ns):
                    buffer_S[delayed, head, k] = D[n, k]
                    S[nx + cell, k] = (
                        (1.0 - part) * buffer_S[delayed, near, k]
                        + part * buffer_S[delayed, far, k]
                        + slope * D[n + 1, k]
                    )


@njit(cache=True, inline="always")
def _rk4(
    address,
    direct_at,
    direct,
    sens,
    x,
    c,
    b,
    u,
    row,
    p,
    t,
    h,
    out,
    S,
    D,
    p_column,
    x0,
    acc,
    s,
    d,
    s0,
    total,
):  # type: ignore[no-untyped-def]
    nx = x.shape[0]
    size = nx * S.shape[1]
    for i in range(nx):
        x0[i] = x[i]
        acc[i] = 0.0
    if sens:
        for i in range(size):
            s0[i] = s[i]
            total[i] = s[i]
    for stage in range(4):
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        reach = 0.5 * h if stage < 2 else h
        _call(address[1 if sens else 0], x, c, b, u, row, p, t, out)
        if sens:
            _rows(address, 0, out, nx, direct_at, direct, p_column, S, D)
            for i in range(size):
                total[i] += weight * d[i]
                s[i] = s0[i] + reach * d[i]
        for i in range(nx):
            acc[i] += weight * out[i]
            x[i] = x0[i] + reach * out[i]
    for i in range(nx):
        x[i] = x0[i] + acc[i]
    if sens:
        for i in range(size):
            s[i] = total[i]


@njit(cache=True)
def _matrix(out, pattern, columns, nx, gh, M):  # type: ignore[no-untyped-def]
    """M = I - gh df/dx."""
    for i in range(nx):
        for j in range(nx):
            M[i, j] = 1.0 if i == j else 0.0
        for e in range(pattern[i], pattern[i + 1]):
            if columns[e] < nx:
                M[i, columns[e]] -= gh * out[nx + e]


@njit(cache=True)
def _newton(
    address, pattern, columns, x, c, b, u, row, p, t, gh, out, base, M, pivots, r, q, before
):  # type: ignore[no-untyped-def]
    """Solve x = base + gh f(x) in place by damped Newton; says whether it converged to round-off.

    Damping by affine-invariant monotonicity (Deuflhard 2004, section 3.3).
    """
    nx = x.shape[0]
    for _ in range(40):
        _call(address[1], x, c, b, u, row, p, t, out)
        _matrix(out, pattern, columns, nx, gh, M)
        factor(M, pivots)
        for i in range(nx):
            r[i, 0] = base[i] + gh * out[i] - x[i]
        solve(M, pivots, r)
        worst = 0.0
        for i in range(nx):
            worst = max(worst, abs(r[i, 0]) / (1e-6 + abs(x[i])))
            before[i] = x[i]
        reach = 1.0
        for _ in range(20 if worst > 1e-3 else 1):
            for i in range(nx):
                x[i] = before[i] + reach * r[i, 0]
            if worst <= 1e-3:
                break
            _call(address[0], x, c, b, u, row, p, t, out)
            for i in range(nx):
                q[i, 0] = base[i] + gh * out[i] - x[i]
            solve(M, pivots, q)
            left = 0.0
            for i in range(nx):
                left = max(left, abs(q[i, 0]) / (1e-6 + abs(before[i])))
            if left <= (1.0 - 0.25 * reach) * worst:
                break
            reach *= 0.5
        if worst < 1e-9:
            return True
    return False


@njit(cache=True)
def _sdirk2(
    address,
    pattern,
    columns,
    direct_at,
    direct,
    sens,
    x,
    c,
    b,
    u,
    row,
    p,
    t,
    h,
    out,
    S,
    D,
    p_column,
    x0,
    k1,
    S0,
    A,
    M,
    pivots,
    r,
    q,
    before,
    base,
):  # type: ignore[no-untyped-def]
    """Two implicit stages with damped Newton to round-off; sensitivities by the implicit function
    theorem.

    Where Newton does not converge the state becomes NaN, so that the sweep reports it.
    """
    nx, ns = x.shape[0], S.shape[1]
    gh = GAMMA * h
    x0[:] = x
    k1[:] = 0.0
    if sens:
        S0[:] = S[:nx]
        A[:] = 0.0
    for stage in range(2):
        carry = 0.0 if stage == 0 else (1.0 - GAMMA) * h
        for i in range(nx):
            base[i] = x0[i] + carry * k1[i]
        solved = _newton(
            address, pattern, columns, x, c, b, u, row, p, t, gh, out, base, M, pivots, r, q, before
        )
        if not solved:
            x[:] = np.nan
            return
        if sens:
            _call(address[1], x, c, b, u, row, p, t, out)
            _matrix(out, pattern, columns, nx, gh, M)
            factor(M, pivots)
            S[:nx] = 0.0
            _rows(address, 0, out, nx, direct_at, direct, p_column, S, D)  # everything but df/dx S
            for i in range(nx):
                for k in range(ns):
                    S[i, k] = S0[i, k] + carry * A[i, k] + gh * D[i, k]
            solve(M, pivots, S[:nx])
            if stage == 0:
                for i in range(nx):
                    for k in range(ns):
                        A[i, k] = (S[i, k] - S0[i, k]) / gh
        if stage == 0:
            for i in range(nx):
                k1[i] = (x[i] - x0[i]) / gh


@njit(cache=True, nogil=True)
def sweep(
    address,
    n_phase,
    phase_first,
    phase_delay,
    pattern,
    columns,
    direct_at,
    direct,
    x,
    c,
    b,
    u,
    p,
    p_column,
    S,
    buffers,
    buffer_S,
    heads,
    time_s,
    period_s,
    substeps,
    implicit,
    begin,
    join,
    sens,
    Y,
    JY,
    weights,
):  # type: ignore[no-untyped-def]
    """Run over the rows of u (samples x inputs); fills Y (samples x outputs) and JY (samples x
    outputs x columns), the latter times `weights` (outputs).

    State, cells, buffers and sensitivities are carried in place, so that the next call continues.
    Returns the first sample at which the state is no longer finite, or -1.
    """
    n, nx, nc, ny, ns = u.shape[0], x.shape[0], c.shape[0], Y.shape[1], S.shape[1]
    width = max(max(nx, ny), nc) + 2
    out = np.zeros(width + columns.shape[0] + 2)
    D = np.zeros((width, ns))
    x0, k1 = np.zeros(nx), np.zeros(nx)
    S0, A = np.zeros((nx, ns)), np.zeros((nx, ns))
    M, r, pivots = np.zeros((nx, nx)), np.zeros((nx, 1)), np.zeros(nx, np.int64)
    q, before, base = np.zeros((nx, 1)), np.zeros(nx), np.zeros(nx)
    s, d, s0, total = S.ravel(), D.ravel(), S0.ravel(), A.ravel()
    t = np.zeros(6)
    h = period_s / substeps
    t[1], t[2] = h, period_s
    for k in range(n):
        row = k * u.shape[1]
        for sub in range(substeps):
            t[0] = time_s + k * period_s + sub * h
            t[3] = 1.0 if sub == 0 else 0.0
            t[4] = 1.0 if begin and k == 0 and sub == 0 else 0.0
            t[5] = 1.0 if join and k == 0 and sub == 0 else 0.0
            if nc > 0:
                _update_cells(
                    address,
                    n_phase,
                    phase_first,
                    phase_delay,
                    direct_at,
                    direct,
                    sens,
                    x,
                    c,
                    b,
                    u,
                    row,
                    p,
                    t,
                    out,
                    S,
                    D,
                    p_column,
                    buffers,
                    buffer_S,
                    heads,
                )
            if sub == 0:
                _call(address[4 if sens else 3], x, c, b, u, row, p, t, out)
                for i in range(ny):
                    Y[k, i] = out[i]
                if sens:
                    _multiply(address[5], out, ny, S, JY, k * ny * ns, ns)
                    for e in range(direct_at[1], direct_at[2]):
                        j = p_column[direct[e, 1]]
                        if j >= 0:
                            JY[k, direct[e, 0], j] += out[ny + direct[e, 2]]
                    for i in range(ny):
                        for j in range(ns):
                            JY[k, i, j] *= weights[i]
            if implicit:
                _sdirk2(
                    address,
                    pattern,
                    columns,
                    direct_at,
                    direct,
                    sens,
                    x,
                    c,
                    b,
                    u,
                    row,
                    p,
                    t,
                    h,
                    out,
                    S,
                    D,
                    p_column,
                    x0,
                    k1,
                    S0,
                    A,
                    M,
                    pivots,
                    r,
                    q,
                    before,
                    base,
                )
            else:
                _rk4(
                    address,
                    direct_at,
                    direct,
                    sens,
                    x,
                    c,
                    b,
                    u,
                    row,
                    p,
                    t,
                    h,
                    out,
                    S,
                    D,
                    p_column,
                    x0,
                    k1,
                    s,
                    d,
                    s0,
                    total,
                )
        for i in range(nx):
            if not abs(x[i]) < BLOWN_UP:
                Y[k + 1 :] = np.nan
                if sens:
                    JY[k + 1 :] = np.nan
                return k
    return -1


@njit(cache=True, nogil=True)
def prepare(address, p, derived):  # type: ignore[no-untyped-def]
    """Fill what depends on parameters only."""
    _call(address, p, p, p, p, 0, p, p, derived)


@njit(cache=True, nogil=True)
def rate_matrix(address, pattern, columns, x, c, b, u, p, time_s, step_s, period_s):  # type: ignore[no-untyped-def]
    """df/dx at one point, nx x nx."""
    nx = x.shape[0]
    out = np.zeros(nx + columns.shape[0] + 2)
    t = np.array([time_s, step_s, period_s, 1.0, 0.0, 0.0])
    _call(address[1], x, c, b, u, 0, p, t, out)
    M = np.zeros((nx, nx))
    for i in range(nx):
        for e in range(pattern[i], pattern[i + 1]):
            if columns[e] < nx:
                M[i, columns[e]] = out[nx + e]
    return M
