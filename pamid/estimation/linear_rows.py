"""A fit's least squares row by row: weighted residuals, joints between windows, the data sheet, and
their derivatives by the free parameters and the window starts.

A fit itself needs their sums alone (`pamid.estimation.multiple_shooting`, whose notation holds
here). The rows are wanted where several models are compared to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.lane_windows import moved_parameters, run_lanes
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights
from pamid.simulation.windows import Runner

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearRows:
    """away (m,): what a fit squares and adds up; by_parameters (m, free), in prior spreads;
    by_starts (m, window starts); channel (m,): of every residual, -1 for joints between windows and
    for the data sheet, whose `free` rows are the last."""

    away: Array
    by_parameters: Array
    by_starts: Array
    channel: NDArray[np.intp]

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.away).all() and np.isfinite(self.by_parameters).all())


def linear_rows(
    problem: Problem,
    p: Array,
    starts: tuple[Array, ...],
    weights: Weights,
    continuity: tuple[Array, ...],
    stepping: Stepping,
    most: int,
    *,
    derivatives: bool = True,
    known: tuple[KnownSlopes | None, ...] = (),
) -> LinearRows:
    """At parameters p (SI) and these starts; of residuals about `most` rows at most, evenly thinned
    and weighed up for those left out: neighbours of a finely sampled residual say the same.

    known: slopes along the tracks of a rig that is stepped, used where they hold;
    derivatives: without them those of the model are zero, and the runs cost a small part."""
    free, scale = list(problem.free), problem.scale
    k, columns = len(free), sum(x.size for x in starts)
    every = _thinning(problem, most)
    blocks, at = list[tuple[Array, Array]](), 0  # residuals, derivatives by everything
    channel = list[NDArray[np.intp]]()
    for i, (track, x, joint) in enumerate(zip(problem.tracks, starts, continuity, strict=True)):
        runner = Runner(problem.assembly, track, stepping, problem.free)
        runner = runner.keeping(known[i]) if known else runner
        own, windows, n = runner.parameters(p), problem.windows(track), runner.start_states
        root = np.where(track.seen, weights.root, 0.0)
        runs = runner.run_windows(runner.memory(own), windows, x, own, derivatives, root)
        for w, (window, run) in enumerate(zip(windows, runs, strict=True)):
            r = np.nan_to_num((run.Y - track.y[window.start : window.stop]) * root)
            r = np.sqrt(every) * r[::every].ravel()
            rows = np.zeros((len(r), k + columns))
            if derivatives:
                A = np.sqrt(every) * run.JY[::every].reshape(len(r), -1)
                rows[:, :k], rows[:, k + at : k + at + n] = A[:, :k], A[:, k : k + n]
            blocks.append((r, rows))
            channel.append(np.tile(np.arange(track.y.shape[1]), len(r) // track.y.shape[1]))
            if w + 1 < len(windows):
                inverse, rows = np.sqrt(joint), np.zeros((n, k + columns))
                end = inverse[:, None] * run.S[:, : k + n] if derivatives else np.zeros((n, k + n))
                rows[:, :k], rows[:, k + at : k + at + n] = -end[:, :k], -end[:, k:]
                rows[:, k + at + n : k + at + 2 * n] = np.diag(inverse)
                blocks.append((inverse * (x[w + 1] - run.end[:n]), rows))
                channel.append(np.full(n, -1))
            at += n
    sheet = np.eye(k, k + columns)
    away = np.concatenate([*(r for r, _ in blocks), scale.inside(p[free])])
    by = np.concatenate([rows for _, rows in blocks])
    by[:, :k] *= scale.slope(p[free])
    by = np.concatenate([by, sheet])
    channel.append(np.full(k, -1))
    return LinearRows(away, by[:, :k], by[:, k:], np.concatenate(channel))


def moved_rows(
    problem: Problem,
    p: Array,
    starts: tuple[Array, ...],
    weights: Weights,
    continuity: tuple[Array, ...],
    stepping: Stepping,
    most: int,
    moved: NDArray[np.intp],
) -> tuple[Array, Array]:
    """Rows of residuals and joints as in `linear_rows`, without those of the data sheet.

    moved: places, among the free parameters, of those to differentiate by. Returns the rows (m,)
    and their derivatives (m, moved) in prior spreads, as differences of runs side by side.
    """
    every, blocks = _thinning(problem, most), list[Array]()
    lanes, moves = moved_parameters(problem, p, moved)
    for track, x, joint in zip(problem.tracks, starts, continuity, strict=True):
        windows, n = problem.windows(track), x.shape[1]
        Y, ends = run_lanes(problem.assembly, track, windows, x, lanes, stepping)
        root = np.sqrt(every) * np.where(track.seen, weights.root, 0.0)
        away = np.nan_to_num((Y - track.y[:, :, None]) * root[:, None])
        jumps = np.sqrt(joint)[:, None] * (x[1:, :, None] - ends[:-1, :n])
        for w, window in enumerate(windows):
            blocks.append(away[window.start : window.stop : every].reshape(-1, lanes.shape[1]))
            blocks += [jumps[w]] if w + 1 < len(windows) else []
    rows = np.concatenate(blocks)
    return rows[:, 0], (rows[:, 1:] - rows[:, :1]) / moves


def _thinning(problem: Problem, most: int) -> int:
    """Of how many samples one is used, for about `most` rows."""
    return max(1, -(-sum(t.y.size for t in problem.tracks) // most))


def orthonormal_span(columns: Array) -> Array:
    """Orthonormal columns with the same span, to working precision."""
    sized = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    u, values, _ = np.linalg.svd(sized, full_matrices=False)
    return np.asarray(u[:, values > np.sqrt(np.finfo(float).eps) * values.max(initial=0.0)])
