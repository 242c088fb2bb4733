"""A model with latent values at some of its ports, smoothed together with its states over held-out recordings.

At every place of a port an unknown value is added that wanders as an Ornstein-Uhlenbeck process (a Matern-1/2 Gaussian
process in time). States, value and the model's parameters, within what the fit knows of them, are found together, slice
by slice, by Gauss-Newton on a block-tridiagonal system that the parameters border: the Kalman smoother of the
linearised model, with its Laplace evidence. The parameters move, too, because those of the fit have already bent to
what is missing. After Rogers and Friis (2022), Vibration 3; Engelhardt, Froehlich and Kschischo (2016), Sci. Rep. 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.attaching import Attachment
from pamid.diagnosis.contest import Contender, transferred
from pamid.effect import Effect, State
from pamid.engine.blocks import eliminate
from pamid.equations import Expr, Number
from pamid.evidence import Evidence
from pamid.fitting import Scale
from pamid.residuals import Replay
from pamid.windows import Runner, Window, cut

Array = NDArray[np.float64]

SLICE_S = 0.1               # length of the slices over which the value is constant
ROUNDS = 20                 # Gauss-Newton steps at most, damped as the ground demands
CALM = 1e-3                 # of the cost: a gain below it ends them
TRUSTED = 0.1               # of the cost: what a step that was not taken may promise
LEAST_DAMPING = 1e-10       # of a diagonal scaled to one
STIFF = 1e-4                # standard deviation of a state's jump between slices, in standard deviations of the state
FREE = 1e3                  # ... of its jump where a window begins
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)   # standard deviations tried, in sizes of the port's value
TIMES_S = (0.1, 1.0)        # time constants tried


class Latent(Effect):
    """A value that is simply missing: it wanders and is not explained. Sizes are those of the port's value."""

    name = "latent"
    family = "latent"
    kinds = ()
    states = (State("missing"),)

    def __init__(self, size: float) -> None:
        self.size = size

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        return value + self.size * z.missing, {"missing": 0.0}


class _Linear(NamedTuple):
    """The data about one track's path and the parameters, linearised: information of the parameters (k x k), of the
    states at the start of every slice (slices x n x n), between them (slices x n x k), their gradients, state at the
    end of the slice, its derivatives by start and parameters, squared error in noise variances."""

    H: Array
    D: Array
    B: Array
    g: Array
    gx: Array
    end: Array
    slope: Array
    lean: Array
    cost: float


class _Followed(NamedTuple):
    """States at the end of every slice, squared error in noise variances."""

    end: Array
    cost: float


class _Prior(NamedTuple):
    """What is known before: information of the joints between slices (slices-1 x n) and of the first value (n), decay
    of the states over a slice (n), log determinant of the latent values' part."""

    joint: Array
    first: Array
    decay: Array
    log_det: float


class _Step(NamedTuple):
    """Of the parameters (in prior spreads) and of every track's states; what it promises to gain; log determinant of
    the information against the priors'."""

    s: Array
    x: list[Array]
    gain: float
    log_det: float


