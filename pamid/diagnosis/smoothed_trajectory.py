"""One track's trajectory in slices: the states at the start of each, the data linearised about
them, and their prior.

With x_i the states at the start of slice i and f(x_i) those at its end, a first-order Gauss-Markov
prior links neighbours: x_(i+1) = a f(x_i) + w_i, w_i ~ N(0, Q_i), with a = exp(-length / time
constant) and Q = size^2 (1 - a^2) for a latent value (the exact discretisation of an
Ornstein-Uhlenbeck process) and a = 1 with a very small Q for the other states. The normal equations
over all slices are therefore block-tridiagonal; the parameters border them. Eliminating the states
is the Rauch-Tung-Striebel smoother of the linearised model: Bell (1994), SIAM J. Optim. 4(3);
Särkkä (2013), Bayesian Filtering and Smoothing, ch. 10 and 13.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.engine.block_tridiagonal import eliminate
from pamid.engine.known_slopes import KnownSlopes
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner, Window, cut

Array = NDArray[np.float64]

# a latent value is constant over a slice: correlation times, and samples at least
SLICE, SLICE_SAMPLES = 0.16, 4
# standard deviations of a state other than a latent value that it may jump by: between slices a
# stand-in for zero with which blocks are invertible, where a window begins one for no bound
STIFFNESS, WINDOW_JUMP = 1e-4, 1e3


class Linearisation(NamedTuple):
    """The data of one track, linearised about a trajectory and the parameters: information of the
    parameters (k x k), of the states at the start of every slice (slices x n x n), between them
    (slices x n x k), their gradients, state at the end of every slice, its derivatives by the state
    at the start (slices x n x n) and by the parameters (slices x n x k), squared error in noise
    variances."""

    H: Array
    D: Array
    B: Array
    g: Array
    gx: Array
    end: Array
    by_start: Array
    by_parameters: Array
    cost: float


class Simulation(NamedTuple):
    """States at the end of every slice, squared error in noise variances."""

    end: Array
    cost: float


class TrajectoryPrior(NamedTuple):
    """What is known of a trajectory before its data: information of the joints between slices
    (slices-1 x n) and of the first value (n), decay of the states over a slice (n), log determinant
    of the latent values' part."""

    joint: Array
    first: Array
    decay: Array
    log_det: float


