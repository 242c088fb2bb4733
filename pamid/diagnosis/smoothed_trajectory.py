"""One track's path in slices: the states at the start of each, the data about them linearised, what
is known before.

The system over all slices is block-tridiagonal; the parameters border it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.engine.block_tridiagonal import eliminate
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner, Window, cut

Array = NDArray[np.float64]

SLICE_S = 0.1  # length of the slices over which a latent value is constant
# standard deviation of a state's jump between slices, in standard deviations of the state
STIFF = 1e-4
FREE = 1e3  # ... at most of its jump where a window begins


class Linear(NamedTuple):
    """The data about one track's path and the parameters, linearised: information of the parameters
    (k x k), of the states at the start of every slice (slices x n x n), between them (slices x n x
    k), their gradients, state at the end of the slice, its derivatives by start and parameters,
    squared error in noise variances."""

    H: Array
    D: Array
    B: Array
    g: Array
    gx: Array
    end: Array
    slope: Array
    lean: Array
    cost: float


class Followed(NamedTuple):
    """States at the end of every slice, squared error in noise variances."""

    end: Array
    cost: float


class Prior(NamedTuple):
    """What is known before: information of the joints between slices (slices-1 x n) and of the
    first value (n), decay of the states over a slice (n), log determinant of the latent values'
    part."""

    joint: Array
    first: Array
    decay: Array
    log_det: float


@dataclass(eq=False)
class Path:
    """States at the start of every slice of one track, and the data about them."""

    runner: Runner
    slices: list[Window]
    opens: NDArray[np.bool_]  # slices that begin a window: the rig's states may jump there
    x: Array  # slices x states

    def follow(self, p: Array, noise: Array) -> Followed:
        """Where the slices end, and their squared error; p: parameters (SI)."""
        values = self.runner.parameters(p)
        memory, end, cost = self.runner.memory(values), np.zeros_like(self.x), 0.0
        for i, window in enumerate(self.slices):
            self.runner.enter(memory, self.x[i])
            Y, _, fine = self.runner.run(memory, window, values, False)
            if not fine:
                return Followed(end, np.inf)
            cost += float(
                np.nansum(((Y - self.runner.track.y[window.start : window.stop]) / noise) ** 2)
            )
            end[i] = memory.x[: end.shape[1]]
        return Followed(end, cost)

    def linearise(self, p: Array, slope: Array, noise: Array, moving: bool) -> Linear:
        """p: parameters (SI); slope: theirs by prior spread; moving: derivatives by them, too?"""
        runner = self.runner if moving else replace(self.runner, free=())
        count, n, k = len(self.x), self.x.shape[1], len(slope)
        values, root, seen = runner.parameters(p), 1.0 / noise, runner.track.seen
        own_root = root if seen.all() else np.where(seen, root, 0.0)
        memory, first = runner.memory(values), 0 if moving else k
        D, B, S = np.zeros((count, n, n)), np.zeros((count, n, k)), np.zeros((count, n, k + n))
        gx, end, H, g, cost = (
            np.zeros((count, n)),
            np.zeros((count, n)),
            np.zeros((k, k)),
            np.zeros(k),
            0.0,
        )
        by = np.concatenate([slope, np.ones(n)])[first:]
        A = np.zeros((0, k + n))
        for i, window in enumerate(self.slices):
            runner.enter(memory, self.x[i])
            Y, J, fine = runner.run(memory, window, values, True, own_root)
            if not fine:
                return Linear(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], np.inf)
            r = ((Y - runner.track.y[window.start : window.stop]) * root).ravel()
            if not seen.all():
                r = np.nan_to_num(r)
            if len(A) != len(J):
                A = np.zeros((len(J), k + n))
            A[:, first:] = J[:, : len(by)] * by
            N, v = A.T @ A, A.T @ r
            H, g, D[i], B[i], gx[i], cost = (
                H + N[:k, :k],
                g + v[:k],
                N[k:, k:],
                N[k:, :k],
                v[k:],
                cost + float(r @ r),
            )
            end[i], S[i, :, first:] = memory.x[:n], memory.S[:n, : len(by)] * by
        return Linear(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], cost)

    def prior(self, missing: NDArray[np.intp], size: float, time_s: float) -> Prior:
        spread = np.maximum(self.x.std(axis=0), 1e-9 * np.abs(self.x).max(axis=0) + 1e-100)
        joint = np.tile(1.0 / (STIFF * spread) ** 2, (len(self.slices) - 1, 1))
        jump, free = self.runner.track.jump, FREE * spread
        free[: len(jump)] = np.minimum(free[: len(jump)], jump)
        joint[self.opens[1:]] = 1.0 / free**2
        length = (self.slices[0].stop - self.slices[0].start) * self.runner.track.period_s
        keep = float(np.exp(-length / time_s))
        first, decay = np.zeros(len(spread)), np.ones(len(spread))
        joint[:, missing], first[missing] = 1.0 / (size**2 * (1.0 - keep**2)), 1.0 / size**2
        decay[missing] = keep
        return Prior(
            joint,
            first,
            decay,
            float(np.log(joint[:, missing]).sum() + np.log(first[missing]).sum()),
        )

    def eliminated(
        self, one: Linear, prior: Prior, damping: float
    ) -> tuple[Array, Array, Array, Array, Array, float]:
        """What the track adds to the parameters' information and gradient once its states are
        eliminated, the states' gradient, the solutions for [B | gx], and the log determinant of the
        states' information against the prior's.

        The system is scaled to a unit diagonal: states in pascals and radians stand side by side.
        """
        joint, decay, n, k = prior.joint, prior.decay, self.x.shape[1], len(one.g)
        D, gx, B = one.D.copy(), one.gx.copy(), one.B.copy()
        jump = self.x[1:] - decay * one.end[:-1]
        A, P, pull = decay[:, None] * one.slope[:-1], decay[:, None] * one.lean[:-1], joint * jump
        off, weighed = -joint[:, :, None] * A, joint[:, :, None] * P
        D[:-1] -= np.matmul(A.transpose(0, 2, 1), off)
        D[1:, range(n), range(n)] += joint
        gx[:-1] -= np.einsum("kji,kj->ki", A, pull)
        gx[1:] += pull
        B[:-1] += np.matmul(A.transpose(0, 2, 1), weighed)
        B[1:] -= weighed
        H = one.H + P.reshape(-1, k).T @ weighed.reshape(-1, k)
        g = one.g - P.reshape(-1, k).T @ pull.ravel()
        D[0] += np.diag(prior.first)
        gx[0] += prior.first * self.x[0]
        scale = 1.0 / np.sqrt(np.einsum("kii->ki", D) + 1e-300)
        D *= scale[:, :, None] * scale[:, None, :]
        off *= scale[1:, :, None] * scale[:-1, None, :]
        z, log_det = eliminate(
            D, off, scale[:, :, None] * np.concatenate([B, gx[:, :, None]], axis=2), damping
        )
        z *= scale[:, :, None]
        X, x, flat = z[:, :, :k], z[:, :, k], B.reshape(-1, k).T
        return (
            H - flat @ X.reshape(-1, k),
            g - flat @ x.ravel(),
            gx,
            X,
            x,
            log_det - 2.0 * float(np.log(scale).sum()) - prior.log_det,
        )


def surprise(x: Array, linear: Followed | Linear, prior: Prior) -> float:
    """Squared distance of a path from what was known before."""
    jump = x[1:] - prior.decay * linear.end[:-1]
    return float((prior.joint * jump**2).sum() + (prior.first * x[0] ** 2).sum())


def slices_of(r: Replay) -> tuple[list[Window], NDArray[np.bool_]]:
    """Slices that do not straddle the replay's windows, and which of them begin one."""
    slices, opens = [], []
    length = max(4, round(SLICE_S / r.track.period_s))
    for w in r.windows:
        for k, s in enumerate(cut(w.stop - w.start, length)):
            slices.append(Window(w.start + s.start, w.start + s.stop))
            opens.append(k == 0)
    return slices, np.array(opens)


def start_path(
    runner: Runner, values: Array, r: Replay, slices: list[Window], opens: NDArray[np.bool_]
) -> Array:
    """States at the start of every slice along the replay, latent values zero."""
    values = runner.parameters(values)
    memory = runner.memory(values)
    narrow = Runner(runner.assembly, r.track, runner.stepping)
    starts = iter(r.entered)
    out = np.zeros((len(slices), len(memory.x)))
    for k, window in enumerate(slices):
        if opens[k]:
            narrow.enter(memory, next(starts))
        out[k] = memory.x
        narrow.run(memory, window, values, False)
        if not np.isfinite(memory.x).all():
            memory = runner.memory(values)
    return out
