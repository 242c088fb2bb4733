"""Compiled passes through a recurrent tanh layer: the state alone, and the state with its exact
sensitivities.

The layer is x(k+1) = tanh(C x(k) + I u(k) + b) with output y(k) = l . x(k+1) + c. Sensitivities are
carried forward in time (real-time recurrent learning): with S = dx/dw and the slopes d = 1 -
x(k+1)^2,
    S(k+1) = diag(d) C S(k) + direct(k).
The direct part is sparse: weight (i, .) enters unit i only, so it touches h + m + 1 entries of row
i and is added afterwards instead of being part of the dense product. That product, with the output
l . S(k+1) added to it, takes most of the time: it is written in vectors of `LANES` columns, `ROWS`
results at a time, all kept in registers.

Column order of S and of the first h (h + m + 1) columns of the Jacobian: unit by unit, and within
unit i its h context weights, its m input weights, its bias; then follow the h output weights and
the output bias.

Arrays are float64 and C-contiguous; n samples, h hidden units, m inputs, p = h (h + m + 1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as _intrinsic

from pamid.engine.numba_cache import njit
from pamid.engine.simd import INT64, LANES, Vectors

ROWS = 5  # results held at once: with their factors they fit into sixteen registers
# numba's annotation keeps the typing context that a call leaves out
intrinsic: Any = _intrinsic


@intrinsic
def _propagate(typingctx, matrix, before, after, output, jacobian, first, h, p):  # type: ignore[no-untyped-def]
    """after = matrix @ before, and output @ after to the p numbers of `jacobian` from place `first`
    on."""
    signature = types.void(
        matrix, before, after, output, jacobian, types.intp, types.intp, types.intp
    )

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        factors, old, new, weights, rows = (
            context.make_array(sig.args[i])(context, builder, args[i]).data for i in range(5)
        )
        first, h, p = args[5:]
        v = Vectors(builder)

        def place(row, column):  # type: ignore[no-untyped-def]
            return builder.add(builder.mul(row, p), column)

        def some_rows(top, count, column, total):  # type: ignore[no-untyped-def]
            places = [builder.add(top, INT64(i)) for i in range(count)]
            sums = [v.held(v.constant(0.0)) for _ in places]
            with cgutils.for_range(builder, h) as loop:
                value = v.load(old, place(loop.index, column))
                for i, held in zip(places, sums, strict=True):
                    v.add(
                        held, v.spread(factors, builder.add(builder.mul(i, h), loop.index)), value
                    )
            for i, held in zip(places, sums, strict=True):
                value = builder.load(held)
                v.store(value, new, place(i, column))
                v.add(total, v.spread(weights, i), value)

        groups, rest = builder.sdiv(h, INT64(ROWS)), builder.srem(h, INT64(ROWS))
        with cgutils.for_range(builder, builder.sdiv(p, INT64(LANES))) as tile:
            column = builder.mul(tile.index, INT64(LANES))
            total = v.held(v.constant(0.0))
            with cgutils.for_range(builder, groups) as group:
                some_rows(builder.mul(group.index, INT64(ROWS)), ROWS, column, total)
            for count in range(1, ROWS):
                with builder.if_then(builder.icmp_signed("==", rest, INT64(count))):
                    some_rows(builder.mul(groups, INT64(ROWS)), count, column, total)
            v.store(builder.load(total), rows, builder.add(first, column))
        return context.get_dummy_value()

    return signature, codegen


def _product_codegen(finish):  # type: ignore[no-untyped-def]
    """Code for values = finish(values + matrix @ seen), with the matrix's columns (count, wide) in
    sequence."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        factors, x, to = (
            context.make_array(sig.args[i])(context, builder, args[i]).data for i in range(3)
        )
        v = Vectors(builder)
        with cgutils.for_range(builder, builder.sdiv(args[4], INT64(LANES))) as tile:
            column = builder.mul(tile.index, INT64(LANES))
            held = v.held(v.load(to, column))
            with cgutils.for_range(builder, args[3]) as loop:
                place = builder.add(builder.mul(loop.index, args[4]), column)
                v.add(held, v.spread(x, loop.index), v.load(factors, place))
            v.store(finish(v, builder.load(held)), to, column)
        return context.get_dummy_value()

    return codegen