@dataclass(frozen=True, eq=False)
class SlicedTrack:
    """One track in slices. A trajectory x of it: the states at the start of every slice (slices x
    states)."""

    runner: Runner
    slices: list[Window]
    opens: NDArray[np.bool_]  # slices that begin a window: the rig's states may jump there
    start: Array  # the trajectory that smoothing begins with
    known: tuple[KnownSlopes | None, ...] = (None, None)  # as `slopes_along`

    @cached_property
    def keeping(self) -> tuple[Runner, Runner]:
        """The runner by the states alone, and by the parameters, too; what steps by itself keeps
        slopes from one linearisation to the next."""
        still, moving = self.known
        return replace(self.runner, free=()).keeping(still), self.runner.keeping(moving)

    def simulate(self, x: Array, p: Array, noise: Array, moving: bool) -> Simulation:
        """Where the slices end, and their squared error; p: parameters (SI); moving: are they
        improved, too?"""
        runner = self.keeping[moving]
        values = runner.parameters(p)
        end, cost, whole = np.zeros_like(x), 0.0, bool(runner.track.seen.all())
        runs = runner.run_windows(runner.memory(values), self.slices, x, values, False)
        for i, (window, run) in enumerate(zip(self.slices, runs, strict=True)):
            if not run.fine:
                return Simulation(end, np.inf)
            squares = ((run.Y - runner.track.y[window.start : window.stop]) / noise) ** 2
            cost += float(squares.sum() if whole else np.nansum(squares))
            end[i] = run.end[: end.shape[1]]
        return Simulation(end, cost)

    def linearise(
        self, x: Array, p: Array, slope: Array, noise: Array, moving: bool
    ) -> Linearisation:
        """p: parameters (SI); slope: theirs by prior spread; moving: derivatives by them, too?"""
        runner = self.keeping[moving]
        count, n, k = len(x), x.shape[1], len(slope)
        values, root, seen = runner.parameters(p), 1.0 / noise, runner.track.seen
        own_root = root if seen.all() else np.where(seen, root, 0.0)
        first = 0 if moving else k
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
        runs = runner.run_windows(runner.memory(values), self.slices, x, values, True, own_root)
        for i, (window, run) in enumerate(zip(self.slices, runs, strict=True)):
            if not run.fine:
                return Linearisation(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], np.inf)
            J = run.J
            r = ((run.Y - runner.track.y[window.start : window.stop]) * root).ravel()
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
            end[i], S[i, :, first:] = run.end[:n], run.S[:, : len(by)] * by
        return Linearisation(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], cost)

    def prior(
        self, x: Array, missing: NDArray[np.intp], size: float, time_s: float
    ) -> TrajectoryPrior:
        """missing: places of the latent values among the states; size, time_s: theirs."""
        spread = np.maximum(x.std(axis=0), 1e-9 * np.abs(x).max(axis=0) + 1e-100)
        joint = np.tile(1.0 / (STIFFNESS * spread) ** 2, (len(self.slices) - 1, 1))
        jump, free = self.runner.track.jump, WINDOW_JUMP * spread
        free[: len(jump)] = np.minimum(free[: len(jump)], jump)
        joint[self.opens[1:]] = 1.0 / free**2
        length = (self.slices[0].stop - self.slices[0].start) * self.runner.track.period_s
        keep = float(np.exp(-length / time_s))
        first, decay = np.zeros(len(spread)), np.ones(len(spread))
        # the latent values last: they wander on where windows begin, too, and their process is
        # stationary, of variance size^2 from the first slice on
        joint[:, missing], first[missing] = 1.0 / (size**2 * (1.0 - keep**2)), 1.0 / size**2
        decay[missing] = keep
        return TrajectoryPrior(
            joint,
            first,
            decay,
            float(np.log(joint[:, missing]).sum() + np.log(first[missing]).sum()),
        )

    def eliminated(
        self, x: Array, one: Linearisation, prior: TrajectoryPrior, damping: float
    ) -> tuple[Array, Array, Array, Array, Array, float]:
        """What the track adds to the parameters' information and gradient once its states are
        eliminated, the states' gradient, the solutions for [B | gx], and the log determinant of the
        states' information against the prior's.

        The system is scaled to a unit diagonal: states in pascals and radians stand side by side.
        """
        joint, decay, n, k = prior.joint, prior.decay, x.shape[1], len(one.g)
        D, gx, B = one.D.copy(), one.gx.copy(), one.B.copy()
        # |x_(i+1) - a f(x_i, s)|^2 in Q^-1: its derivatives are 1 by x_(i+1), -A by x_i, -P by s
        jump = x[1:] - decay * one.end[:-1]
        A, P = decay[:, None] * one.by_start[:-1], decay[:, None] * one.by_parameters[:-1]
        weighed_jump = joint * jump
        off, weighed = -joint[:, :, None] * A, joint[:, :, None] * P
        D[:-1] -= np.matmul(A.transpose(0, 2, 1), off)
        D[1:, range(n), range(n)] += joint
        gx[:-1] -= np.einsum("kji,kj->ki", A, weighed_jump)
        gx[1:] += weighed_jump
        B[:-1] += np.matmul(A.transpose(0, 2, 1), weighed)
        B[1:] -= weighed
        # rows by number: there may be no parameters, and then no columns
        joints, rows = weighed_jump.size, gx.size
        flat_P = P.reshape(joints, k)
        H = one.H + flat_P.T @ weighed.reshape(joints, k)
        g = one.g - flat_P.T @ weighed_jump.ravel()
        D[0] += np.diag(prior.first)
        gx[0] += prior.first * x[0]
        scale = 1.0 / np.sqrt(np.einsum("kii->ki", D) + 1e-300)
        D *= scale[:, :, None] * scale[:, None, :]
        off *= scale[1:, :, None] * scale[:-1, None, :]
        z, log_det = eliminate(
            D, off, scale[:, :, None] * np.concatenate([B, gx[:, :, None]], axis=2), damping
        )
        z *= scale[:, :, None]
        X, dx, flat = z[:, :, :k], z[:, :, k], B.reshape(rows, k).T
        return (
            H - flat @ X.reshape(rows, k),
            g - flat @ dx.ravel(),
            gx,
            X,
            dx,
            log_det - 2.0 * float(np.log(scale).sum()) - prior.log_det,
        )


def prior_cost(x: Array, run: Simulation | Linearisation, prior: TrajectoryPrior) -> float:
    """Squared distance of a trajectory from its prior, in the prior's variances."""
    jump = x[1:] - prior.decay * run.end[:-1]
    return float((prior.joint * jump**2).sum() + (prior.first * x[0] ** 2).sum())


def slices_of(r: Replay) -> tuple[list[Window], NDArray[np.bool_]]:
    """Slices that do not straddle the replay's windows, and which of them begin one."""
    slices, opens = [], []
    length = max(SLICE_SAMPLES, round(SLICE * r.track.timescale_s / r.track.period_s))
    for w in r.windows:
        for k, s in enumerate(cut(w.stop - w.start, length)):
            slices.append(Window(w.start + s.start, w.start + s.stop))
            opens.append(k == 0)
    return slices, np.array(opens)


def start_trajectory(
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
