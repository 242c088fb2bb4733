"""One signal brought to a new time base, by what it is: commands and references are held, measured
signals run smoothly through their samples, and are filtered first where the new base is coarser."""

from __future__ import annotations

import numpy as np

from pamid.base.metrics import FloatArray

COARSER = 1.01  # a new period longer than this many old ones needs the filter
HALF_TAPS = 30  # taps of the filter to either side, per old period in a new one
FILTER_WINDOW = ("kaiser", 8.0)  # passes what it passes to 1e-4
SAME_INSTANT = 1e-6  # of a period: an instant so close to a sample is that sample


def hold(instants: FloatArray, values: FloatArray, base: FloatArray, step: float) -> FloatArray:
    """Zero-order hold: the value in force in the middle of each sample of `base` (n,), which lasts
    `step` (s).

    The middle, not the beginning: a value that is written a little late would otherwise come one
    sample late. instants (m,) rising, s, and values (m,) without NaN; before the first instant its
    value.
    """
    index = np.searchsorted(instants, base + 0.5 * step, side="right") - 1
    return values[np.maximum(index, 0)]


def smooth(instants: FloatArray, values: FloatArray, base: FloatArray, step: float) -> FloatArray:
    """A measured signal at `base` (n,): monotone cubics through the samples; samples themselves
    where they coincide.

    Where `step` (s) is longer than the signal's own period, a zero-phase low-pass at the new
    Nyquist frequency goes before. instants (m,) rising, s, at least two; values (m,) without NaN.
    """
    from scipy.interpolate import PchipInterpolator

    # bursts with pauses between have no period of their own
    period = max(float(np.median(np.diff(instants))), 0.2 * float(np.mean(np.diff(instants))))
    if step > COARSER * period:
        instants, values = _filtered(instants, values, period, step)
    resampled = np.asarray(
        PchipInterpolator(instants, values)(np.clip(base, instants[0], instants[-1]))
    )
    nearest = np.clip(np.searchsorted(instants, base - 0.5 * period), 0, instants.size - 1)
    same = np.abs(instants[nearest] - base) <= SAME_INSTANT * period
    resampled[same] = values[nearest[same]]
    return resampled


def _filtered(
    instants: FloatArray, values: FloatArray, period: float, step: float
) -> tuple[FloatArray, FloatArray]:
    """The signal on an even base of its own period, low-passed at the Nyquist frequency of `step`,
    without delay."""
    from scipy.interpolate import PchipInterpolator
    from scipy.signal import firwin, oaconvolve

    count = int(round((instants[-1] - instants[0]) / period)) + 1
    even = np.linspace(instants[0], instants[-1], count)
    if count != instants.size or np.abs(even - instants).max() > SAME_INSTANT * period:
        values = np.asarray(PchipInterpolator(instants, values)(even))
    reach = min(int(HALF_TAPS * step / period), count - 1)
    taps = firwin(2 * reach + 1, min(period / step, 0.99), window=FILTER_WINDOW)
    # mirrored about its ends, so that a slope goes on there
    before, after = (
        2.0 * values[0] - values[reach:0:-1],
        2.0 * values[-1] - values[-2 : -reach - 2 : -1],
    )
    wide = np.concatenate([before, values, after])
    return even, np.asarray(oaconvolve(wide, taps, mode="valid"))
