"""Local parabolas and Welch's periodogram. scipy.signal has both, and takes half a second to load,
in every process."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pamid.base.arrays import Array


def local_parabola(y: Array, length: int, period_s: float = 1.0, derivative: int = 0) -> Array:
    """Value or derivative of the parabola through the samples around each sample.

    y: (samples,), at least `length` of them; length: odd number of samples that a parabola is
    fitted to, the first and the last of the recording to its ends; derivative: 0 or 1, per second.
    Savitzky and Golay (1964), Analytical Chemistry 36(8), 1627-1639.
    """
    half = length // 2
    at = np.arange(-half, half + 1.0)
    # rows: coefficients of the parabola by the samples
    fitted = np.linalg.pinv(np.vander(at, 3, increasing=True))
    order = np.arange(3)
    # value or derivative of 1, t and t^2 where the parabola is read
    basis = at[:, None] ** order
    if derivative:
        basis = order * at[:, None] ** np.maximum(order - 1, 0) / period_s
    weights = basis @ fitted
    out = np.empty(len(y))
    out[half : len(y) - half] = np.convolve(y, weights[half, ::-1], "valid")
    out[:half] = weights[:half] @ y[:length]
    out[len(y) - half :] = weights[half + 1 :] @ y[-length:]
    return out


def welch_power(y: Array, segment: int) -> Array:
    """One-sided power of signals (samples, channels) in `segment` // 2 + 1 bands, up to a factor:
    mean over half-overlapping segments of their Hann-windowed spectra, less the mean of each.

    References
    ----------
    Welch (1967), IEEE Transactions on Audio and Electroacoustics 15(2), 70-73.
    """
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
    parts = sliding_window_view(y, segment, axis=0)[:: segment - segment // 2]
    parts = (parts - parts.mean(axis=-1, keepdims=True)) * window
    power: Array = (np.abs(np.fft.rfft(parts, axis=-1)) ** 2).mean(axis=0).T
    power[1 : (segment + 1) // 2] *= 2.0  # negative frequencies; zero and Nyquist have none
    return power
