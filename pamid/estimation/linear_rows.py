"""A fit's least squares row by row: weighted residuals, joints between windows, the data sheet, and
their derivatives by the free parameters and the window starts.

A fit itself needs their sums alone (`pamid.estimation.multiple_shooting`, whose notation holds
here). The rows are wanted where several models are compared to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.estimation.lane_windows import moved_parameters, run_lanes
from pamid.estimation.problem import Fit, Problem
from pamid.simulation.windows import Runner

STARTS_RIDGE = 1e-10  # share of a column's square that keeps normal equations solvable


@dataclass(frozen=True, eq=False)
class LinearRows:
    """away (m,): what a fit squares and adds up; by_parameters (m, free), in prior spreads;
    start_blocks: those by the window starts that may differ from 0, each with its first row and
    column; channel (m,): of every residual, -1 for joints between windows and for the data sheet,
    whose `free` rows are the last; every: of how many samples a single sample is used."""

    away: Array
    by_parameters: Array
    start_blocks: tuple[tuple[int, int, Array], ...]
    start_count: int
    channel: NDArray[np.intp]
    every: int

    @property
    def by_starts(self) -> Array:
        """Derivatives by the window starts (m, start_count)."""
        rows = np.zeros((len(self.away), self.start_count))
        for row, column, block in self.start_blocks:
            rows[row : row + len(block), column : column + block.shape[1]] = block
        return rows

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.away).all() and np.isfinite(self.by_parameters).all())


def linear_rows(
    at: Fit, most: int, *, derivatives: bool = True, known: tuple[KnownSlopes | None, ...] = ()
) -> LinearRows:
    """Rows at the parameters and window starts of a fit.

    Of the residuals about `most` rows at most, evenly thinned and weighted up for the others:
    neighbours of a finely sampled residual are nearly the same. known: slopes along the tracks of a
    rig that is stepped, used where they hold; derivatives: without them those of the model are
    zero, and the runs cost a small part.
    """
    problem = at.problem
    free, scale, root_of_weights = list(problem.free), problem.scale, at.weights.root
    k, every, place, row = len(free), _thinning(problem, most), 0, 0
    blocks = list[tuple[Array, Array]]()  # residuals, derivatives by the parameters
    by_starts, channel = list[tuple[int, int, Array]](), list[NDArray[np.intp]]()
    for i, (track, x, joint) in enumerate(
        zip(problem.tracks, at.starts, at.continuity, strict=True)
    ):
        runner = Runner(problem.assembly, track, at.stepping, problem.free)
        runner = runner.keeping(known[i]) if known else runner
        values, windows, n = runner.parameters(at.p), problem.windows(track), runner.start_states
        root = np.where(track.seen, root_of_weights, 0.0)
        runs = runner.run_windows(runner.memory(values), windows, x, values, derivatives, root)
        for w, (window, run) in enumerate(zip(windows, runs, strict=True)):
            r = np.nan_to_num((run.Y - track.y[window.start : window.stop]) * root)
            # The factor keeps the sum of squares, so that thinned residuals weigh as much against
            # the priors as all of them.
            r = np.sqrt(every) * r[::every].ravel()
            by = np.zeros((len(r), k + n))
            if derivatives:
                by = np.sqrt(every) * run.JY[::every].reshape(len(r), -1)[:, : k + n]
            blocks.append((r, by[:, :k]))
            by_starts.append((row, place, by[:, k:]))
            channel.append(np.tile(np.arange(track.y.shape[1]), len(r) // track.y.shape[1]))
            row += len(r)
            if w + 1 < len(windows):
                inverse = np.sqrt(joint)
                end = inverse[:, None] * run.S[:, : k + n] if derivatives else np.zeros((n, k + n))
                blocks.append((inverse * (x[w + 1] - run.end[:n]), -end[:, :k]))
                by_starts.append((row, place, np.hstack([-end[:, k:], np.diag(inverse)])))
                channel.append(np.full(n, -1))
                row += n
            place += n
    away = np.concatenate([*(r for r, _ in blocks), scale.inside(at.p[free])])
    by_parameters = np.concatenate([by for _, by in blocks]) * scale.slope(at.p[free])
    channel.append(np.full(k, -1))
    return LinearRows(
        away,
        np.concatenate([by_parameters, np.eye(k)]),
        tuple(by_starts),
        place,
        np.concatenate(channel),
        every,
    )


def moved_rows(at: Fit, most: int, moved: NDArray[np.intp]) -> tuple[Array, Array]:
    """Rows of residuals and joints as in `linear_rows`, without those of the data sheet.

    moved: places, among the free parameters, of those to differentiate by. Returns the rows (m,)
    and their derivatives (m, moved) in prior spreads, as differences of runs side by side.
    """
    problem = at.problem
    every, blocks = _thinning(problem, most), list[Array]()
    lanes, moves = moved_parameters(problem, at.p, moved)
    for track, x, joint in zip(problem.tracks, at.starts, at.continuity, strict=True):
        windows, n = problem.windows(track), x.shape[1]
        Y, ends = run_lanes(problem.assembly, track, windows, x, lanes, at.stepping)
        root = np.sqrt(every) * np.where(track.seen, at.weights.root, 0.0)
        away = np.nan_to_num((Y - track.y[:, :, None]) * root[:, None])
        jumps = np.sqrt(joint)[:, None] * (x[1:, :, None] - ends[:-1, :n])
        for w, window in enumerate(windows):
            blocks.append(away[window.start : window.stop : every].reshape(-1, lanes.shape[1]))
            blocks += [jumps[w]] if w + 1 < len(windows) else []
    rows = np.concatenate(blocks)
    return rows[:, 0], (rows[:, 1:] - rows[:, :1]) / moves


def _thinning(problem: Problem, most: int) -> int:
    """Stride of the samples for about `most` rows."""
    return max(1, -(-sum(t.y.size for t in problem.tracks) // most))


def left_over(rows: LinearRows, columns: Array, held: NDArray[np.bool_]) -> Array:
    """Columns (m, any) with the span of the parameters and the window starts projected out.

    held: parameters that take no part (free,). The window starts are projected out first: their
    rows are nearly all zero, so that even the many of a long recording cost little.
    """
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    blocks = rows.start_blocks
    places = [np.indices(b.shape).reshape(2, -1) + [[row], [column]] for row, column, b in blocks]
    values = np.concatenate([block.ravel() for *_, block in blocks])
    shape = len(rows.away), rows.start_count
    S = coo_array((values, tuple(np.concatenate(places, axis=1))), shape).tocsc()
    size = np.sqrt(S.power(2).sum(axis=0))
    S = S @ diags_array(1.0 / np.where(size > 0.0, size, 1.0))
    # a state that no output shows leaves a column of zeros, or two that are alike
    factor = splu((S.T @ S + diags_array(np.full(rows.start_count, STARTS_RIDGE))).tocsc())
    parameters = rows.by_parameters[:, ~held]
    left = np.column_stack([parameters, columns])
    for _ in range(2):  # the second time against rounding
        left -= S @ factor.solve(S.T @ left)
    spanned, left = orthonormal_span(left[:, : parameters.shape[1]]), left[:, -columns.shape[1] :]
    return np.asarray(left - spanned @ (spanned.T @ left))


def orthonormal_span(columns: Array) -> Array:
    """Orthonormal columns with the same span, to working precision."""
    # Unit columns first: the rank decision must not depend on the scale of a parameter.
    sized = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    u, values, _ = np.linalg.svd(sized, full_matrices=False)
    return np.asarray(u[:, values > np.sqrt(np.finfo(float).eps) * values.max(initial=0.0)])
