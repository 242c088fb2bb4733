"""Latent values at ports of a model, smoothed together with its states over held-out recordings.

At every place of a port an unknown value is added, an Ornstein-Uhlenbeck process (a Matern-1/2
Gaussian process in time). States, value and the model's parameters are estimated together, slice by
slice, with the fit's posterior as the prior of the parameters. Gauss-Newton on a block-tridiagonal
system that the parameters border is the Kalman smoother of the linearised model, with its Laplace
evidence. The parameters are estimated anew, because the fitted ones have absorbed part of the
missing effect. After Rogers and Friis (2022), Mech. Syst. Signal Process. 180, 109426; Engelhardt,
Froehlich and Kschischo (2016), Sci. Rep. 6.

Let x_i be the states at the start of slice i and f(x_i) those at its end. A first-order Gauss-
Markov prior links neighbours: x_(i+1) = a f(x_i) + w_i, w_i ~ N(0, Q_i). For a latent value a =
exp(-length / time constant) and Q = size^2 (1 - a^2), the exact discretisation of an Ornstein-
Uhlenbeck process; for the other states a = 1 with a very small Q. Eliminating the states is the
Rauch-Tung-Striebel smoother of the linearised model: Bell (1994), SIAM J. Optim. 4(3); Särkkä
(2013), Bayesian Filtering and Smoothing, ch. 10 and 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.block_tridiagonal import eliminate
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.estimation.problem import Fit, Scale
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect, State
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner, Window, cut

# a latent value is constant over a slice: correlation times, and samples at least
SLICE, SLICE_SAMPLES = 0.16, 4
# standard deviations of a state other than a latent value that it may jump by: between slices a
# stand-in for zero with which blocks are invertible, where a window begins a stand-in for no bound
STIFFNESS, WINDOW_JUMP = 1e-4, 1e3
# standard deviations of a latent value that are tried, in sizes of the port's value, and its time
# constants in correlation times: those of a slice and of the shortest window
LATENT_SIZES, LATENT_TIMES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0), (0.16, 1.6)
LATENT_REACH = 5.0  # ratio of sizes: those nearer to the likeliest are tried with every time
# Gauss-Newton steps of a smoothing at most; share of the cost, less gained ends it
SMOOTHER_STEPS, SMOOTHER_TOLERANCE = 20, 1e-3
# share of the cost: the quadratic model is trusted near its point alone (Nocedal and Wright 2006,
# Numerical Optimization, chapter 4)
SMOOTHER_TRUSTED = 0.1
# of a diagonal scaled to 1: keeps a singular block solvable, without weight in the result
SMOOTHER_DAMPING = 1e-10


# ---- a track in slices ------------------------------------------------------------------------


class Linearisation(NamedTuple):
    """The data of a track, linearised about a trajectory and the parameters: information of the
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
    """Prior of a trajectory: information of the joints between slices (slices-1 x n) and of the
    first value (n), decay of the states over a slice (n), log determinant of the latent values'
    part."""

    joint: Array
    first: Array
    decay: Array
    log_det: float


@dataclass(frozen=True, eq=False)
class SlicedTrack:
    """A track in slices. A trajectory x of it: the states at the start of every slice (slices x
    states)."""

    runner: Runner
    slices: list[Window]
    opens: NDArray[np.bool_]  # slices that begin a window: the rig's states may jump there
    start: Array  # the trajectory that smoothing begins with
    known: tuple[KnownSlopes | None, ...] = (None, None)  # as `slopes_along`

    @cached_property
    def keeping(self) -> tuple[Runner, Runner]:
        """The runner by the states alone, and by the parameters as well. A simulator's slopes are
        kept between linearisations."""
        still, moving = self.known
        return replace(self.runner, free=()).keeping(still), self.runner.keeping(moving)

    def simulate(self, x: Array, p: Array, noise: Array, moving: bool) -> Simulation:
        """States at the ends of the slices, and their squared error. p: parameters (SI); moving:
        whether they are estimated as well."""
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
        seen_root = root if seen.all() else np.where(seen, root, 0.0)
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
        runs = runner.run_windows(runner.memory(values), self.slices, x, values, True, seen_root)
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
        # A state that rests has no spread, and the prior needs a positive spread.
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
        self, x: Array, data: Linearisation, prior: TrajectoryPrior, damping: float
    ) -> tuple[Array, Array, Array, Array, Array, float]:
        """Contribution of the track to the parameters' information and gradient once its states
        are eliminated, the states' gradient, the solutions for [B | gx], and the log determinant
        of the states' information against the prior's.

        The system is scaled to a unit diagonal: states in pascals and radians stand side by side.
        """
        joint, decay, n, k = prior.joint, prior.decay, x.shape[1], len(data.g)
        D, gx, B = data.D.copy(), data.gx.copy(), data.B.copy()
        # |x_(i+1) - a f(x_i, s)|^2 in Q^-1: its derivatives are 1 by x_(i+1), -A by x_i, -P by s
        jump = x[1:] - decay * data.end[:-1]
        A, P = decay[:, None] * data.by_start[:-1], decay[:, None] * data.by_parameters[:-1]
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
        H = data.H + flat_P.T @ weighed.reshape(joints, k)
        g = data.g - flat_P.T @ weighed_jump.ravel()
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
    """Slices that do not straddle the replay's windows, and which of them begin a window."""
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


