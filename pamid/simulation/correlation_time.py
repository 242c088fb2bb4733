"""Correlation time of recordings, the unit of all window lengths.

A window to fit over, a window to replay, the slices of a smoother: each has to be long compared
with the machine's memory and short compared with the recording, on a joint with samples of 3 ms as
on two tanks with samples of 4 s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pamid.base.arrays import Array

FORGOTTEN = float(np.exp(-1.0))
STAYS = 3  # times the lag over which the correlation stays below
LEAST_LAG = 10.0  # samples: no horizon can follow a faster signal
LONGEST_SHARE = 0.125  # of a recording: slower is drift, which a recording this long cannot show


def correlation_samples(y: Array, noise: float = 0.0) -> tuple[float, float]:
    """Correlation time of a channel (n,) in samples, plain and ringing, each at least 10 and at
    most an eighth of the channel; noise: standard deviation of its white noise, same unit as y. NaN
    where nothing but noise moves."""
    y = y - y.mean()
    n = len(y)
    most = max(LEAST_LAG, LONGEST_SHARE * n)
    power = float(y @ y) - n * noise**2
    if power <= n * noise**2 or power <= 0.0:
        return float("nan"), float("nan")
    size = 1 << (2 * n - 1).bit_length()
    rho = np.fft.irfft(np.abs(np.fft.rfft(y, size)) ** 2, size)[1:n] / power
    below = np.flatnonzero(rho < FORGOTTEN) + 1  # lags
    remembered = np.flatnonzero(np.abs(rho) >= FORGOTTEN) + 1
    # the lag l is long enough where none of l .. STAYS l is among those remembered
    after = np.concatenate([[0], remembered]) + 1
    upto = np.concatenate([remembered, [n]])
    settled = after[STAYS * after < upto]
    plain, ringing = (float(lags[0]) if len(lags) else most for lags in (below, settled))
    return min(max(plain, LEAST_LAG), most), min(max(ringing, LEAST_LAG), most)


def timescale_of(
    parts: Sequence[tuple[Array, Array, float]],
    most_s: float = float("inf"),
    most_ringing_s: float = float("inf"),
) -> float:
    """Correlation time (s) of recordings: y (samples x channels, NaN where a channel was not
    recorded), noise per channel, sampling period (s). The geometric mean over channels and
    recordings, longer recordings counting for more, at most these; an eighth of the longest where
    nothing moves."""
    times, weight = list[tuple[float, float]](), list[float]()
    for y, noise, period_s in parts:
        for column, sigma in zip(y.T, noise, strict=True):
            if np.isnan(column).any():
                continue
            plain, ringing = correlation_samples(column, float(sigma))
            if np.isfinite(plain):
                times.append((np.log(plain * period_s), np.log(ringing * period_s)))
                weight.append(len(column) * period_s)
    if not times:
        return min(LONGEST_SHARE * max(len(y) * period_s for y, _, period_s in parts), most_s)
    plain, ringing = np.exp(np.average(times, axis=0, weights=weight))
    return float(max(min(plain, most_s), min(ringing, most_ringing_s)))
