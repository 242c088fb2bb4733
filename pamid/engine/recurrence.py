"""Compiled passes through a recurrent tanh layer: the state alone, and the state with its exact sensitivities.

The layer is x(k+1) = tanh(C x(k) + drive(k)) with output y(k) = l . x(k+1) + c, where drive(k) = I u(k) + b.
Sensitivities are carried forward in time (real-time recurrent learning): with S = dx/dw and the slopes
d = 1 - x(k+1)^2,
    S(k+1) = diag(d) C S(k) + direct(k).
The direct part is sparse: weight (i, .) enters unit i only, so it touches h + m + 1 entries of row i and is added
afterwards instead of being part of the dense product. That product, with the output's row l . S(k+1) beside it, is where
the time goes: it is written in vectors of `LANES` columns, `ROWS` results at a time, all kept in registers.

Column order of S and of the first h (h + m + 1) columns of the Jacobian: unit by unit, and within unit i its h
context weights, its m input weights, its bias; then follow the h output weights and the output bias.

Arrays are float64 and C-contiguous; n samples, h hidden units, m inputs, p = h (h + m + 1).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic as _intrinsic

LANES = 8   # columns in a vector; sensitivities are padded to a multiple of it
ROWS = 5    # results held at once: with their factors they fit into sixteen registers
intrinsic: Any = _intrinsic   # numba's own annotation keeps the typing context that a call leaves out


@intrinsic
def _carry(typingctx, matrix, before, after, output, jacobian, first, h, p):  # type: ignore[no-untyped-def]
    """after = matrix @ before, and output @ after to the p numbers of `jacobian` from place `first` on."""
    signature = types.void(matrix, before, after, output, jacobian, types.intp, types.intp, types.intp)

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        factors, old, new, weights, rows = (
            context.make_array(sig.args[i])(context, builder, args[i]).data for i in range(5))
        first, h, p = args[5:]
        word, vector = ir.IntType(64), ir.VectorType(ir.DoubleType(), LANES)
        fma = cgutils.get_or_insert_function(builder.module, ir.FunctionType(vector, [vector] * 3),
                                             f"llvm.fmuladd.v{LANES}f64")
        nothing, zeros = ir.Constant(vector, ir.Undefined), ir.Constant(vector, [0.0] * LANES)
        same = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)

        def spread(base, place):  # type: ignore[no-untyped-def]
            number = builder.load(builder.gep(base, [place]))
            lane = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
            return builder.shuffle_vector(lane, nothing, same)

        def at(base, row, column):  # type: ignore[no-untyped-def]
            place = builder.add(builder.mul(row, p), column)
            return builder.bitcast(builder.gep(base, [place]), vector.as_pointer())

        def add(held, factor, value):  # type: ignore[no-untyped-def]
            builder.store(builder.call(fma, [factor, value, builder.load(held)]), held)

        def some_rows(top, count, column, total):  # type: ignore[no-untyped-def]
            places = [builder.add(top, word(i)) for i in range(count)]
            sums = [cgutils.alloca_once(builder, vector) for _ in places]
            for held in sums:
                builder.store(zeros, held)
            with cgutils.for_range(builder, h) as loop:
                value = builder.load(at(old, loop.index, column), align=8)
                for i, held in zip(places, sums, strict=True):
                    add(held, spread(factors, builder.add(builder.mul(i, h), loop.index)), value)
            for i, held in zip(places, sums, strict=True):
                value = builder.load(held)
                builder.store(value, at(new, i, column), align=8)
                add(total, spread(weights, i), value)

        whole, rest = builder.sdiv(h, word(ROWS)), builder.srem(h, word(ROWS))
        total = cgutils.alloca_once(builder, vector)
        with cgutils.for_range(builder, builder.sdiv(p, word(LANES))) as tile:
            column = builder.mul(tile.index, word(LANES))
            builder.store(zeros, total)
            with cgutils.for_range(builder, whole) as group:
                some_rows(builder.mul(group.index, word(ROWS)), ROWS, column, total)
            for count in range(1, ROWS):
                with builder.if_then(builder.icmp_signed("==", rest, word(count))):
                    some_rows(builder.mul(whole, word(ROWS)), count, column, total)
            builder.store(builder.load(total), at(rows, word(0), builder.add(first, column)), align=8)
        return context.get_dummy_value()

    return signature, codegen


@njit("float64(float64)", cache=True, nogil=True, inline="always")
def _tanh(a):
    """tanh(a) to 2e-16, a third of the time of the library's (which is exact relative to small values, too)."""
    return 1.0 - 2.0 / (math.exp(2.0 * a) + 1.0)