@dataclass(eq=False)
class Smoother:
    """The model of `base` with latent values at `ports`, linearised about its best path over the held-out replays."""

    evidence: Evidence
    base: Contender
    ports: tuple[str, ...]
    linear: list[_Linear] | None = None
    moved: bool = False                 # was it linearised by the parameters, too?

    @cached_property
    def assembly(self) -> Assembly:
        b, rig = self.base.assembly, self.evidence.rig
        added = tuple(Attachment(Latent(size_at(b, port)), (port,), f"latent.{i}") for i, port in
                      enumerate(self.ports))
        return Assembly(rig, (*b.attachments, *added), background=True, sizes=b.sizes, outputs=b.outputs).for_fitting()

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Places of the parameters that move."""
        b = self.base.assembly
        return tuple(self.assembly.keys[b.parameters[i].key] for i in self.base.fit.problem.free)

    @cached_property
    def scale(self) -> Scale:
        free = list(self.free)
        return Scale([self.assembly.parameters[i] for i in free], self.assembly.values()[free])

    @cached_property
    def fitted(self) -> Array:
        """The parameters of the fit in prior spreads."""
        known = transferred(self.assembly, self.base.assembly, self.base.fit.p)[list(self.free)]
        return np.clip(self.scale.inside(known), self.scale.low, self.scale.high)

    @cached_property
    def known(self) -> Array:
        """What the fit knows of them, as information: little where what it left is large."""
        found: Array = np.linalg.pinv(self.base.fit.covariance, hermitian=True).astype(np.float64, copy=False)
        return found

    @cached_property
    def s(self) -> Array:
        """The parameters in prior spreads."""
        return self.fitted.copy()

    def parameters(self, s: Array) -> Array:
        p = transferred(self.assembly, self.base.assembly, self.base.fit.p)
        p[list(self.free)] = self.scale.outside(s)
        return p

    @cached_property
    def missing(self) -> NDArray[np.intp]:
        """Places of the latent values among the states."""
        return np.flatnonzero([s.endswith(".missing") for s in self.assembly.program.states])

    @cached_property
    def paths(self) -> tuple[Path, ...]:
        return tuple(self._path(i, r) for i, r in enumerate(self.base.replays))

    def _path(self, i: int, r: Replay) -> Path:
        runner = Runner(self.assembly, r.track, self.base.fit.stepping, self.free, whole=True)
        slices, opens = _slices(r)
        return Path(runner, slices, opens, _start_path(runner, self.parameters(self.s), r, slices, opens))

    @cached_property
    def best(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant): the most likely size and time constant of a coarse grid."""
        if not self.ports:
            self.evidence_at(1.0, 1.0, ROUNDS, moving=False)
            return self.evidence_at(1.0, 1.0, ROUNDS), 1.0, 1.0
        size = max((self.evidence_at(s, TIMES_S[0], trusted=1.0, moving=False), s) for s in SIZES)[1]
        self.evidence_at(size, TIMES_S[0], ROUNDS, moving=False)
        _, size, time_s = max((self.evidence_at(s, t, moving=False), s, t) for s, t in _near(size))
        self.evidence_at(size, time_s, ROUNDS)
        return max((self.evidence_at(s, t), s, t) for s, t in _near(size))

    def evidence_at(self, size: float, time_s: float, rounds: int = 0, trusted: float = TRUSTED,
                    moving: bool = True) -> float:
        """Log evidence (nats, up to a constant shared by all ports) with values of this size and time constant.

        With rounds > 0 parameters and paths are improved first, else the last linearisation serves. trusted: share of
        the cost that a further step may promise and be believed. moving: do the parameters?
        """
        priors = [path.prior(self.missing, size, time_s) for path in self.paths]
        linear = self.linear
        if linear is None or (moving and not self.moved):
            linear, self.moved = self._linearised(moving), moving
        damping = LEAST_DAMPING
        for _ in range(rounds):
            here = self.s, [q.x for q in self.paths]
            before = self._cost(linear, priors, *here)
            step = self._step(linear, priors, damping, moving)
            self.s = here[0] + step.s
            for path, d in zip(self.paths, step.x, strict=True):
                path.x = path.x + d
            gain = before - self._cost(self._followed(), priors, self.s, [q.x for q in self.paths])
            if gain > 0.0:  # False where it is not a number
                linear, damping = self._linearised(moving), max(0.01 * damping, LEAST_DAMPING)
                if gain < CALM * before:
                    break
                continue
            self.s = here[0]
            for path, x in zip(self.paths, here[1], strict=True):
                path.x = x
            if step.gain < CALM * before:
                break
            damping = max(30.0 * damping, 1e-4)
        self.linear = linear
        priors = [path.prior(self.missing, size, time_s) for path in self.paths]
        step = self._step(linear, priors, LEAST_DAMPING, moving)
        cost = self._cost(linear, priors, self.s, [q.x for q in self.paths])
        found = -0.5 * (cost - min(step.gain, trusted * cost) + step.log_det)
        return found if np.isfinite(found) else -np.inf

    def _linearised(self, moving: bool) -> list[_Linear]:
        p, slope = self.parameters(self.s), self.scale.slope(self.scale.outside(self.s))
        return [path.linearise(p, slope, self.evidence.noise, moving) for path in self.paths]

    def _followed(self) -> list[_Followed]:
        return [path.follow(self.parameters(self.s), self.evidence.noise) for path in self.paths]

    def _cost(self, linear: Sequence[_Followed | _Linear], priors: list[_Prior], s: Array, xs: list[Array]) -> float:
        away = s - self.fitted
        return float(away @ self.known @ away) + sum(one.cost + _surprise(x, one, prior)
                                  for one, prior, x in zip(linear, priors, xs, strict=True))

    def _step(self, linear: list[_Linear], priors: list[_Prior], damping: float, moving: bool) -> _Step:
        """Damped Gauss-Newton step; parameters at a bound that would leave it stay."""
        s, k = self.s, len(self.s)
        H, g, log_det, parts = self.known, self.known @ (s - self.fitted), 0.0, []
        for path, one, prior in zip(self.paths, linear, priors, strict=True):
            more, right, gx, X, x, det = path.eliminated(one, prior, damping)
            H, g, log_det = H + more, g + right, log_det + det
            parts.append((gx, X, x))
        free = moving & ~(((s <= self.scale.low + 1e-12) & (g > 0)) | ((s >= self.scale.high - 1e-12) & (g < 0)))
        ds = np.zeros(k)
        A = H[np.ix_(free, free)]
        if free.any():
            ds[free] = -np.linalg.lstsq(A + damping * np.diag(A.diagonal()), g[free], rcond=None)[0]
            log_det += float(np.linalg.slogdet(A)[1])
        ds = np.clip(s + ds, self.scale.low, self.scale.high) - s
        dx = [-(x + X @ ds) for _, X, x in parts]
        gain = -float(g @ ds) + sum(float((gx * x).sum()) for gx, _, x in parts)
        return _Step(ds, dx, gain, log_det)