# ---- the smoother -----------------------------------------------------------------------------


class ReplayedModel(Protocol):
    """A fitted model with its replays, of which each window begins at an estimated start."""

    @property
    def assembly(self) -> Assembly: ...

    @property
    def fit(self) -> Fit: ...

    @property
    def replays(self) -> tuple[Replay, ...]: ...

    @property
    def slopes_along_replays(self) -> tuple[tuple[KnownSlopes | None, ...], ...]: ...


class Latent(Effect):
    """A value that is simply missing: it wanders and is not explained. Sizes are those of the
    port's value."""

    name = "latent"
    family = "latent"
    kinds = ()
    states = (State("missing"),)

    def __init__(self, size: float) -> None:
        self.size = size

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        return value + self.size * z.missing, {"missing": 0.0}


class _SmoothingPoint(NamedTuple):
    """Parameters (in prior spreads), every track's trajectory, cost, the data linearised about them
    (empty as long as no step is taken from there)."""

    s: Array
    x: tuple[Array, ...]
    cost: float
    data: tuple[Linearisation, ...] = ()


class _SmoothingStep(NamedTuple):
    """Step of the parameters (in prior spreads) and of every track's states; promised gain; log
    determinant of the information against the priors'."""

    s: Array
    x: list[Array]
    gain: float
    log_det: float


