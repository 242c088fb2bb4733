"""The windows of a fit by multiple shooting, simulated, and the normal equations that they add up
to (see `pamid.estimation.multiple_shooting`)."""

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
    """Parts of a fit that its windows need; as in `MultipleShooting`."""

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


class WindowSums(NamedTuple):
    """Sums over the windows of a track, before they are joined.

    cost: squared residuals; N (windows, unknowns, unknowns) and v (windows, unknowns): J'J and J'r
    by (scaled parameters, window start); ends (windows, states, unknowns): derivatives of the end
    states; jumps (windows - 1, states): from the end of each window to the next start; residuals
    (samples, channels) in SI. Without derivatives N, v and ends are empty.
    """

    cost: float
    N: Array
    v: Array
    ends: Array
    jumps: Array
    residuals: Array


# where a model runs away, sums of its sensitivities may overflow: that is looked for at the end
@np.errstate(over="ignore", invalid="ignore")
def run_tracks(
    fitted: ShootingFit, s: Array, starts: tuple[Array, ...], derivatives: bool
) -> list[WindowSums] | None:
    """Every window simulated at scaled parameters and window starts; None where the model runs
    away."""
    problem, scale, weights = fitted.problem, fitted.scale, fitted.weights
    k = len(problem.free)
    values = fitted.p.copy()
    values[list(problem.free)] = scale.outside(s)
    slope, root = scale.slope(values[list(problem.free)]), weights.root
    out: list[WindowSums] = []
    at = 0
    for i, track in enumerate(problem.tracks):
        runner = fitted.runners[i]
        track_values = runner.parameters(values)
        windows, n = problem.windows(track), runner.start_states
        count, unknowns, cost = len(windows), (k + n) * derivatives, 0.0
        N, v = np.empty((count, unknowns, unknowns)), np.empty((count, unknowns))
        end, ends = np.empty((count, n)), np.empty((count, n, unknowns))
        whole, left = bool(track.seen.all()), np.empty_like(track.y)
        seen_root = np.where(track.seen, root, 0.0)
        simulated = runner.run_windows(
            runner.memory(track_values), windows, starts[i], track_values, derivatives, seen_root
        )
        for w, (window, run) in enumerate(zip(windows, simulated, strict=True)):
            # One window that runs away makes the cost infinite, so that the damping rule rejects
            # the step as a whole.
            if not run.fine:
                return None
            important = 1.0 if problem.importance is None else float(problem.importance[at + w])
            away = left[window.start : window.stop]
            np.subtract(run.Y, track.y[window.start : window.stop], out=away)
            r = (away * root if whole else np.nan_to_num(away * root)).ravel()
            cost += important * float(r @ r)
            end[w] = run.end[:n]
            if derivatives:
                # rows beyond the unknowns are the padding of the sensitivities
                A = run.J
                N[w] = important * (A.T @ A)[:unknowns, :unknowns]
                v[w] = important * (A.T @ r)[:unknowns]
                ends[w] = run.S[:, :unknowns]
        # Scaling after the products costs one multiplication per entry of the sums, not one per
        # sample.
        if derivatives:  # by scaled parameters, not by those in SI
            N[:, :k] *= slope[:, None]
            N[:, :, :k] *= slope
            v[:, :k] *= slope
            ends[:, :, :k] *= slope
        at += count
        out.append(WindowSums(cost, N, v, ends, starts[i][1:] - end[:-1], left))
    return out


@np.errstate(over="ignore", invalid="ignore")
def assembled(
    fitted: ShootingFit, s: Array, tracks: list[WindowSums] | None, derivatives: bool
) -> ShootingNormal:
    """Cost at scaled parameters and window starts, and with derivatives the normal equations, of
    the windows simulated there."""
    problem = fitted.problem
    cost, H, g = (problem.prior.terms if problem.prior else terms_of_sheet)(s, problem.sheet)
    blocks: list[Blocks] = []
    if tracks is None:
        return ShootingNormal(np.inf, H, g, blocks, [], False)
    residuals = [sums.residuals for sums in tracks]
    fine = True
    for sums, weight in zip(tracks, fitted.continuity, strict=True):
        cost += sums.cost + float((sums.jumps**2 * weight).sum())
        if derivatives:
            blocks.append(_joined(sums, weight, H, g))
            D, _, B, _ = blocks[-1]
            fine = fine and bool(np.isfinite(B).all() and np.isfinite(D).all())
    fine = fine and bool(np.isfinite(cost) and np.isfinite(H).all())
    return ShootingNormal(cost if fine else np.inf, H, g, blocks, residuals, fine)


def _joined(sums: WindowSums, weight: Array, H: Array, g: Array) -> Blocks:
    """Blocks of the window starts with the joints |L (x_(w+1) - f_w(s, x_w))|^2; the part of the
    parameters is added to H and g in place. weight: the diagonal of L'L."""
    k, n = len(g), sums.ends.shape[1]
    D, B, gx = sums.N[:, k:, k:].copy(), sums.N[:, k:, :k].copy(), sums.v[:, k:].copy()
    by_s, by_x = sums.ends[:-1, :, :k], sums.ends[:-1, :, k:]
    P, pulled, turned = weight[:, None], weight * sums.jumps, by_x.transpose(0, 2, 1)
    H += sums.N[:, :k, :k].sum(axis=0) + (by_s.transpose(0, 2, 1) @ (P * by_s)).sum(axis=0)
    g += sums.v[:, :k].sum(axis=0) - np.einsum("wnk,wn->k", by_s, pulled)
    D[:-1] += turned @ (P * by_x)
    B[:-1] += turned @ (P * by_s)
    gx[:-1] -= np.einsum("wnm,wn->wm", by_x, pulled)
    D[1:, range(n), range(n)] += weight
    B[1:] -= P * by_s
    gx[1:] += pulled
    return D, -P * by_x, B, gx