@njit(
    "void(float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1])",
    cache=True, nogil=True, fastmath={"contract"},
)
def run_states(context, drive, state, states):
    """Simulate n steps.

    `context` (h, h), `drive` (n, h); `state` (h,) holds x before the first step and is left at x after the last one;
    `states` (n, h) receives x after every step.
    """
    h = context.shape[0]
    for k in range(drive.shape[0]):
        for i in range(h):
            total = drive[k, i]
            for j in range(h):
                total += context[i, j] * state[j]
            states[k, i] = _tanh(total)
        for i in range(h):
            state[i] = states[k, i]


@njit(
    "void(float64[:, ::1], float64[::1], float64, float64[:, ::1], float64[:, ::1], float64[::1], float64[:, :, ::1],"
    " float64[::1], float64[::1])",
    cache=True, nogil=True, fastmath={"contract"},
)
def run_sensitivities(context, output, output_bias, drive, inputs, state, sensitivity, y, jacobian):
    """Simulate n steps and write the output's exact derivative with respect to every weight.

    As `run_states`, with `inputs` (n, m); `sensitivity` (2, h, at least p, a multiple of LANES) holds dx/dw before the
    first step in sensitivity[0], which is left at its value after the last; `y` (n,) receives the output, `jacobian`
    (n (p + h + 1) + LANES,) the rows of dy/dw one after the other (the last numbers are scratch: a row's last vector
    may reach into the next row, which is written after it).
    """
    h, m = context.shape[0], inputs.shape[1]
    wide, per_unit = sensitivity.shape[2], h + m + 1
    p = h * per_unit
    matrix, fresh, entering = np.empty((h, h)), np.empty(h), np.ones(per_unit)
    before, after = sensitivity[0], sensitivity[1]
    for k in range(drive.shape[0]):
        total, first = output_bias, k * (p + h + 1)
        for i in range(h):
            activation = drive[k, i]
            for j in range(h):
                activation += context[i, j] * state[j]
            fresh[i] = _tanh(activation)
            total += output[i] * fresh[i]
            for j in range(h):
                matrix[i, j] = (1.0 - fresh[i] * fresh[i]) * context[i, j]
        y[k] = total
        entering[:h] = state
        entering[h:h + m] = inputs[k]
        _carry(matrix, before, after, output, jacobian, first, h, wide)
        for i in range(h):
            slope = 1.0 - fresh[i] * fresh[i]
            own, row = after[i, i * per_unit:(i + 1) * per_unit], jacobian[first + i * per_unit:]
            for j in range(per_unit):
                own[j] += slope * entering[j]
            for j in range(per_unit):
                row[j] += output[i] * slope * entering[j]
        for i in range(h):
            state[i] = jacobian[first + p + i] = fresh[i]
        jacobian[first + p + h] = 1.0
        before, after = after, before
    if drive.shape[0] % 2:
        sensitivity[0] = sensitivity[1]


@njit(
    "void(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1])",
    cache=True, nogil=True, fastmath={"contract"},
)
def run_adjoint(context, output, states, inputs, weighing, gradient):
    """Add d(sum of weighing y)/dw for context, input and bias weights to `gradient` (h, h + m + 1), going back in time.

    `states` (n, h) as from `run_states` from a zero state, `inputs` (n, m), `weighing` (n,).
    """
    h, m = context.shape[0], inputs.shape[1]
    adjoint, entering = np.zeros(h), np.empty(h)
    for k in range(states.shape[0] - 1, -1, -1):
        for i in range(h):
            total = weighing[k] * output[i]
            total += adjoint[i]
            entering[i] = total * (1.0 - states[k, i] * states[k, i])
            adjoint[i] = 0.0
        for i in range(h):
            row = gradient[i]
            if k > 0:
                for j in range(h):
                    row[j] += entering[i] * states[k - 1, j]
            for j in range(m):
                row[h + j] += entering[i] * inputs[k, j]
            row[h + m] += entering[i]
            for j in range(h):
                adjoint[j] += context[i, j] * entering[i]
