"""Resampling of a signal by its kind. Commands and references are held. Measured signals are
interpolated smoothly, and filtered first if the new time base is coarser."""

from __future__ import annotations

import numpy as np

from pamid.base.metrics import FloatArray

COARSER = 1.01  # ratio of new to old period from which on the filter is needed
HALF_TAPS = 30  # taps of the filter on either side, per ratio of new to old period
FILTER_WINDOW = ("kaiser", 8.0)  # pass-band ripple of 1e-4
SAME_INSTANT = 1e-6  # of a period: largest distance of an instant from the sample that it equals


def hold(instants: FloatArray, values: FloatArray, base: FloatArray, step: float) -> FloatArray:
    """Zero-order hold: the value in the middle of each sample of `base` (n,), of length `step` (s).

    The value at the beginning would be a sample late if it was logged slightly late. instants
    (m,) rising, s; values (m,) without NaN. Before the first instant the first value is used.
    """
    index = np.searchsorted(instants, base + 0.5 * step, side="right") - 1
    return values[np.maximum(index, 0)]


def smooth(instants: FloatArray, values: FloatArray, base: FloatArray, step: float) -> FloatArray:
    """Measured signal at `base` (n,) by monotone cubic interpolation (PCHIP); exact at samples.

    If `step` (s) is longer than the period of the signal, a zero-phase low-pass at the new Nyquist
    frequency is applied first. instants (m,) rising, s, at least two; values (m,) without NaN.
    """
    from scipy.interpolate import PchipInterpolator

    # the median step of bursts with pauses is far below the mean spacing of samples
    period = max(float(np.median(np.diff(instants))), 0.2 * float(np.mean(np.diff(instants))))
    if step > COARSER * period:
        from scipy.signal import firwin, oaconvolve

        count = int(round((instants[-1] - instants[0]) / period)) + 1
        even = np.linspace(instants[0], instants[-1], count)
        if count != instants.size or np.abs(even - instants).max() > SAME_INSTANT * period:
            values = np.asarray(PchipInterpolator(instants, values)(even))
        reach = min(int(HALF_TAPS * step / period), count - 1)
        taps = firwin(2 * reach + 1, min(period / step, 0.99), window=FILTER_WINDOW)
        # odd reflection about the ends, so that a slope continues there
        before, after = (
            2.0 * values[0] - values[reach:0:-1],
            2.0 * values[-1] - values[-2 : -reach - 2 : -1],
        )
        wide = np.concatenate([before, values, after])
        instants, values = even, np.asarray(oaconvolve(wide, taps, mode="valid"))
    resampled = np.asarray(
        PchipInterpolator(instants, values)(np.clip(base, instants[0], instants[-1]))
    )
    nearest = np.clip(np.searchsorted(instants, base - 0.5 * period), 0, instants.size - 1)
    same = np.abs(instants[nearest] - base) <= SAME_INSTANT * period
    resampled[same] = values[nearest[same]]
    return resampled
