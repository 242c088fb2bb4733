"""Time stamps that were written with few digits: do they come from an even clock?

At 300 Hz and with four decimals stamps read 0.0033, 0.0067, 0.0100: the steps differ by 3 %, the
clock by nothing. Even it is where some start and period put every stamp within half its last digit,
which is checked exactly; no deviation beyond that is excused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MOST_OF_A_PERIOD = 0.5  # a coarser digit hides lost samples
_DIGITS = 9  # decimals looked for; below, 1 % of no period is missed
_NARROWINGS = 80  # of the period, by a third each: to the last bit
_TOUCH = 1e-3  # of a digit
_FEWEST_HALVES = 3  # stamps at either end of their digit


def last_digits(stamps: FloatArray) -> FloatArray:
    """Value of a unit in the last digit of every stamp (n,), s: as many decimals as any of them
    has, or as many significant digits, where these were counted."""
    counts = np.full(stamps.size, _DIGITS, dtype=np.int64)  # decimals of each stamp
    for decimals in range(_DIGITS - 1, -1, -1):
        scaled = stamps * 10.0**decimals
        whole = np.abs(scaled - np.round(scaled)) <= np.maximum(1e-6, 4.0 * np.spacing(scaled))
        counts[whole] = decimals
    size = np.floor(np.log10(np.maximum(np.abs(stamps), 10.0**-_DIGITS))).astype(np.int64)
    significant = int((counts + size).max())
    return np.asarray(10.0 ** np.maximum(-int(counts.max()), size - significant))


def even_but_rounded(stamps: FloatArray) -> bool:
    """Is there an even clock that gives these rising stamps (n,), s, once it is rounded (or cut
    off) to their last digits?"""
    count = stamps.size
    if count < 3:
        return False
    digit = last_digits(stamps)
    period = float(stamps[-1] - stamps[0]) / (count - 1)
    if digit.max() > MOST_OF_A_PERIOD * period:
        return False
    place, half = np.arange(count, dtype=np.float64), 0.5 * digit

    def edges(trial: float) -> tuple[FloatArray, FloatArray]:
        """Earliest and latest start of the clock of this period, by every stamp, s."""
        course = stamps - trial * place
        return course - half, course + half

    def excess(trial: float) -> float:
        """How far the clock stays outside the stamps' digits, s; below 0: nowhere."""
        earliest, latest = edges(trial)
        return float(earliest.max() - latest.min())

    # convex in the period, whose error the first and the last stamp bound
    low, high = (period + sign * 2.0 * float(digit.max()) / (count - 1) for sign in (-1.0, 1.0))
    for _ in range(_NARROWINGS):
        a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
        below, above = excess(a), excess(b)
        if min(below, above) < -_TOUCH * float(digit.min()):
            return True
        low, high = (low, b) if below < above else (a, high)
    # a clock that meets both ends of a digit, as halves do that are rounded to either side: then
    # several stamps do, not a single stamp that is off by a digit
    earliest, latest = edges(0.5 * (low + high))
    early, late, touch = earliest.max(), latest.min(), _TOUCH * float(digit.min())
    ends = (np.count_nonzero(earliest >= early - touch), np.count_nonzero(latest <= late + touch))
    return bool(early - late <= touch and min(ends) >= _FEWEST_HALVES)
