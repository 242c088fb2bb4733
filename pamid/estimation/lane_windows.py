"""Windows of a track run for several hypotheses side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.estimation.problem import Problem
from pamid.model.assembly import Assembly
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

MOVE = 1e-5  # of a prior spread, or of a state's standard deviation over the window starts


def moved_parameters(problem: Problem, p: Array, moved: NDArray[np.intp]) -> tuple[Array, Array]:
    """Parameters p (SI) in lane 0, and with a value moved in each of the others.

    moved: places among the free parameters. Returns parameters (parameters, 1 + moved) and the
    differences (moved,) in prior spreads, away from the upper bound.
    """
    free, scale = list(problem.free), problem.scale
    s = np.clip(scale.inside(p[free]), scale.low, scale.high)
    # A parameter at its upper bound is moved inwards, where the model is defined.
    moves = np.where(s[moved] + MOVE > scale.high[moved], -MOVE, MOVE)
    scaled = np.repeat(s[:, None], 1 + len(moved), 1)
    scaled[moved, range(1, 1 + len(moved))] += moves
    lanes = np.repeat(p[:, None], 1 + len(moved), 1)
    lanes[free] = np.stack([scale.outside(column) for column in scaled.T], 1)
    return lanes, moves


def run_lanes(
    assembly: Assembly,
    track: Track,
    windows: list[Window],
    entered: Array,
    p: Array,
    stepping: Stepping,
    dependent: int | None = None,
) -> tuple[Array, Array]:
    """Run a model of equations over the windows of a track in all lanes.

    entered: (windows, states, lanes) or, for all lanes, (windows, states): the rig's states at
    window starts. p: (parameters, lanes), SI; known values of the recording replace them.
    dependent: first of the lanes that differ from lane 0 by the start of a single window. Returns
    outputs (samples, channels, lanes) and states at the end of each window (windows, states,
    lanes). A lane that runs away equals lane 0, so that its difference is zero.
    """
    program, lanes = assembly.lane_program, p.shape[1]
    p = p.copy()
    p[list(track.known)] = track.p[list(track.known), None]
    if entered.ndim < 3:
        entered = np.repeat(entered[:, :, None], lanes, 2)
    # windows set the rig's states, and effects remember nothing at first
    fresh = np.zeros((len(program.states), lanes))
    Y, ends, _ = program.run_windows(
        program.memory(fresh, stepping=stepping, period_s=track.period_s),
        track.inputs,
        p,
        np.array([*(w.start for w in windows), windows[-1].stop]),
        entered,
        stepping=stepping,
        dependent=dependent,
    )
    if not (np.isfinite(Y).all() and np.isfinite(ends).all()):
        lost = ~(np.isfinite(Y).all(axis=(0, 1)) & np.isfinite(ends).all(axis=(0, 1)))
        Y[:, :, lost], ends[:, :, lost] = Y[:, :, :1], ends[:, :, :1]
    return Y, ends