@dataclass(frozen=True, eq=False)
class SmoothingResult:
    """Result of smoothing with latent values of a size and time constant: log evidence (nats, up to
    a constant shared by all ports), parameters in prior spreads (k,), per track the states at the
    start of every slice (slices x states), and the data linearised about them; moving: by the
    parameters, too."""

    log_evidence: float
    size: float
    time_s: float
    s: Array
    x: tuple[Array, ...]
    linearised: tuple[Linearisation, ...]
    moving: bool

    @property
    def score(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant)"""
        return self.log_evidence, self.size, self.time_s


@dataclass(frozen=True, eq=False)
class Smoother:
    """The model of `base` with latent values at `ports`, to be smoothed over the held-out
    replays."""

    evidence: DataSplit
    base: ReplayedModel
    ports: tuple[str, ...]

    @cached_property
    def assembly(self) -> Assembly:
        b, rig = self.base.assembly, self.evidence.rig
        added = tuple(
            Attachment(Latent(size_at(b, port)), (port,), f"latent.{i}")
            for i, port in enumerate(self.ports)
        )
        # ranges that were widened for the fit stay wide: its parameters would be cut off otherwise
        return Assembly(
            rig,
            (*b.attachments, *added),
            background=True,
            sizes=b.sizes,
            outputs=b.outputs,
            ranges=b.ranges,
        ).for_fitting()

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
    def values(self) -> Array:
        """All parameters of the fit, SI."""
        p, base = self.assembly.values(), self.base
        p[[self.assembly.keys[key] for key in base.assembly.keys]] = base.fit.p
        return p

    @cached_property
    def fitted(self) -> Array:
        """Those that move, in prior spreads."""
        return np.clip(
            self.scale.inside(self.values[list(self.free)]), self.scale.low, self.scale.high
        )

    @cached_property
    def information(self) -> Array:
        """Information of the fit on the parameters; little where its residual is large."""
        information: Array = np.linalg.pinv(self.base.fit.covariance, hermitian=True).astype(
            np.float64, copy=False
        )
        return information

    def parameters(self, s: Array) -> Array:
        """All parameters (SI) at those that move, in prior spreads."""
        p = self.values.copy()
        p[list(self.free)] = self.scale.outside(s)
        return p

    @cached_property
    def missing(self) -> NDArray[np.intp]:
        """Places of the latent values among the states."""
        return np.flatnonzero([s.endswith(".missing") for s in self.assembly.program.states])

    @cached_property
    def tracks(self) -> tuple[SlicedTrack, ...]:
        tracks = []
        for r, known in zip(self.base.replays, self.base.slopes_along_replays, strict=True):
            stepping = self.base.fit.stepping
            runner = Runner(self.assembly, r.track, stepping, self.free, all_states=True)
            slices, opens = slices_of(r)
            start = start_trajectory(runner, self.parameters(self.fitted), r, slices, opens)
            tracks.append(SlicedTrack(runner, slices, opens, start, known))
        return tuple(tracks)

    @property
    def times_s(self) -> tuple[float, ...]:
        """Time constants tried, s."""
        return tuple(t * self.evidence.timescale_s for t in LATENT_TIMES)

    def _near(self, size: float) -> list[tuple[float, float]]:
        """Sizes and time constants of the grid around a size."""
        near = [s for s in LATENT_SIZES if size / LATENT_REACH < s < LATENT_REACH * size]
        return [(s, t) for s in near for t in self.times_s]

    @cached_property
    def rough(self) -> SmoothingResult:
        """The most likely size and time constant of a coarse grid, as `best`, but with the
        parameters held: several times as fast."""
        time_s = self.times_s[0]
        if not self.ports:
            return self.smoothed(None, 1.0, 1.0, SMOOTHER_STEPS, moving=False)
        # a single linearisation along the replay serves all sizes; only around the most likely size
        # are the trajectories improved
        smallest, *larger = LATENT_SIZES
        start = self.smoothed(None, smallest, time_s, trusted=1.0, moving=False)
        rest = [self.smoothed(start, s, time_s, trusted=1.0, moving=False) for s in larger]
        size = max([start, *rest], key=lambda smoothed: smoothed.score).size
        there = self.smoothed(start, size, time_s, SMOOTHER_STEPS, moving=False)
        near = [self.smoothed(there, s, t, moving=False) for s, t in self._near(size)]
        return max(near, key=lambda smoothed: smoothed.score)

    @cached_property
    def best(self) -> SmoothingResult:
        """The most likely size and time constant of a coarse grid."""
        there = self.smoothed(self.rough, self.rough.size, self.rough.time_s, SMOOTHER_STEPS)
        if not self.ports:
            return there
        near = [self.smoothed(there, s, t) for s, t in self._near(self.rough.size)]
        return max(near, key=lambda smoothed: smoothed.score)

    def smoothed(
        self,
        start: SmoothingResult | None,
        size: float,
        time_s: float,
        rounds: int = 0,
        trusted: float = SMOOTHER_TRUSTED,
        moving: bool = True,
    ) -> SmoothingResult:
        """Smooth with values of this size and time constant, from where an earlier smoothing ended
        (None: from the fit's replays).

        With rounds > 0 parameters and trajectories are improved first, else the linearisation of
        `start` serves. trusted: share of the cost that a further step may promise and be believed;
        moving: do the parameters?

        Log evidence by Laplace's approximation at the optimum, log p(y) = -1/2 (cost + log det
        (information / prior's information)) + const: MacKay (1992), Neural Comput. 4(3), 415-447.
        """
        s, x = (start.s, start.x) if start else (self.fitted, tuple(t.start for t in self.tracks))
        usable = start is not None and start.moving == moving
        data = start.linearised if start and usable else self._linearised(s, x, moving)
        solver = SmoothingProblem(self, self._priors(x, size, time_s), moving)
        ended = iterate(solver, Iteration(solver.point(s, x, data), SMOOTHER_DAMPING), rounds).point
        # the spread of the states has changed with them
        solver = replace(solver, priors=self._priors(ended.x, size, time_s))
        point = solver.point(ended.s, ended.x, ended.data)
        step = solver.step(point, SMOOTHER_DAMPING)
        # the quadratic's minimum stands in for another iteration, up to a share of the cost
        log_evidence = -0.5 * (point.cost - min(step.gain, trusted * point.cost) + step.log_det)
        log_evidence = log_evidence if np.isfinite(log_evidence) else -np.inf
        return SmoothingResult(log_evidence, size, time_s, point.s, point.x, point.data, moving)

    def _priors(self, x: tuple[Array, ...], size: float, time_s: float) -> list[TrajectoryPrior]:
        return [
            track.prior(states, self.missing, size, time_s)
            for track, states in zip(self.tracks, x, strict=True)
        ]

    def _linearised(
        self, s: Array, x: tuple[Array, ...], moving: bool
    ) -> tuple[Linearisation, ...]:
        p, slope = self.parameters(s), self.scale.slope(self.scale.outside(s))
        return tuple(
            track.linearise(states, p, slope, self.evidence.noise, moving)
            for track, states in zip(self.tracks, x, strict=True)
        )


@dataclass(frozen=True, eq=False)
class SmoothingProblem(LeastSquares[_SmoothingPoint, _SmoothingStep]):
    """The least squares of a smoother over (parameters, trajectories), given the trajectories'
    priors. Least damping at first: smoothing begins near its optimum."""

    rule = DampingRule(SMOOTHER_DAMPING, 0.01, SMOOTHER_DAMPING, 30.0, raised=1e-4)
    of: Smoother
    priors: list[TrajectoryPrior]
    moving: bool

    def cost(
        self, s: Array, x: tuple[Array, ...], data: Sequence[Simulation | Linearisation]
    ) -> float:
        away = s - self.of.fitted
        return float(away @ self.of.information @ away) + sum(
            run.cost + prior_cost(states, run, prior)
            for states, run, prior in zip(x, data, self.priors, strict=True)
        )

    def point(
        self, s: Array, x: tuple[Array, ...], data: tuple[Linearisation, ...]
    ) -> _SmoothingPoint:
        return _SmoothingPoint(s, x, self.cost(s, x, data), data)

    def moved(
        self, at: _SmoothingPoint, step: _SmoothingStep, last: bool = False
    ) -> _SmoothingPoint:
        s, x = at.s + step.s, tuple(states + d for states, d in zip(at.x, step.x, strict=True))
        p, noise = self.of.parameters(s), self.of.evidence.noise
        tracks = zip(self.of.tracks, x, strict=True)
        runs = [t.simulate(states, p, noise, self.moving) for t, states in tracks]
        return _SmoothingPoint(s, x, self.cost(s, x, runs))

    def linearised(self, at: _SmoothingPoint, last: bool) -> _SmoothingPoint:
        return self.point(at.s, at.x, self.of._linearised(at.s, at.x, self.moving))

    def settled(self, gain: float, before: _SmoothingPoint, after: _SmoothingPoint) -> bool:
        return gain < SMOOTHER_TOLERANCE * before.cost

    def stuck(self, at: _SmoothingPoint, step: _SmoothingStep) -> bool:
        return step.gain < SMOOTHER_TOLERANCE * at.cost

    def step(self, at: _SmoothingPoint, damping: float) -> _SmoothingStep:
        """Damped Gauss-Newton step; parameters at a bound that would leave it stay."""
        s, k, scale = at.s, len(at.s), self.of.scale
        H, parts, log_det = self.of.information, [], 0.0
        g = H @ (s - self.of.fitted)
        for track, x, data, prior in zip(self.of.tracks, at.x, at.data, self.priors, strict=True):
            more, right, gx, X, dx, det = track.eliminated(x, data, prior, damping)
            H, g, log_det = H + more, g + right, log_det + det
            parts.append((gx, X, dx))
        free = self.moving & ~scale.held(s, g)
        ds = np.zeros(k)
        A = H[np.ix_(free, free)]
        if free.any():
            ds[free] = -np.linalg.lstsq(A + damping * np.diag(A.diagonal()), g[free], rcond=None)[0]
            # det of the bordered matrix = det of the states' block x det of its Schur complement
            log_det += float(np.linalg.slogdet(A)[1])
        ds = np.clip(s + ds, scale.low, scale.high) - s
        states = [-(dx + X @ ds) for _, X, dx in parts]
        # promise of the quadratic, g'H^-1 g, by blocks: that of the parameters, with the reduced
        # gradient, and that of the states
        gain = -float(g @ ds) + sum(float((gx * dx).sum()) for gx, _, dx in parts)
        return _SmoothingStep(ds, states, gain, log_det)


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0
