"""An excitation without its slow part, for rigs that add up what they are sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def washed_out(wave: Array, share: float) -> Array:
    """A wave (samples,) less its running mean over this share of its length, as if it were at rest
    before and after, and less what mean that leaves; within +-1 as before.

    What is left of a slow part falls with the square of its frequency, so that even the second
    integral, the way of a mass that is pushed, stays about where it was.
    """
    half = max(round(0.5 * share * len(wave)), 1)
    total = np.concatenate([np.zeros(half + 1), np.cumsum(wave)])
    total = np.concatenate([total, np.full(half, total[-1])])
    left = wave - (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    left = left - left.mean()
    highest = float(np.abs(left).max())
    return left / highest if highest > 1.0 else left
