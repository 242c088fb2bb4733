"""The windows of a fit by multiple shooting, simulated, and the normal equations that they add up
to (`pamid.estimation.multiple_shooting` says of what)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pamid.estimation.prior import terms_of_sheet
from pamid.estimation.problem import Problem, Scale
from pamid.estimation.weights import Weights
from pamid.simulation.windows import Runner

Array = NDArray[np.float64]
#: of a track's window starts: D (w,n,n), off (w-1,n,n), B (w,n,k), gx (w,n)
Blocks: TypeAlias = tuple[Array, Array, Array, Array]


class ShootingFit(Protocol):
    """What the windows have to know of a fit; as in `MultipleShooting`."""

    @property
    def problem(self) -> Problem: ...
    @property
    def p(self) -> Array: ...
    @property
    def weights(self) -> Weights: ...
    @property
    def continuity(self) -> tuple[Array, ...]: ...
    @property
    def runners(self) -> tuple[Runner, ...]: ...
    @property
    def scale(self) -> Scale: ...


@dataclass
class ShootingNormal:
    """Normal equations: parameters bordering a block-tridiagonal system of window starts."""

    cost: float
    H: Array
    g: Array
    blocks: list[Blocks]  # per track
    residuals: list[Array]
    fine: bool


class WindowRun(NamedTuple):
    """What a window adds, whatever continuity counts: its squared residuals, J'J and J'r by (scaled
    parameters, its start), d end / d of these, and by how far the next one's start is from its end.
    Without derivatives the matrices are empty."""

    cost: float
    N: Array
    v: Array
    end: Array
    jump: Array


class TrackRuns(NamedTuple):
    """The windows of a track in order, and its residuals (samples, channels)."""

    windows: list[WindowRun]
    residuals: Array


# where a model runs away, sums of its sensitivities may overflow: that is looked for at the end
@np.errstate(over="ignore", invalid="ignore")
def run_tracks(
    fitted: ShootingFit, s: Array, starts: tuple[Array, ...], derivatives: bool
) -> list[TrackRuns] | None:
    """Every window simulated at scaled parameters and window starts; None where the model runs
    away."""
    problem, scale, weights = fitted.problem, fitted.scale, fitted.weights
    k = len(problem.free)
    values = fitted.p.copy()
    values[list(problem.free)] = scale.outside(s)
    slope, root = scale.slope(values[list(problem.free)]), weights.root
    out: list[TrackRuns] = []
    nothing, at = np.zeros(0), 0
    for i, track in enumerate(problem.tracks):
        runner = fitted.runners[i]
        own = runner.parameters(values)
        windows, n = problem.windows(track), runner.start_states
        runs: list[WindowRun] = []
        whole, left = bool(track.seen.all()), np.empty_like(track.y)
        own_root = np.where(track.seen, root, 0.0)
        simulated = runner.run_windows(
            runner.memory(own), windows, starts[i], own, derivatives, own_root
        )
        for w, (window, run) in enumerate(zip(windows, simulated, strict=True)):
            if not run.fine:
                return None
            important = 1.0 if problem.importance is None else float(problem.importance[at + w])
            away = left[window.start : window.stop]
            np.subtract(run.Y, track.y[window.start : window.stop], out=away)
            r = (away * root if whole else np.nan_to_num(away * root)).ravel()
            joint = w + 1 < len(windows)
            jump = starts[i][w + 1] - run.end[:n] if joint else np.zeros(n)
            N = v = end = nothing
            if derivatives:
                # J'J and J'r of this window by (parameters in SI, its start); rows beyond k + n
                # are the padding of the sensitivities
                A = run.J
                N, v = important * (A.T @ A)[: k + n, : k + n], important * (A.T @ r)[: k + n]
                _scale(N, v, slope)
                if joint:
                    end = run.S[:, : k + n].copy()  # d end / d (parameters, start)
                    end[:, :k] *= slope
            runs.append(WindowRun(important * float(r @ r), N, v, end, jump))
        at += len(windows)
        out.append(TrackRuns(runs, left))
    return out


@np.errstate(over="ignore", invalid="ignore")
def assembled(
    fitted: ShootingFit, s: Array, tracks: list[TrackRuns] | None, derivatives: bool
) -> ShootingNormal:
    """Cost at scaled parameters and window starts, and with derivatives the normal equations, of
    what `run_tracks` has simulated there."""
    problem = fitted.problem
    k, n = len(problem.free), len(problem.assembly.rig.states)
    cost, H, g = (problem.prior.terms if problem.prior else terms_of_sheet)(s, problem.sheet)
    blocks: list[Blocks] = []
    if tracks is None:
        return ShootingNormal(np.inf, H, g, blocks, [], False)
    residuals = [track.residuals for track in tracks]
    for track, continuity in zip(tracks, fitted.continuity, strict=True):
        m = len(track.windows)
        D, off = np.zeros((m, n, n)), np.zeros((max(m - 1, 0), n, n))
        B, gx = np.zeros((m, n, k)), np.zeros((m, n))
        for w, run in enumerate(track.windows):
            cost += run.cost
            cost += float((run.jump**2 * continuity).sum())
            if not derivatives:
                continue
            N, v = run.N, run.v
            H += N[:k, :k]
            g += v[:k]
            D[w] += N[k:, k:]
            B[w] += N[k:, :k]
            gx[w] += v[k:]
            if w + 1 < m:
                _add_joint(w, run.end, run.jump, continuity, H, g, (D, off, B, gx))
        blocks.append((D, off, B, gx))
        if derivatives and not (
            np.isfinite(H).all() and np.isfinite(B).all() and np.isfinite(D).all()
        ):
            return ShootingNormal(np.inf, H, g, blocks, residuals, False)
    return ShootingNormal(cost, H, g, blocks, residuals, True)


def _scale(N: Array, v: Array, slope: Array) -> None:
    """Normal equations by parameters in SI become those by scaled ones, in place."""
    k = len(slope)
    N[:k] *= slope[:, None]
    N[:, :k] *= slope
    v[:k] *= slope


def _add_joint(
    w: int,
    end: Array,
    jump: Array,
    weight: Array,
    H: Array,
    g: Array,
    block: tuple[Array, Array, Array, Array],
) -> None:
    """Normal equations of |L (x_(w+1) - f_w(s, x_w))|^2; end: df_w / d(s, x_w); jump: x_(w+1) -
    f_w; weight: the diagonal of L'L."""
    D, off, B, gx = block
    k = len(g)
    P = weight[:, None]
    H += end[:, :k].T @ (P * end[:, :k])
    g -= end[:, :k].T @ (weight * jump)
    D[w] += end[:, k:].T @ (P * end[:, k:])
    B[w] += end[:, k:].T @ (P * end[:, :k])
    gx[w] -= end[:, k:].T @ (weight * jump)
    D[w + 1] += np.diag(weight)
    off[w] -= P * end[:, k:]
    B[w + 1] -= P * end[:, :k]
    gx[w + 1] += weight * jump
