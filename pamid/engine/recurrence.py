"""Compiled passes through a recurrent tanh layer: the state alone, and the state with its exact sensitivities.

The layer is x(k+1) = tanh(C x(k) + drive(k)) with output y(k) = l . x(k+1) + c, where drive(k) = I u(k) + b.
Sensitivities are carried forward in time (real-time recurrent learning): with S = dx/dw,
S(k+1) = diag(1 - x(k+1)^2) (C S(k) + direct(k)). The direct part is sparse: weight (i, .) enters unit i only, so it
touches h + m + 1 entries of row i and is added afterwards instead of being part of a dense product.

Column order of S and of the first h (h + m + 1) columns of the Jacobian: unit by unit, and within unit i its h
context weights, its m input weights, its bias; then follow the h output weights and the output bias.

Arrays are float64 and C-contiguous; n samples, h hidden units, m inputs, p = h (h + m + 1).
"""

import math

from numba import njit

_WIDTH = 5  # state columns folded per sweep: enough to keep two result rows busy without spilling registers


@njit(
    "void(float64[:, ::1], float64[::1], float64, float64[:, ::1], float64[::1], float64[::1], float64[::1])",
    cache=True, nogil=True, fastmath={"contract"},
)
def run_states(context, output, output_bias, drive, state, scratch, y):
    """Simulate n steps.

    `context` (h, h), `output` (h,), `drive` (n, h); `state` (h,) holds x before the first step and is left at x after
    the last one; `scratch` (h,); `y` (n,) receives the output.
    """
    h = context.shape[0]
    for k in range(drive.shape[0]):
        for i in range(h):
            total = drive[k, i]
            for j in range(h):
                total += context[i, j] * state[j]
            scratch[i] = math.tanh(total)
        total = output_bias
        for i in range(h):
            state[i] = scratch[i]
            total += output[i] * state[i]
        y[k] = total


@njit("void(float64[:, ::1], float64[:, ::1], float64[:, ::1])", cache=True, nogil=True, fastmath={"contract"})
def _carry(context, sensitivity, carried):
    """carried = context @ sensitivity, two rows at a time (an odd last row is paired with its neighbour, redone)."""
    h, p = sensitivity.shape
    ragged = h % _WIDTH
    for i in range(0, h, 2):
        other = i + 1 if i + 1 < h else max(i - 1, 0)
        a, b, to_a, to_b = context[i], context[other], carried[i], carried[other]
        for j in range(ragged):
            source = sensitivity[j]
            if j == 0:
                for c in range(p):
                    to_a[c] = a[0] * source[c]
                    to_b[c] = b[0] * source[c]
            else:
                for c in range(p):
                    to_a[c] += a[j] * source[c]
                    to_b[c] += b[j] * source[c]
        for j in range(ragged, h, _WIDTH):
            a0, a1, a2, a3, a4 = a[j], a[j + 1], a[j + 2], a[j + 3], a[j + 4]
            b0, b1, b2, b3, b4 = b[j], b[j + 1], b[j + 2], b[j + 3], b[j + 4]
            s0, s1, s2 = sensitivity[j], sensitivity[j + 1], sensitivity[j + 2]
            s3, s4 = sensitivity[j + 3], sensitivity[j + 4]
            if j == 0:
                for c in range(p):
                    v0, v1, v2, v3, v4 = s0[c], s1[c], s2[c], s3[c], s4[c]
                    to_a[c] = a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3 + a4 * v4
                    to_b[c] = b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3 + b4 * v4
            else:
                for c in range(p):
                    v0, v1, v2, v3, v4 = s0[c], s1[c], s2[c], s3[c], s4[c]
                    to_a[c] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3 + a4 * v4
                    to_b[c] += b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3 + b4 * v4


@njit(
    "void(float64[:, ::1], float64[::1], float64, float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1],"
    " float64[::1], float64[:, ::1], float64[::1], float64[:, ::1])",
    cache=True, nogil=True, fastmath={"contract"},
)
def run_sensitivities(context, output, output_bias, drive, inputs, state, sensitivity, scratch, carried, y, jacobian):
    """Simulate n steps and write the output's exact derivative with respect to every weight.

    As `run_states`, with `inputs` (n, m); `sensitivity` (h, p) holds dx/dw before the first step and is left at its
    value after the last; `carried` (h, p) is scratch; `jacobian` (n, p + h + 1) receives dy/dw.
    """
    h, p = sensitivity.shape
    m = inputs.shape[1]
    per_unit = h + m + 1
    for k in range(drive.shape[0]):
        _carry(context, sensitivity, carried)
        total = output_bias
        for i in range(h):
            activation = drive[k, i]
            for j in range(h):
                activation += context[i, j] * state[j]
            scratch[i] = math.tanh(activation)
            total += output[i] * scratch[i]
        y[k] = total
        row = jacobian[k]
        for i in range(h):
            direct = carried[i, i * per_unit:(i + 1) * per_unit]
            for j in range(h):
                direct[j] += state[j]
            for j in range(m):
                direct[h + j] += inputs[k, j]
            direct[h + m] += 1.0
            slope = 1.0 - scratch[i] * scratch[i]
            weight = output[i]
            source, target = carried[i], sensitivity[i]
            if i == 0:
                for c in range(p):
                    target[c] = slope * source[c]
                    row[c] = weight * target[c]
            else:
                for c in range(p):
                    target[c] = slope * source[c]
                    row[c] += weight * target[c]
        for i in range(h):
            state[i] = scratch[i]
            row[p + i] = scratch[i]
        row[p + h] = 1.0
