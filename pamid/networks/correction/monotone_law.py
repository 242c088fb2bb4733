"""The consequents of a trained ANFIS solved again, so that its force grows with pressure and falls
with contraction wherever the muscle pulls.

The output is linear in the consequents, and so is its difference between two neighbours of the grid
on which a force law is checked, in the trained range and a tenth beyond. With the membership sets
as they were trained, the nearest monotone law is therefore a least-squares problem with linear
inequalities. It is solved by its dual, a problem of non-negative least squares (Lawson, Hanson
1974, Solving Least Squares Problems, ch. 23); the inequalities that are broken are added until none
is, so that nothing is required of the law where the muscle is slack on both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from pamid.base.arrays import Array
from pamid.networks.anfis import Anfis
from pamid.networks.correction.trained_force_law import CHECKED_POINTS, grid_of_law
from pamid.networks.trained_network import TrainedNetwork

CUTTING_ROUNDS = 60
MOST_ADDED = 400  # broken inequalities that are added in a round, the worst of them
BROKEN_BELOW = 1e-9  # of the range of forces: what rounding leaves of an inequality
LEAST_RIDGE = 1e-9  # least weight of a consequent's square, of the mean square of its features


def constrained(trained: TrainedNetwork, inputs: Array, target: Array) -> TrainedNetwork | None:
    """The law nearest to target (points,), N, at inputs (points, 2) in the units of the network,
    among those that are monotone where they pull; None where the rounds did not suffice.

    The weight of the regularisation is that of the training.
    """
    network, (features, slack, pressure_axis) = trained.network, grid_of_law(trained)
    assert isinstance(network, Anfis)
    rows = network.features(trained.weights, trained.input_scaling.forward(inputs))
    scaled = trained.output_scaling.forward(target)
    alpha, beta = (trained.summary.get(name) or 0.0 for name in ("alpha", "beta"))
    size = rows.shape[1]
    least = LEAST_RIDGE * float(np.trace(rows.T @ rows)) / size
    ridge = max(alpha / beta if beta else 0.0, least)
    root = np.linalg.cholesky(rows.T @ rows + ridge * np.eye(size))
    wanted = rows.T @ scaled
    broken = np.zeros((0, size))
    linear = trained.weights[network.linear]
    for _ in range(CUTTING_ROUNDS):
        more = _broken(features, features @ linear - slack, pressure_axis)
        if not len(more):
            weights = trained.weights.copy()
            weights[network.linear] = linear
            return replace(trained, weights=weights)
        broken = np.vstack([broken, more])
        # c = H^-1 (b + G' l) with the l >= 0 that make |R^-T (b + G' l)| least, H = R' R
        dual = solve_triangular(root, broken.T, lower=True)
        free = solve_triangular(root, wanted, lower=True)
        multipliers = nnls(dual, -free, maxiter=50 * dual.shape[1])[0]
        linear = solve_triangular(root.T, free + dual @ multipliers, lower=False)
    return None


def _broken(features: Array, force: Array, pressure_axis: int) -> Array:
    """Rows g of inequalities g c >= 0 (k, weights) that consequents with this scaled force over the
    grid (POINTS^2,) break: between neighbours of the grid of which either pulls."""
    force, features = (
        x.reshape(CHECKED_POINTS, CHECKED_POINTS, *x.shape[1:]) for x in (force, features)
    )
    pull, rows, sizes = np.maximum(force, 0.0), [], []
    for axis, sign in ((pressure_axis, 1.0), (1 - pressure_axis, -1.0)):
        ahead, behind = (np.moveaxis(x, axis, 0) for x in (pull, features))
        fall = -sign * np.diff(ahead, axis=0)
        at = fall > 2.0 * BROKEN_BELOW  # the scaled range is 2 wide
        rows.append(sign * np.diff(behind, axis=0)[at])
        sizes.append(fall[at])
    fallen = np.concatenate(sizes)
    return np.concatenate(rows)[np.argsort(-fallen, kind="stable")[:MOST_ADDED]]