@intrinsic
def _add_product(typingctx, columns, seen, values, count, wide):  # type: ignore[no-untyped-def]
    """values = values + matrix @ seen; `columns` (count, wide)."""
    return types.void(columns, seen, values, types.intp, types.intp), _product_codegen(
        lambda v, x: x
    )


@intrinsic
def _add_product_tanh(typingctx, columns, seen, values, count, wide):  # type: ignore[no-untyped-def]
    """values = tanh(values + matrix @ seen); `columns` (count, wide)."""
    return types.void(columns, seen, values, types.intp, types.intp), _product_codegen(
        lambda v, x: v.tanh(x)
    )


@njit(
    "void(float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_states(columns, inputs, state, states):
    """Simulate n steps.

    `columns` (h + m + 1, wide) are those of [C, I, b], padded with zeros to whole vectors; `inputs`
    (n, m); `state` (h,) holds x before the first step and is left at x after the last step;
    `states` (n, at least h) receives x after every step.
    """
    h, m = state.shape[0], inputs.shape[1]
    seen, fresh = np.ones(h + m + 1), np.empty(columns.shape[1])
    seen[:h] = state
    for k in range(inputs.shape[0]):
        for j in range(m):
            seen[h + j] = inputs[k, j]
        fresh[:] = 0.0
        _add_product_tanh(columns, seen, fresh, h + m + 1, columns.shape[1])
        for i in range(h):
            seen[i] = states[k, i] = fresh[i]
    state[:] = seen[:h]


@njit(
    "float64(float64[:, ::1], float64[:, ::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_growth(columns, states):
    """Sum over the samples of the logarithm by which a small disturbance of the state grows,
        v(k+1) = diag(1 - x(k+1)^2) C v(k),   sum of log |v(k+1)| / |v(k)|,
    from a v(0) of equal entries; -inf where it is gone after a sample.

    `columns` (h, wide) are those of C, padded with zeros to whole vectors; `states` (n, at least h)
    as from `run_states`.
    """
    h, wide = columns.shape
    along, fresh = np.full(h, 1.0 / np.sqrt(h)), np.empty(wide)
    total = 0.0
    for k in range(states.shape[0]):
        fresh[:] = 0.0
        _add_product(columns, along, fresh, h, wide)
        size = 0.0
        for i in range(h):
            after = states[k, i]
            along[i] = (1.0 - after * after) * fresh[i]
            size += along[i] * along[i]
        if size == 0.0:
            return -np.inf
        # Normalised at every sample: over a long recording the product itself would overflow or
        # vanish.
        size = np.sqrt(size)
        total += np.log(size)
        for i in range(h):
            along[i] /= size
    return total


@njit(
    "void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1], "
    "float64[::1], float64[::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_bend(columns, change, inputs, states, output, output_change, bend):
    """Second derivative of the output along a change of the weights, exactly (a Taylor series
    through time).

    With a = [C, I, b] [x, u, 1], dashes for derivatives by s, and x(k+1) = tanh(a(k)):
        a' = d[C, I, b] [x, u, 1] + C x',   a'' = 2 dC x' + C x''
        x' = (1 - x^2) a',   x'' = (1 - x^2) (a'' - 2 x a'^2),   y'' = l x'' + 2 dl x'

    `columns` and `change` (h + m + 1, wide) are those of [C, I, b] and of a change of it, `inputs`
    (n, m), `states` (n, at least h) as from `run_states` from a zero state; `output` and
    `output_change` (h,). `bend` (n,) receives d2 y / d s2 at s = 0 for weights w + s change.
    """
    h, m, wide = output.shape[0], inputs.shape[1], columns.shape[1]
    seen, dx, ddx, twice = np.ones(h + m + 1), np.zeros(h), np.zeros(h), np.zeros(h)
    seen[:h] = 0.0
    da, dda = np.empty(wide), np.empty(wide)
    for k in range(inputs.shape[0]):
        for j in range(m):
            seen[h + j] = inputs[k, j]
        da[:] = 0.0
        dda[:] = 0.0
        _add_product(change, seen, da, h + m + 1, wide)
        _add_product(columns, dx, da, h, wide)
        _add_product(change, twice, dda, h, wide)
        _add_product(columns, ddx, dda, h, wide)
        total = 0.0
        for i in range(h):
            after = states[k, i]
            slope = 1.0 - after * after
            seen[i], dx[i] = after, slope * da[i]
            ddx[i] = slope * dda[i] - 2.0 * after * slope * da[i] * da[i]
            twice[i] = 2.0 * dx[i]
            total += output[i] * ddx[i] + output_change[i] * twice[i]
        bend[k] = total


@njit(
    "void(float64[:, ::1], float64[:, ::1], float64[::1], float64, float64[:, ::1], float64[::1], "
    "float64[:, :, ::1], float64[::1], float64[::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_sensitivities(units, columns, output, output_bias, inputs, state, sensitivity, y, jacobian):
    """Simulate n steps and write the output's exact derivative with respect to every weight.

    As `run_states`, with `units` (h, h + m + 1), that is [C, I, b], and its `columns`;
    `sensitivity` (2, h, at least p, a multiple of LANES) holds dx/dw before the first step in
    sensitivity[0], which is left at its value after the last; `y` (n,) receives the output,
    `jacobian` (n (p + h + 1) + LANES,) the rows of dy/dw in sequence (the last numbers are
    scratch: a row's last vector may reach into the next row, which is written after it).
    """
    h, per_unit = units.shape
    m, wide, p = inputs.shape[1], sensitivity.shape[2], h * per_unit
    matrix, seen, fresh = np.empty((h, h)), np.ones(per_unit), np.empty(columns.shape[1])
    before, after = sensitivity[0], sensitivity[1]
    seen[:h] = state
    for k in range(inputs.shape[0]):
        total, first = output_bias, k * (p + h + 1)
        for j in range(m):
            seen[h + j] = inputs[k, j]
        fresh[:] = 0.0
        _add_product_tanh(columns, seen, fresh, per_unit, columns.shape[1])
        for i in range(h):
            total += output[i] * fresh[i]
            for j in range(h):
                matrix[i, j] = (1.0 - fresh[i] * fresh[i]) * units[i, j]
        y[k] = total
        _propagate(matrix, before, after, output, jacobian, first, h, wide)
        for i in range(h):
            slope = 1.0 - fresh[i] * fresh[i]
            entries, row = (
                after[i, i * per_unit : (i + 1) * per_unit],
                jacobian[first + i * per_unit :],
            )
            for j in range(per_unit):
                entries[j] += slope * seen[j]
            for j in range(per_unit):
                row[j] += output[i] * slope * seen[j]
        for i in range(h):
            seen[i] = jacobian[first + p + i] = fresh[i]
        jacobian[first + p + h] = 1.0
        before, after = after, before
    state[:] = seen[:h]
    if inputs.shape[0] % 2:  # the halves were exchanged after every sample
        sensitivity[0] = sensitivity[1]


@njit(
    "void(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1], "
    "float64[:, ::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_adjoint(rows, output, states, inputs, weighing, gradient):
    """Add d(sum of weighing y)/dw for the weights [C, I, b] to `gradient` (h, h + m + 1), going
    back in time.

    With v the weighing and D(k) = diag(1 - x(k+1)^2), the adjoint is a(k) = D(k) (l v(k) + C'
    a(k+1)), zero behind the end, and the gradient the sum of a(k) [x(k), u(k), 1]'.

    `rows` (h, wide) are those of C, padded with zeros to whole vectors; `states` (n, at least h) as
    from `run_states` from a zero state, `inputs` (n, m), `weighing` (n,).
    """
    h, m, wide = rows.shape[0], inputs.shape[1], rows.shape[1]
    adjoint, entering, seen = np.zeros(wide), np.empty(h), np.ones(h + m + 1)
    for k in range(states.shape[0] - 1, -1, -1):
        for i in range(h):
            entering[i] = (weighing[k] * output[i] + adjoint[i]) * (
                1.0 - states[k, i] * states[k, i]
            )
            seen[i] = states[k - 1, i] if k > 0 else 0.0
        for j in range(m):
            seen[h + j] = inputs[k, j]
        for i in range(h):
            row, factor = gradient[i], entering[i]
            for j in range(h + m + 1):
                row[j] += factor * seen[j]
        adjoint[:] = 0.0
        # the product takes a matrix by columns: given its rows it is that with C'
        _add_product(rows, entering, adjoint, h, wide)
