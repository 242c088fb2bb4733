"""Normal equations to full precision: a triangular root R with R'R = J'J, from rows of J that come
in chunks.

Rounded to 16 digits, J'J holds no eigenvalue below n eps trace(J'J). A recurrent network near the
edge of stability has a very large trace: 1e15 over the 66667 samples of the first paper's task.
Most of the regularised directions lie below that line, and the number of effective weights would be
a rank of floating point. R holds the singular values of J themselves, down to eps times the
largest: twice as many digits.

Rows are added to J'J directly while its rounding leaves all eigenvalues down to `finest`. From
there on they are added in the coordinates of the root so far,

    K = J_chunk R^-1,   G = I + sum of K'K,   J'J = R' G R,

where no direction is small: the Cholesky factor of G is as good as that of a well-conditioned
matrix (the preconditioned Cholesky QR of Yamamoto, Nakatsukasa, Yanagisawa and Fukaya 2015, ETNA
44, with the sums so far as the preconditioner). Where G grows beyond `GROWN` the root absorbs it, R
:= chol(G)' R, G := I. A chunk that alone is larger is absorbed by a QR decomposition (Golub and Van
Loan 2013, Matrix Computations, 5.2). A chunk costs a triangular product more than its J'J;
`benchmarks/elman_pass.py` measures it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular

from pamid.base.arrays import Array

# share of `finest` that may be lost: its possible influence on gamma, per weight
LOST = 1e-4
# largest trace of G beyond its start: it keeps eps times this, relative to every direction
GROWN = 1e7
# column blocks of the triangular product: 5/8 of a full product
BLOCKS = 4


@dataclass(frozen=True)
class Spectrum:
    """J = U diag(values) vectors', and along = U'e: all that a step needs of the normal equations.

    values (n,), vectors (n, n) in columns, along (n,): J'J = vectors diag(values^2) vectors', J'e =
    vectors (values * along).
    """

    values: Array
    vectors: Array
    along: Array

    def step(self, beta: float, alpha: float, mu: float, weights: Array) -> Array:
        """v of (beta J'J + (alpha + mu) I) v = beta J'e - alpha w."""
        right = beta * self.values * self.along - alpha * (weights @ self.vectors)
        return np.asarray(self.vectors @ (right / (beta * self.values**2 + alpha + mu)))

    def solved(self, beta: float, damping: float, right: Array) -> Array:
        """v of (beta J'J + damping I) v = right."""
        return np.asarray(
            self.vectors @ ((right @ self.vectors) / (beta * self.values**2 + damping))
        )

    def promised(self, beta: float, alpha: float, weights: Array) -> float:
        """g' (beta J'J + alpha I)^-1 g with g = beta J'e - alpha w."""
        right = beta * self.values * self.along - alpha * (weights @ self.vectors)
        return float(np.sum(right * right / (beta * self.values**2 + alpha)))


class RootSums:
    """Sums over rows of a Jacobian: sse, and J'J and J'e either as they are or by their root.

    finest: eigenvalues of J'J below it need not differ from zero; 0 where all of them must, which
    leaves J'J as it is.
    """

    def __init__(self, n_weights: int, finest: float = 0.0) -> None:
        self.n, self.lost = n_weights, LOST * finest
        self.sse, self.jte, self.jtj = 0.0, np.zeros(n_weights), np.zeros((n_weights, n_weights))
        self.root: Array | None = None  # R, upper triangular
        self.inverse = self.grown = np.empty((0, 0))  # R^-1 and G
        self.along = np.empty(0)  # h with J'e = R'h

    def add(self, rows: Array, error: Array) -> None:
        """rows (m, n) of J, error (m,) of the same samples; both may be overwritten afterwards."""
        if not len(error):
            return
        self.sse += float(error @ error)
        if self.root is None:
            # numpy multiplies half of it and, unlike scipy's dsyrk, lets other threads run
            square = rows.T @ rows
            # the rounding error of J'J with this chunk, below its limit (not for NaN)
            size = float(np.trace(self.jtj) + np.trace(square))
            if not self.lost or not self.n * np.finfo(float).eps * size > self.lost:
                self.jte += error @ rows
                self.jtj += square
                return
            # the root of the sum so far; the admissible error holds directions without data
            self.jtj[np.diag_indices(self.n)] += self.lost
            self._set_root(cholesky(self.jtj, check_finite=False))
            self.along = solve_triangular(self.root, self.jte, trans="T", check_finite=False)
        # rows R^-1, by blocks of its columns, whose lower part is zero
        turned = np.empty_like(rows)
        cuts = np.linspace(0, self.n, BLOCKS + 1).astype(int).tolist()
        for a, b in pairwise(cuts):
            np.matmul(rows[:, :b], self.inverse[:b, a:b], out=turned[:, a:b])
        square = turned.T @ turned
        if np.trace(square) < GROWN:
            self.grown += square
            self.along += error @ turned
            if np.trace(self.grown) - self.n > GROWN:
                self._take_up()
        elif np.isfinite(rows).all() and np.isfinite(error).all():
            self._take_up()
            assert self.root is not None
            # the root of R and a chunk below it, that is larger than R in some direction by far
            above = np.column_stack([self.root, self.along])
            stacked = np.vstack([above, np.column_stack([rows, error])])
            triangle = qr(stacked, mode="r", overwrite_a=True, check_finite=False)[0][: self.n]
            # A QR decomposition leaves signs of its rows open. A positive diagonal makes the root
            # unique, as a Cholesky factor is.
            signs = np.where(np.diag(triangle) < 0.0, -1.0, 1.0)
            triangle = signs[:, None] * triangle
            self.along = np.ascontiguousarray(triangle[:, -1])
            self._set_root(np.ascontiguousarray(triangle[:, :-1]))
        else:  # an overflow: it shows in the result
            self.sse = np.inf

    def spectrum(self) -> Spectrum | None:
        """Accumulated spectrum; None where J'J itself is good enough, or after an overflow."""
        if self.root is None or not np.isfinite(self.sse):
            return None
        self._take_up()
        # Of the root, not of J'J: squaring would lose the digits that the root was kept for.
        left, values, right = np.linalg.svd(self.root)
        return Spectrum(values, np.ascontiguousarray(right.T), left.T @ self.along)

    def _set_root(self, root: Array) -> None:
        self.root, self.grown = root, np.eye(self.n)
        self.inverse = np.ascontiguousarray(
            solve_triangular(root, np.eye(self.n), check_finite=False)
        )

    def _take_up(self) -> None:
        """R := chol(G)' R, G := I."""
        factor = cholesky(self.grown, check_finite=False)
        assert self.root is not None
        self.along = solve_triangular(factor, self.along, trans="T", check_finite=False)
        self._set_root(np.triu(factor @ self.root))
