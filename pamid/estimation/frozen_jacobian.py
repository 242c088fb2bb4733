"""Multiple shooting with a frozen Jacobian: chord steps for a model on top of a fitted model.

A candidate adds a few parameters to a fitted model. The derivatives of the fitted model's residuals
by its parameters, J_b, are computed once and serve every candidate. Those by the candidate's
parameters and by the window starts, C = [J_e J_x], are differences of runs side by side
(`LaneProgram`): a run at the point itself, another for each moved value. With residuals r the
normal equations of a window are

    N = [ J_b'J_b  J_b'C ]      v = [ J_b'r ]
        [ C'J_b    C'C   ]          [ C'r   ]

and everything else (priors, joints between windows, bounds, damping) is as in
`pamid.estimation.multiple_shooting`. The cost of a point is that of a real run, so that an outdated
J_b costs steps and never pretends a gain. Chord method: Ortega and Rheinboldt (1970), Iterative
Solution of Nonlinear Equations in Several Variables, section 7.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.damped_gauss_newton import Iteration
from pamid.engine.program import Stepping
from pamid.estimation.lane_windows import MOVE, moved_parameters, run_lanes
from pamid.estimation.multiple_shooting import (
    TOLERANCE,
    MultipleShooting,
    ShootingPoint,
    WindowSums,
    reduced,
)
from pamid.estimation.problem import FitStart, Problem
from pamid.estimation.weights import Weights
from pamid.simulation.windows import Window


def padded_rows(windows: list[Window], values: Array) -> Array:
    """Values (samples, channels, ...) of a track as rows of equal length (windows, samples x
    channels, ...), those of shorter windows padded with zeros."""
    first = np.array([w.start for w in windows])[:, None]
    length = np.array([w.stop - w.start for w in windows])[:, None]
    offsets = np.arange(length.max())
    inside = offsets < length
    out = values[np.where(inside, first + offsets, first)]
    out[~inside] = 0.0
    # No length is left to be inferred: a rig without free parameters has an empty last axis.
    return out.reshape(len(windows), offsets.size * values.shape[1], *values.shape[2:])


@dataclass(frozen=True, eq=False)
class FrozenTrack:
    """J_b of a track, by parameters in SI: turned (windows, parameters, samples x channels), its
    transpose, weighted; gram (windows, parameters, parameters) J_b'J_b; ends (windows, states,
    parameters), of the rig's states at the end of each window."""

    turned: Array
    gram: Array
    ends: Array

    @classmethod
    def of(cls, windows: list[Window], by_parameters: Array, ends: Array) -> FrozenTrack:
        """by_parameters: (samples, channels, parameters), weighted."""
        rows = padded_rows(windows, by_parameters)
        # Every chord step multiplies by this matrix, and a transposed view would be copied each
        # time.
        turned = np.ascontiguousarray(rows.transpose(0, 2, 1))
        return cls(turned, turned @ rows, ends)


@dataclass(frozen=True, eq=False)
class FrozenJacobian:
    """J_b of a fitted model. keys: of its free parameters, in the order of the columns."""

    keys: tuple[str, ...]
    tracks: tuple[FrozenTrack, ...]

    @classmethod
    def of(
        cls,
        problem: Problem,
        p: Array,
        starts: tuple[Array, ...],
        weights: Weights,
        stepping: Stepping,
    ) -> FrozenJacobian:
        """Linearise the residuals at parameters p (SI) and these window starts, by differences of
        runs side by side."""
        free, scale = list(problem.free), problem.scale
        keys = tuple(problem.assembly.parameters[i].key for i in free)
        lanes, moves = moved_parameters(problem, p, np.arange(len(free)))
        by_si = moves * scale.slope(p[free])
        tracks = []
        for track, entered in zip(problem.tracks, starts, strict=True):
            windows, n = problem.windows(track), entered.shape[1]
            Y, ends = run_lanes(problem.assembly, track, windows, entered, lanes, stepping)
            root = np.where(track.seen, weights.root, 0.0)
            by_parameters = (Y[:, :, 1:] - Y[:, :, :1]) * (root[:, None] / by_si)
            by_ends = (ends[:, :n, 1:] - ends[:, :n, :1]) / by_si
            tracks.append(FrozenTrack.of(windows, by_parameters, by_ends))
        return cls(keys, tuple(tracks))

    def of_shared(self, problem: Problem) -> FrozenJacobian:
        """The columns of the parameters that a problem shares, in its order."""
        keys = tuple(problem.assembly.parameters[i].key for i in problem.free)
        shared = tuple(key for key in keys if key in self.keys)
        # The usual case; a selection by index would copy all columns.
        if shared == self.keys:
            return self
        at = np.array([self.keys.index(key) for key in shared], np.intp)
        tracks = (
            FrozenTrack(t.turned[:, at], t.gram[:, at[:, None], at], t.ends[:, :, at])
            for t in self.tracks
        )
        return FrozenJacobian(shared, tuple(tracks))


