"""A model with latent values at some of its ports, smoothed together with its states over held-out
recordings.

At every place of a port an unknown value is added that wanders as an Ornstein-Uhlenbeck process
(a Matern-1/2 Gaussian process in time). States, value and the model's parameters, within what
the fit knows of them, are found together, slice by slice, by Gauss-Newton on a block-tridiagonal
system that the parameters border: the Kalman smoother of the linearised model, with its Laplace
evidence. The parameters are estimated anew, because the fitted ones have absorbed part of what
is missing. After Rogers and Friis (2022), Mech. Syst. Signal Process. 180, 109426; Engelhardt,
Froehlich and Kschischo (2016), Sci. Rep. 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel, transferred
from pamid.diagnosis.smoothed_trajectory import (
    Linearisation,
    Simulation,
    SlicedTrack,
    TrajectoryPrior,
    prior_cost,
    slices_of,
    start_trajectory,
)
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.known_slopes import KnownSlopes
from pamid.estimation.problem import Scale
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect, State
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner
from pamid.symbolic.vocabulary import Expr, Number

Array = NDArray[np.float64]

# standard deviations of a latent value that are tried, in sizes of the port's value, and its time
# constants in correlation times: those of a slice and of the shortest window
LATENT_SIZES, LATENT_TIMES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0), (0.16, 1.6)
LATENT_REACH = 5.0  # ratio of sizes: those nearer to the likeliest are tried with every time
# Gauss-Newton steps of a smoothing at most; share of the cost, less gained ends it
SMOOTHER_STEPS, SMOOTHER_TOLERANCE = 20, 1e-3
# share of the cost: the quadratic model is trusted near its point alone (Nocedal and Wright 2006,
# Numerical Optimization, chapter 4)
SMOOTHER_TRUSTED = 0.1
# of a diagonal scaled to one: keeps a singular block solvable, without weight in the result
SMOOTHER_DAMPING = 1e-10


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
    """Of the parameters (in prior spreads) and of every track's states; what it promises to gain;
    log determinant of the information against the priors'."""

    s: Array
    x: list[Array]
    gain: float
    log_det: float


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What smoothing has found with latent values of a size and time constant: log evidence (nats,
    up to a constant shared by all ports), parameters in prior spreads (k,), per track the states at
    the start of every slice (slices x states), and the data linearised about them; moving: by the
    parameters, too."""

    log_evidence: float
    size: float
    time_s: float
    s: Array
    x: tuple[Array, ...]
    linearised: tuple[Linearisation, ...]
    moving: bool

    @property
    def found(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant)"""
        return self.log_evidence, self.size, self.time_s


