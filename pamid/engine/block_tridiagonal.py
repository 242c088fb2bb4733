"""Symmetric block-tridiagonal systems, of multiple shooting and of smoothing.

Block Gaussian elimination without pivoting between blocks (Golub and Van Loan 2013, Matrix
Computations, section 4.5.1), with B_i = off[i] below the diagonal and its transpose above:

    forward   M_0 = D_0,  M_i+1 = D_i+1 - B_i M_i^-1 B_i',  z_i+1 = rhs_i+1 - B_i M_i^-1 z_i
    backward  x_i = M_i^-1 (z_i - B_i' x_i+1)

The determinant of the whole is the product of those of the M_i.
"""

from __future__ import annotations

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.lu import factor, solve
from pamid.engine.numba_cache import njit


def eliminate(D: Array, off: Array, rhs: Array, damping: float) -> tuple[Array, float]:
    """Solve the system; also the log determinant of its matrix.

    D (w,n,n): diagonal blocks; off (w-1,n,n): off[i] couples block i+1 (rows) to i (columns); rhs
    (w,n,m). damping: share of the diagonal added to it.
    """
    w, n, _ = D.shape
    # Copies, because a rejected step is solved again from the same blocks with another damping.
    M, z = np.ascontiguousarray(D).copy(), np.ascontiguousarray(rhs).copy()
    # 1e-12 of the diagonal keeps the pivots of directions that no data see above round-off, 1e-300
    # those of a row that is zero throughout above zero
    M[:, range(n), range(n)] += (damping + 1e-12) * np.einsum("wii->wi", D) + 1e-300
    return z, float(_eliminate(M, np.ascontiguousarray(off), z))


@njit(cache=True, nogil=True)
def _eliminate(M, off, z):  # type: ignore[no-untyped-def]
    """Block elimination in place: z becomes the solution, M its pivots' factors; returns log
    |det|."""
    w, n, _ = M.shape
    m = z.shape[2]
    pivots = np.zeros((w, n), np.int64)
    log_det = 0.0
    carried = np.empty((n, n + m))
    for i in range(w):
        factor(M[i], pivots[i])
        for j in range(n):  # |det M_i| is the product of U's diagonal
            log_det += np.log(np.abs(M[i, j, j]))
        if i + 1 == w:
            break
        for r in range(n):  # M[i]^-1 [off[i]' | z[i]]
            for c in range(n):
                carried[r, c] = off[i, c, r]
            for c in range(m):
                carried[r, n + c] = z[i, r, c]
        solve(M[i], pivots[i], carried)
        for r in range(n):
            for k in range(n):
                a = off[i, r, k]
                if a != 0.0:  # most states do not couple to all others across a joint
                    for c in range(n):
                        M[i + 1, r, c] -= a * carried[k, c]
                    for c in range(m):
                        z[i + 1, r, c] -= a * carried[k, n + c]
    solve(M[w - 1], pivots[w - 1], z[w - 1])
    # The backward pass reads the factors that the forward pass has left in M, so that no block is
    # factored twice.
    for i in range(w - 2, -1, -1):
        for k in range(n):
            for r in range(n):
                a = off[i, k, r]
                if a != 0.0:
                    for c in range(m):
                        z[i, r, c] -= a * z[i + 1, k, c]
        solve(M[i], pivots[i], z[i])
    return log_det