@dataclass(frozen=True, eq=False)
class ChordShooting(MultipleShooting):
    """The least squares of a fit whose Jacobian is frozen for the parameters of the model below.
    moves: per track, the differences by which the states of window starts are moved."""

    frozen: FrozenJacobian
    moves: tuple[Array, ...]

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Places, among the free parameters, of those with a column in `frozen` and of the rest."""
        bounds = self.problem.assembly.parameters
        shared = np.array([bounds[i].key in self.frozen.keys for i in self.problem.free], bool)
        return np.flatnonzero(shared), np.flatnonzero(~shared)

    def at(self, s: Array, starts: tuple[Array, ...], derivatives: bool = True) -> ShootingPoint:
        """The point with its normal equations, which cost nothing beyond the run."""
        sums = [self._track_sums(i, s, entered) for i, entered in enumerate(starts)]
        return ShootingPoint(s, starts, self.assembled(s, sums, True), True)

    @property
    def differentiates_at_once(self) -> bool:
        return True

    def predicted_cost(self, at: ShootingPoint) -> float:
        """The cost that the linearised model expects behind a single undamped step."""
        step = self.step(at, 0.0)
        H, g, _, parts = reduced(at.normal, at.s, self.scale, 0.0)
        by_starts = sum(
            float(x.ravel() @ block[3].ravel())
            for (_, x), block in zip(parts, at.normal.blocks, strict=True)
        )
        return float(at.cost - by_starts + 2.0 * g @ step.s + step.s @ H @ step.s)

    # a model that runs away overflows in its sums: these are looked at afterwards
    @np.errstate(over="ignore", invalid="ignore")
    def _track_sums(self, i: int, s: Array, entered: Array) -> WindowSums:
        """A track run at scaled parameters and states of its window starts (windows, states)."""
        problem, frozen = self.problem, self.frozen.tracks[i]
        track, free = problem.tracks[i], list(problem.free)
        windows, (count, n), k = problem.windows(track), entered.shape, len(s)
        shared, added = self.places
        # lane 0 is the point; then follows a lane per candidate parameter and per state of the
        # starts
        first, lanes = 1 + len(added), 1 + len(added) + n
        values = self.p.copy()
        values[free] = self.scale.outside(s)
        p, added_moves = moved_parameters(problem, values, added)
        p = np.concatenate([p, np.repeat(p[:, :1], n, 1)], 1)
        moves = np.concatenate([added_moves, self.moves[i]])
        x = np.repeat(entered[:, :, None], lanes, 2)
        x[:, range(n), range(first, lanes)] += moves[len(added) :]
        Y, ends = run_lanes(problem.assembly, track, windows, x, p, self.stepping, first)
        root = np.where(track.seen, self.weights.root, 0.0)
        left = Y[:, :, 0] - track.y
        # C, and the residuals as a further column
        columns = np.empty((*left.shape, lanes))
        columns[:, :, :-1] = (Y[:, :, 1:] - Y[:, :, :1]) * (root[:, None] / moves)
        columns[:, :, -1] = np.nan_to_num(left * root)
        columns = padded_rows(windows, columns)
        cross, inner = frozen.turned @ columns, columns.transpose(0, 2, 1) @ columns
        slope, m = self.scale.slope(p[free, 0])[shared], len(shared)
        cross *= slope[:, None]
        N, v = np.empty((count, k + n, k + n)), np.empty((count, k + n))
        by = np.empty((count, n, k + n))
        N[:, :m, :m] = slope[:, None] * frozen.gram * slope
        N[:, :m, m:], N[:, m:, :m] = cross[:, :, :-1], cross[:, :, :-1].transpose(0, 2, 1)
        N[:, m:, m:] = inner[:, :-1, :-1]
        v[:, :m], v[:, m:] = cross[:, :, -1], inner[:, :-1, -1]
        by[:, :, :m] = frozen.ends * slope
        by[:, :, m:] = (ends[:, :n, 1:] - ends[:, :n, :1]) / moves
        # from the order shared parameters, candidate parameters, start states
        place = np.concatenate([shared, added, k + np.arange(n)])
        back = np.argsort(place)
        return WindowSums(
            float(inner[:, -1, -1].sum()),
            N[:, back[:, None], back],
            v[:, back],
            by[:, :, back],
            entered[1:] - ends[:-1, :n, 0],
            left,
        )


def begin_chords(
    problem: Problem,
    frozen: FrozenJacobian,
    start: FitStart,
) -> tuple[ChordShooting, Iteration[ShootingPoint]]:
    """The least squares of a fit by chord steps, and the point where it begins.

    problem: of a model with the parameters of `frozen` and more, over the same tracks; start: with
    parameters, states, weights and stepping.
    """
    p, starts, weights, stepping = start.p, start.starts, start.weights, start.stepping
    assert p is not None and starts is not None and weights is not None and stepping is not None
    moves = []
    for entered in starts:
        # The spread over the windows is the only scale of a state that needs no knowledge of its
        # unit. A state that starts every window at the same value moves by its size, at zero by
        # 1 (SI).
        size = entered.std(axis=0)
        size = np.where(size > 0.0, size, np.abs(entered).max(axis=0))
        moves.append(MOVE * np.where(size > 0.0, size, 1.0))
    shared = frozen.of_shared(problem)
    shooting = ChordShooting(
        problem, p, weights, start.continuity, stepping, (), TOLERANCE, True, shared, tuple(moves)
    )
    scale = problem.scale
    s = np.clip(scale.inside(p[list(problem.free)]), scale.low, scale.high)
    return shooting, Iteration(shooting.at(s, starts), shooting.rule.start)