@dataclass(frozen=True, eq=False)
class Smoother:
    """The model of `base` with latent values at `ports`, to be smoothed over the held-out
    replays."""

    evidence: DataSplit
    base: CandidateModel
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
        return transferred(self.assembly, (self.base.assembly, self.base.fit.p))

    @cached_property
    def fitted(self) -> Array:
        """Those that move, in prior spreads."""
        return np.clip(
            self.scale.inside(self.values[list(self.free)]), self.scale.low, self.scale.high
        )

    @cached_property
    def information(self) -> Array:
        """What the fit knows of them: little where what it left is large."""
        found: Array = np.linalg.pinv(self.base.fit.covariance, hermitian=True).astype(
            np.float64, copy=False
        )
        return found

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
        known = self.base.slopes_along_replays
        return tuple(self._sliced(r, k) for r, k in zip(self.base.replays, known, strict=True))

    def _sliced(self, r: Replay, known: tuple[KnownSlopes | None, ...]) -> SlicedTrack:
        runner = Runner(self.assembly, r.track, self.base.fit.stepping, self.free, all_states=True)
        slices, opens = slices_of(r)
        start = start_trajectory(runner, self.parameters(self.fitted), r, slices, opens)
        return SlicedTrack(runner, slices, opens, start, known)

    @property
    def times_s(self) -> tuple[float, ...]:
        """Time constants tried, s."""
        return tuple(t * self.evidence.timescale_s for t in LATENT_TIMES)

    def _near(self, size: float) -> list[tuple[float, float]]:
        """Sizes and time constants of the grid around a size."""
        near = [s for s in LATENT_SIZES if size / LATENT_REACH < s < LATENT_REACH * size]
        return [(s, t) for s in near for t in self.times_s]

    @cached_property
    def rough(self) -> Smoothed:
        """The most likely size and time constant of a coarse grid, as `best`, but with the
        parameters held: several times as fast."""
        time_s = self.times_s[0]
        if not self.ports:
            return self.smoothed(None, 1.0, 1.0, SMOOTHER_STEPS, moving=False)
        # one linearisation along the replay serves all sizes; only around the most likely one are
        # the trajectories improved
        smallest, *larger = LATENT_SIZES
        start = self.smoothed(None, smallest, time_s, trusted=1.0, moving=False)
        rest = [self.smoothed(start, s, time_s, trusted=1.0, moving=False) for s in larger]
        size = max([start, *rest], key=lambda one: one.found).size
        there = self.smoothed(start, size, time_s, SMOOTHER_STEPS, moving=False)
        near = [self.smoothed(there, s, t, moving=False) for s, t in self._near(size)]
        return max(near, key=lambda one: one.found)

    @cached_property
    def best(self) -> Smoothed:
        """The most likely size and time constant of a coarse grid."""
        there = self.smoothed(self.rough, self.rough.size, self.rough.time_s, SMOOTHER_STEPS)
        if not self.ports:
            return there
        near = [self.smoothed(there, s, t) for s, t in self._near(self.rough.size)]
        return max(near, key=lambda one: one.found)

    def smoothed(
        self,
        start: Smoothed | None,
        size: float,
        time_s: float,
        rounds: int = 0,
        trusted: float = SMOOTHER_TRUSTED,
        moving: bool = True,
    ) -> Smoothed:
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
        # the quadratic's own minimum stands in for another iteration, up to a share of the cost
        found = -0.5 * (point.cost - min(step.gain, trusted * point.cost) + step.log_det)
        found = found if np.isfinite(found) else -np.inf
        return Smoothed(found, size, time_s, point.s, point.x, point.data, moving)

    def _priors(self, x: tuple[Array, ...], size: float, time_s: float) -> list[TrajectoryPrior]:
        return [
            track.prior(one, self.missing, size, time_s)
            for track, one in zip(self.tracks, x, strict=True)
        ]

    def _linearised(
        self, s: Array, x: tuple[Array, ...], moving: bool
    ) -> tuple[Linearisation, ...]:
        p, slope = self.parameters(s), self.scale.slope(self.scale.outside(s))
        return tuple(
            track.linearise(one, p, slope, self.evidence.noise, moving)
            for track, one in zip(self.tracks, x, strict=True)
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
            one.cost + prior_cost(states, one, prior)
            for states, one, prior in zip(x, data, self.priors, strict=True)
        )

    def point(
        self, s: Array, x: tuple[Array, ...], data: tuple[Linearisation, ...]
    ) -> _SmoothingPoint:
        return _SmoothingPoint(s, x, self.cost(s, x, data), data)

    def moved(
        self, at: _SmoothingPoint, step: _SmoothingStep, last: bool = False
    ) -> _SmoothingPoint:
        s, x = at.s + step.s, tuple(one + d for one, d in zip(at.x, step.x, strict=True))
        p, noise = self.of.parameters(s), self.of.evidence.noise
        tracks = zip(self.of.tracks, x, strict=True)
        runs = [t.simulate(one, p, noise, self.moving) for t, one in tracks]
        return _SmoothingPoint(s, x, self.cost(s, x, runs))

    def linearised(self, at: _SmoothingPoint) -> _SmoothingPoint:
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
        for track, x, one, prior in zip(self.of.tracks, at.x, at.data, self.priors, strict=True):
            more, right, gx, X, dx, det = track.eliminated(x, one, prior, damping)
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
        # what the quadratic promises, g'H^-1 g, by blocks: that of the parameters, with the reduced
        # gradient, and that of the states
        gain = -float(g @ ds) + sum(float((gx * dx).sum()) for gx, _, dx in parts)
        return _SmoothingStep(ds, states, gain, log_det)


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0