@dataclass(eq=False)
class Path:
    """States at the start of every slice of one track, and the data about them."""

    runner: Runner
    slices: list[Window]
    opens: NDArray[np.bool_]        # slices that begin a window: the rig's states may jump there
    x: Array                        # slices x states

    def follow(self, p: Array, noise: Array) -> _Followed:
        """Where the slices end, and their squared error; p: parameters (SI)."""
        values = self.runner.parameters(p)
        memory, end, cost = self.runner.memory(values), np.zeros_like(self.x), 0.0
        for i, window in enumerate(self.slices):
            self.runner.enter(memory, self.x[i])
            Y, _, fine = self.runner.run(memory, window, values, False)
            if not fine:
                return _Followed(end, np.inf)
            cost += float((((Y - self.runner.track.y[window.start : window.stop]) / noise) ** 2).sum())
            end[i] = memory.x[: end.shape[1]]
        return _Followed(end, cost)

    def linearise(self, p: Array, slope: Array, noise: Array, moving: bool) -> _Linear:
        """p: parameters (SI); slope: theirs by prior spread; moving: derivatives by them, too?"""
        runner = self.runner if moving else replace(self.runner, free=())
        count, n, k = len(self.x), self.x.shape[1], len(slope)
        values, root = runner.parameters(p), 1.0 / noise
        memory, first = runner.memory(values), 0 if moving else k
        D, B, S = np.zeros((count, n, n)), np.zeros((count, n, k)), np.zeros((count, n, k + n))
        gx, end, H, g, cost = np.zeros((count, n)), np.zeros((count, n)), np.zeros((k, k)), np.zeros(k), 0.0
        by = np.concatenate([slope, np.ones(n)])[first:]
        A = np.zeros((0, k + n))
        for i, window in enumerate(self.slices):
            runner.enter(memory, self.x[i])
            Y, J, fine = runner.run(memory, window, values, True, root)
            if not fine:
                return _Linear(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], np.inf)
            r = ((Y - runner.track.y[window.start : window.stop]) * root).ravel()
            if len(A) != len(J):
                A = np.zeros((len(J), k + n))
            A[:, first:] = J[:, : len(by)] * by
            N, v = A.T @ A, A.T @ r
            H, g, D[i], B[i], gx[i], cost = H + N[:k, :k], g + v[:k], N[k:, k:], N[k:, :k], v[k:], cost + float(r @ r)
            end[i], S[i, :, first:] = memory.x[:n], memory.S[:n, : len(by)] * by
        return _Linear(H, D, B, g, gx, end, S[:, :, k:], S[:, :, :k], cost)

    def prior(self, missing: NDArray[np.intp], size: float, time_s: float) -> _Prior:
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
        return _Prior(joint, first, decay, float(np.log(joint[:, missing]).sum() + np.log(first[missing]).sum()))

    def eliminated(self, one: _Linear, prior: _Prior,
                   damping: float) -> tuple[Array, Array, Array, Array, Array, float]:
        """What the track adds to the parameters' information and gradient once its states are eliminated, the states'
        gradient, the solutions for [B | gx], and the log determinant of the states' information against the prior's.

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
        z, log_det = eliminate(D, off, scale[:, :, None] * np.concatenate([B, gx[:, :, None]], axis=2), damping)
        z *= scale[:, :, None]
        X, x, flat = z[:, :, :k], z[:, :, k], B.reshape(-1, k).T
        return (H - flat @ X.reshape(-1, k), g - flat @ x.ravel(), gx, X, x,
                log_det - 2.0 * float(np.log(scale).sum()) - prior.log_det)


def _surprise(x: Array, linear: _Followed | _Linear, prior: _Prior) -> float:
    """Squared distance of a path from what was known before."""
    jump = x[1:] - prior.decay * linear.end[:-1]
    return float((prior.joint * jump**2).sum() + (prior.first * x[0] ** 2).sum())


def _near(size: float) -> list[tuple[float, float]]:
    """Sizes and time constants of the grid around a size."""
    return [(s, t) for s in SIZES if 0.2 * size < s < 5.0 * size for t in TIMES_S]


def _slices(r: Replay) -> tuple[list[Window], NDArray[np.bool_]]:
    """Slices that do not straddle the replay's windows, and which of them begin one."""
    slices, opens = [], []
    length = max(4, round(SLICE_S / r.track.period_s))
    for w in r.windows:
        for k, s in enumerate(cut(w.stop - w.start, length)):
            slices.append(Window(w.start + s.start, w.start + s.stop))
            opens.append(k == 0)
    return slices, np.array(opens)


def _start_path(runner: Runner, values: Array, r: Replay, slices: list[Window], opens: NDArray[np.bool_]) -> Array:
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


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0
