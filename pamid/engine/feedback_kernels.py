"""Compiled passes through a tanh layer that sees its network's earlier outputs (external
dynamics).

The layer is y(k) = l . tanh(drive(k) + F [y(k-s), y(k-2s), ..., y(k-ls)]) + c, where drive(k) = W
taps(k) + b holds all that comes from outside. Sensitivities go through the fed-back outputs:
    dy(k)/dw = direct(k) + sum_j g_j(k) dy(k-js)/dw,   g_j(k) = sum_i l_i (1 - x_i^2) F_ij,   x =
    tanh(...)
Since only the output is fed back, a row per sample is carried on, and the Jacobian itself is the
memory.

Column order of the Jacobian: unit by unit, and within unit i its q tap weights, its l feedback
weights, its bias; then follow the h output weights and the output bias.

Arrays are float64 and C-contiguous; n samples, h hidden units, q taps from outside, l fed-back
outputs, s samples between these, reach r = l s, per unit q + l + 1 weights, p = h (q + l + 1) + h +
1 weights in all.
"""

import math

from pamid.engine.numba_cache import njit


@njit(
    "void(float64[:, ::1], float64[::1], float64, float64[:, ::1], int64, float64[::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_outputs(feedback, output, output_bias, drive, stride, y):
    """Simulate n steps.

    `feedback` (h, l), `output` (h,), `drive` (n, h); `y` (r + n,) holds r earlier outputs and
    receives n new ones.
    """
    h, lags = feedback.shape
    reach = lags * stride
    for k in range(drive.shape[0]):
        total = output_bias
        for i in range(h):
            activation = drive[k, i]
            for j in range(lags):
                activation += feedback[i, j] * y[reach + k - (j + 1) * stride]
            total += output[i] * math.tanh(activation)
        y[reach + k] = total


@njit(
    "void(float64[:, ::1], float64[::1], float64, float64[:, ::1], float64[:, ::1], int64, "
    "float64[::1], float64[::1], float64[:, ::1])",
    cache=True,
    nogil=True,
    fastmath={"contract"},
)
def run_output_sensitivities(
    feedback, output, output_bias, drive, taps, stride, hidden, y, jacobian
):
    """Simulate n steps and write the output's exact derivative with respect to every weight.

    As `run_outputs`, with `taps` (n, q); `hidden` (h,) is scratch; `jacobian` (r + n, p) holds
    dy/dw of the r earlier outputs and receives that of the n new ones.
    """
    h, lags = feedback.shape
    q = taps.shape[1]
    reach, per_unit, p = lags * stride, q + lags + 1, jacobian.shape[1]
    for k in range(drive.shape[0]):
        now, row, seen = reach + k, jacobian[reach + k], taps[k]
        total = output_bias
        for i in range(h):
            activation = drive[k, i]
            for j in range(lags):
                activation += feedback[i, j] * y[now - (j + 1) * stride]
            hidden[i] = math.tanh(activation)
            total += output[i] * hidden[i]
        y[now] = total
        for j in range(lags):
            # The derivative by each fed-back output is summed over the units first: p columns are
            # then touched once per lag, not once per unit and lag.
            gain = 0.0
            for i in range(h):
                gain += output[i] * (1.0 - hidden[i] * hidden[i]) * feedback[i, j]
            earlier = jacobian[now - (j + 1) * stride]
            # The first lag overwrites the row, which still holds numbers of an earlier chunk. A
            # pass of zeros is saved.
            if j == 0:
                for c in range(p):
                    row[c] = gain * earlier[c]
            else:
                for c in range(p):
                    row[c] += gain * earlier[c]
        for i in range(h):
            slope = output[i] * (1.0 - hidden[i] * hidden[i])
            entries = row[i * per_unit : (i + 1) * per_unit]
            for j in range(q):
                entries[j] += slope * seen[j]
            for j in range(lags):
                entries[q + j] += slope * y[now - (j + 1) * stride]
            entries[q + lags] += slope
            row[p - 1 - h + i] += hidden[i]
        row[p - 1] += 1.0
