"""How much a residual counts: by its size and by how many samples say the same thing.

n correlated samples hold as much as n / tau independent ones, tau = 1 + 2 sum_k rho_k the
integrated autocorrelation time; so each counts with 1 / (sigma^2 tau). Priestley (1981), Spectral
Analysis and Time Series, ch. 5.3.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import autocorrelation, seen_mean


@dataclass(frozen=True)
class Weights:
    """sigma: size of the residual per channel (SI); correlated: samples per independent residual,
    per channel."""

    sigma: Array
    correlated: Array

    @property
    def root(self) -> Array:
        return 1.0 / (self.sigma * np.sqrt(self.correlated))


def residual_weights(residuals: tuple[Array, ...], noise: Array, window: int) -> Weights:
    """Size and correlation of residuals per channel (NaN where it was not recorded): rms (at least
    the noise) and integrated autocorrelation time.

    window: samples per window. The correlation counts up to an eighth of it: the windows' starts
    absorb slower errors.
    """
    rms = np.sqrt(seen_mean(np.concatenate(residuals) ** 2))
    most = window / 8.0
    lengths = np.empty(len(rms))
    for c in range(len(rms)):
        # A single recording only: a correlation over the seam of two would be that of two offsets.
        longest = max((r for r in residuals if not np.isnan(r[0, c])), key=len)
        lengths[c] = correlation_length(longest[:, c])
    # Not below the noise: a residual that is smaller by chance would give its channel a weight
    # that no sensor justifies.
    return Weights(np.maximum(rms, noise), np.clip(lengths, 1.0, max(most, 1.0)))


def correlation_length(r: Array) -> float:
    """Samples per independent sample: 1 + 2 sum of autocorrelations up to the first below 0.05,
    from where on their estimates are little but noise."""
    auto = autocorrelation(r)
    if auto is None:
        return 1.0
    below = np.flatnonzero(auto < 0.05)
    return float(max(1.0, 1.0 + 2.0 * auto[1 : int(below[0]) if len(below) else len(r)].sum()))
