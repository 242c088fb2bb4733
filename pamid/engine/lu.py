"""Small dense linear systems inside a sweep: P M = L U with partial pivoting, in place (Golub and
Van Loan 2013, Matrix Computations, sections 3.1 and 3.4).

`factor` leaves U above and L (unit diagonal) below; pivots[j] is the row that was exchanged with
row j at step j. A pivot of zero becomes 1e-300: the solution is huge or not finite, which the
caller sees.
"""

from __future__ import annotations

from pamid.engine.numba_cache import njit


@njit(cache=True)
def factor(M, pivots):  # type: ignore[no-untyped-def]
    """L and U in the place of M (n, n); pivots (n,) int64."""
    n = M.shape[0]
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(M[i, j]) > abs(M[best, j]):
                best = i
        pivots[j] = best
        if best != j:
            for k in range(n):
                M[j, k], M[best, k] = M[best, k], M[j, k]
        if M[j, j] == 0.0:
            M[j, j] = 1e-300
        for i in range(j + 1, n):
            M[i, j] /= M[j, j]
            for k in range(j + 1, n):
                M[i, k] -= M[i, j] * M[j, k]


@njit(cache=True)
def solve(M, pivots, B):  # type: ignore[no-untyped-def]
    """Solve M X = B with the factors by `factor`: B (n, m) becomes X."""
    n, m = B.shape
    for j in range(n):
        if pivots[j] != j:
            for k in range(m):
                B[j, k], B[pivots[j], k] = B[pivots[j], k], B[j, k]
    for j in range(n):
        for i in range(j + 1, n):
            for k in range(m):
                B[i, k] -= M[i, j] * B[j, k]
    for j in range(n - 1, -1, -1):
        for k in range(m):
            B[j, k] /= M[j, j]
        for i in range(j):
            for k in range(m):
                B[i, k] -= M[i, j] * B[j, k]
