"""How large an error is, how far it shrank, and how sure that is."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError


def mae(measured: ArrayLike, model: ArrayLike) -> float:
    """Mean absolute error of a channel, in the channel's unit (eq. 11 of the first paper).

    measured, model: arrays of the same shape. DataError if the shapes differ or nothing is given.
    """
    return float(np.mean(np.abs(_difference(measured, model))))


def rms(measured: ArrayLike, model: ArrayLike = 0.0) -> float:
    """Root mean square of the error (of the signal itself where no model is given), in the
    channel's unit."""
    return float(np.sqrt(np.mean(np.square(_difference(measured, model)))))


def seen_mean(table: ArrayLike) -> Array:
    """Mean over the rows that are there: NaN stands for what was not recorded, and for the mean of
    nothing."""
    values = np.asarray(table, dtype=float)
    here = ~np.isnan(values)
    if here.all():
        return np.asarray(values.mean(axis=0))
    count = here.sum(axis=0)
    total = np.where(here, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


#: of the largest value: digits of a file and the rounding of a conversion, no motion
SAME_DIGITS = 1e-9


def motion(values: ArrayLike) -> float:
    """Range of a signal (n,), in its unit; 0 where it spans no more than the last digits of its
    largest value. What divides or bins by a range uses this function: a unit in the last place is
    neither a range to divide by nor a range that can be cut into bins."""
    signal = np.asarray(values, dtype=float)
    span = float(np.ptp(signal))
    return span if span > SAME_DIGITS * float(np.abs(signal).max()) else 0.0


def independent_samples(first: ArrayLike, second: ArrayLike) -> float:
    """Effective number of independent pairs of two signals (n,) in the order of time.

    n_eff = n / (1 + 2 sum_k r_k s_k) with the autocorrelations r and s. The sum ends where either
    of them first reaches zero, so that a period counts as often as it is repeated: four samples in
    a cycle of a sine. Bartlett (1935), JRSS 98:536; for the end of the sum Geyer (1992),
    Statistical Science 7:473. 0 where a signal rests.
    """
    signals = [np.asarray(values, dtype=float) for values in (first, second)]
    if any(signal.size < 2 or motion(signal) == 0.0 for signal in signals):
        return 0.0
    correlations = [autocorrelation(signal / np.ptp(signal)) for signal in signals]
    r, s = (np.asarray(c) for c in correlations)
    ended = np.flatnonzero(np.minimum(r, s) <= 0.0)
    last = int(ended[0]) if ended.size else r.size
    return float(r.size / (1.0 + 2.0 * (r[1:last] * s[1:last]).sum()))


def adjusted_share(share: float, parts: int, independent: float) -> float:
    """Share of a variance that lies between parts of a signal, less what chance puts there.

    epsilon^2 = 1 - (1 - share) (n - 1) / (n - parts) with n independent samples; Kelley (1935),
    PNAS 21:554. 0 where chance does as much, and where there are no more samples than parts.
    """
    if independent <= parts:
        return 0.0
    return max(1.0 - (1.0 - share) * (independent - 1.0) / (independent - parts), 0.0)


def autocorrelation(values: Array) -> Array | None:
    """Sample autocorrelation (n,) at the lags 0 .. n - 1; None of a signal that rests."""
    n = len(values)
    # from the power spectrum, with zeros so that the end does not meet the start
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(values - values.mean(), size)
    sums = np.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    return np.asarray(sums / sums[0]) if sums[0] > 0.0 else None


PROBABILITY_BINS = 10


def probability_bin(probability: ArrayLike) -> NDArray[np.intp]:
    """Which tenth of 0 .. 1 a probability falls into."""
    place = (np.asarray(probability, dtype=float) * PROBABILITY_BINS).astype(np.intp)
    return np.minimum(place, PROBABILITY_BINS - 1)


def calibration_error(stated: ArrayLike, right: ArrayLike) -> float:
    """Expected calibration error: sum over tenths of share of cases x |mean probability - share
    right|.

    stated: probabilities, right: 1 or 0, both (n,). Naeini, Cooper and Hauskrecht (2015), AAAI.
    """
    p, yes = np.asarray(stated, dtype=float), np.asarray(right, dtype=float)
    gaps = np.bincount(probability_bin(p), p - yes, PROBABILITY_BINS)
    return float(np.abs(gaps).sum() / len(p))


LEVEL = 0.95  # of all intervals
#: from so many entries on a bootstrap spread is taken as it is
ENOUGH_ENTRIES = 6


def few_entries_factor(count: int) -> float:
    """By how much the bootstrap spread of a mean over so few entries (2 and more) is widened; 1
    from 6 on, as many as probabilities were learnt from and intervals were checked with.

    The spread of n entries comes out too small by sqrt((n - 1) / n), and Student's t with n - 1
    degrees of freedom takes the place of the normal distribution: both relative to 6 entries, 1.3
    for four and 6 for two. Hesterberg (2015), What Teachers Should Know About the Bootstrap, The
    American Statistician 69(4), on narrowness bias.
    """
    if count >= ENOUGH_ENTRIES:
        return 1.0
    from scipy.stats import t

    def reach(n: int) -> float:
        return float(t.ppf(0.5 + LEVEL / 2.0, n - 1)) * math.sqrt(n / (n - 1))

    return reach(max(count, 2)) / reach(ENOUGH_ENTRIES)


def moving_block_interval(
    numerator: ArrayLike,
    denominator: ArrayLike,
    *,
    block_length: int | None = None,
    resamples: int = 2000,
    seed: int = 0,
    widened: bool = True,
) -> tuple[float, float]:
    """Moving-block bootstrap interval of sum(numerator) / sum(denominator).

    numerator, denominator: the two losses per block of time, shape (n,), n >= 2. Runs of
    `block_length` successive entries (default n**(1/3), at least 1) are drawn together with
    replacement, wrapping round the end so that no entry is drawn less often; errors close in time
    are alike and must not count as separate witnesses. Returns (low, high), percentiles of
    `resamples` draws; widened: farther apart where there are few entries (`few_entries_factor`).
    Source: Kuensch (1989), Annals of Statistics 17(3); circular form Politis and Romano (1992).
    """
    above, below = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if above.ndim != 1 or above.shape != below.shape or above.size < 2:
        shapes = f"{above.shape} and {below.shape}"
        raise DataError(
            f"An interval needs two equal rows of at least 2 blocks, not {shapes}.", code="blocks"
        )
    if not (np.isfinite(above).all() and np.isfinite(below).all()):
        raise DataError("An interval needs finite losses.", code="not-finite")
    count = above.size
    length = block_length or max(1, round(count ** (1 / 3)))
    length = min(length, count)
    runs = math.ceil(count / length)
    starts = np.random.default_rng(seed).integers(0, count, size=(resamples, runs))
    rows = (starts[:, :, None] + np.arange(length)).reshape(resamples, -1)[:, :count] % count
    totals = below[rows].sum(axis=1)
    if not (totals > 0).all():
        raise DataError("There is no error to compare with in some of the blocks.", code="no-error")
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(above[rows].sum(axis=1) / totals, [tail, 100.0 - tail])
    if widened and (wider := few_entries_factor(count)) > 1.0:
        middle = float(above.sum() / below.sum())
        low, high = middle - wider * (middle - low), middle + wider * (high - middle)
    return float(low), float(high)


def wilson_interval(hits: int, of: int) -> tuple[float, float]:
    """Interval (low, high) of a share of which `hits` in `of` were seen; (0, 1) where nothing was.

    Source: Wilson (1927), J. Am. Stat. Assoc. 22, score interval without continuity correction.
    """
    if not 0 <= hits <= of:
        raise DataError(f"{hits} of {of} is no share.", code="share")
    if of == 0:
        return 0.0, 1.0
    z2 = NormalDist().inv_cdf(0.5 + LEVEL / 2.0) ** 2
    centre = (hits + z2 / 2.0) / (of + z2)
    reach = math.sqrt(z2 * (hits * (of - hits) / of + z2 / 4.0)) / (of + z2)
    return max(0.0, centre - reach), min(1.0, centre + reach)


def _difference(measured: ArrayLike, model: ArrayLike) -> Array:
    first, other = np.asarray(measured, dtype=float), np.asarray(model, dtype=float)
    if first.size == 0 or (other.ndim > 0 and first.shape != other.shape):
        raise DataError(
            f"Errors need arrays of equal shape, not {first.shape} and {other.shape}.", code="shape"
        )
    return first - other


def runs_of(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples, and samples behind the last, of the stretches where the mask (n,) holds."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
