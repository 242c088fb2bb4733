"""Evidence for the weights: Bayesian regularisation after Foresee and Hagan (1997, ICNN, pp.
1930-1935), who put MacKay's evidence framework (1992, Neural Computation 4(3)) into
Levenberg-Marquardt.

The objective is F = beta E_D + alpha E_W with E_D the sum of squared errors and E_W the sum of
squared weights. At its minimum, with the Gauss-Newton Hessian H = 2 beta J'J + 2 alpha I,
    gamma = N_w - 2 alpha tr(H^-1)      weights that the data decide ("effective parameters")
    alpha = gamma / (2 E_W),   beta = (n - gamma) / (2 E_D)
Everything here works on J'J (N_w, N_w) only, or on J's singular values where rounding took too
much from that (root_sums.py), so it serves any network. No eigenvalue is dropped for its size.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh, lapack

from pamid.base.arrays import Array
from pamid.networks.root_sums import Spectrum

_TINY = 1e-300
# eps times the condition of the scaled matrix, up to which J'J is believed. At the first paper's
# size, condition 2e11, eps times it is 4e-5 and gamma is right to 7e-7
RESOLVED = 0.01


@dataclass(frozen=True)
class Evidence:
    """Bayesian estimate of noise and weights: `gamma` effective weights, weight decay `alpha`,
    precision `beta`."""

    gamma: float
    alpha: float
    beta: float


def evidence_of(gamma: float, samples: float, sse: float, ssw: float) -> Evidence:
    """A step of the fixed-point iteration at weights that gave `sse` and `ssw`. Before any
    Hessian all weights count as effective (the start of Foresee and Hagan's algorithm)."""
    # as many effective weights as samples leave no degree of freedom to measure noise with: keep a
    # sliver
    freedom = max(samples - gamma, 1e-3 * samples)
    return Evidence(gamma, gamma / (2.0 * max(ssw, _TINY)), freedom / (2.0 * max(sse, _TINY)))


def effective_weights(evidence: Evidence, sums: Array | Spectrum) -> float:
    """gamma = N_w - 2 alpha tr(H^-1), kept within [0, N_w] against rounding; from J'J or, where
    that does not hold enough (`resolved`), from the singular values of J."""
    if isinstance(sums, Spectrum):
        return _counted(evidence.beta * sums.values**2, evidence.alpha)
    n = len(sums)
    if evidence.alpha == 0.0:
        return float(n)
    # H / 2 = beta J'J + alpha I, so that gamma = N_w - alpha tr((H / 2)^-1); with H / 2 = L L' that
    # trace is the sum of squares of the entries of L^-1
    factor, size = _scaled_factor(evidence.beta * sums, evidence.alpha)
    if factor is not None:
        inverse = lapack.dtrtri(factor, lower=1)[0] / size
        return float(np.clip(n - evidence.alpha * float(np.sum(inverse * inverse)), 0.0, n))
    # without the root of J, directions below the rounding of its square are not counted
    values = eigh(evidence.beta * sums, eigvals_only=True)
    return _counted(values[values > evidence.beta * _rounding(sums)], evidence.alpha)


def resolved(evidence: Evidence, jtj: Array) -> bool:
    """Whether J'J determines gamma and the steps in spite of rounding."""
    return (
        evidence.alpha == 0.0 or _scaled_factor(evidence.beta * jtj, evidence.alpha)[0] is not None
    )


def _scaled_factor(matrix: Array, alpha: float) -> tuple[Array | None, Array]:
    """Cholesky factor of matrix + alpha I (in its place) divided by the roots of its diagonal on
    either side, None where that is not resolved; the roots.

    Such a factor is as good as the condition of the scaled matrix (Demmel and Veselic 1992, SIAM J.
    Matrix Anal. Appl. 13(4)), however far apart the eigenvalues are: 16 decades at the first
    paper's size.
    """
    matrix[np.diag_indices(len(matrix))] += alpha
    # A unit diagonal is within a factor n of the best scaling that a diagonal can give.
    size = np.sqrt(np.maximum(np.diag(matrix), _TINY))
    scaled = matrix / size / size[:, None]
    norm = float(np.abs(scaled).sum(axis=0).max())
    factor, failed = lapack.dpotrf(scaled, lower=1, clean=1)
    share = 0.0 if failed else float(lapack.dpocon(factor, norm, uplo="L")[0])
    good = np.finfo(float).eps <= RESOLVED * share
    return (factor if good else None), size


def _counted(values: Array, alpha: float) -> float:
    """gamma = sum of l / (l + alpha) over the eigenvalues l of beta J'J (MacKay 1992)."""
    # Without weight decay every weight counts, also a weight of which the data show nothing.
    return float(np.sum(values / (values + alpha))) if alpha else float(len(values))


def promised_decrease(half_hessian: Array, half_descent: Array) -> float:
    """Decrease of F by a full, undamped step of its quadratic model.

    g' (H / 2)^-1 g with g half of -dF/dw; where rounding hides some directions of the Hessian, over
    the others.
    """
    if _scaled_factor(half_hessian.copy(), 0.0)[0] is not None:
        return float(half_descent @ solve_damped(half_hessian, 0.0, half_descent))
    # Slower than a Cholesky factor by a multiple, but it separates the directions that rounding
    # has left undecided.
    values, vectors = eigh(half_hessian)
    keep = values > _rounding(half_hessian)
    along = vectors[:, keep].T @ half_descent
    return float(np.sum(along * along / values[keep]))


def _rounding(matrix: Array) -> float:
    """The size below which an eigenvalue of a positive semi-definite matrix is rounding error."""
    return float(len(matrix) * np.finfo(float).eps * max(np.trace(matrix), _TINY))


def solve_damped(matrix: Array, damping: float, right: Array) -> Array:
    """Solve (matrix + damping I) x = right for a positive semi-definite matrix, also where it is
    singular.

    Cholesky; where rounding makes that fail, eigenvalues with the undecided directions left at
    zero.
    """
    damped = matrix.copy()
    damped[np.diag_indices(len(damped))] += damping
    try:
        return np.asarray(
            cho_solve(cho_factor(damped, lower=True, check_finite=False), right, check_finite=False)
        )
    except LinAlgError:
        values, vectors = eigh(damped)
        keep = values > _rounding(damped)
        return np.asarray(vectors[:, keep] @ ((vectors[:, keep].T @ right) / values[keep]))


def effective_samples(residual: ArrayLike) -> float:
    """Number of independent samples in a correlated residual (N,): N / (1 + 2 sum of
    autocorrelations).

    The sum runs while neighbouring pairs of autocorrelations stay positive (Geyer 1992, Statistical
    Science 7(4)). At 3 ms a residual changes little from sample to sample, and N overstates the
    information in the record.
    """
    e = np.asarray(residual, dtype=np.float64)
    n = len(e)
    # A constant offset would look like a correlation that never ends.
    e = e - e.mean()
    power = float(e @ e)
    if n < 4 or power <= n * _TINY:
        return float(n)
    # Padded to twice the length, because the transform is periodic and would correlate the end
    # with the beginning.
    spectrum = np.fft.rfft(e, 1 << int(2 * n - 1).bit_length())
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[:n] / power
    # rho_2k + rho_2k+1; with the first pair, which holds rho_0 = 1, counted in full, the sum of the
    # whole symmetric function is 2 sum(pairs) - 1
    pairs = correlation[0 : n - 1 : 2] + correlation[1:n:2]
    ends = np.flatnonzero(pairs <= 0.0)
    total = 2.0 * float(np.sum(pairs[: ends[0] if len(ends) else len(pairs)])) - 1.0
    # A residual that alternates in sign is worth more than n samples by this formula. It never
    # counts as more.
    return float(np.clip(n / max(total, 1.0), 1.0, n))
