"""Fitting problem, its units, and its solution."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.prior import Prior
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.model.bound_parameter import Bound
from pamid.simulation.data_split import FIT_WINDOW
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.tracks import Track, noise_of, stated_noise
from pamid.simulation.windows import Runner, Window, cut

SHORTEST = 20  # samples


@dataclass(frozen=True, eq=False)
class Problem:
    """Fitting problem: model, tracks and free parameters. free: places of the fitted parameters;
    importance: a factor per window, sheet: another draw of the data sheet in prior spreads
    (bootstrap); prior: an earlier fit's, in addition."""

    assembly: Assembly
    tracks: tuple[Track, ...]
    free: tuple[int, ...]
    window_s: float | None = None  # default: `FIT_WINDOW` correlation times of the recordings
    importance: Array | None = None
    sheet: Array | None = None
    prior: Prior | None = None

    @property
    def scale(self) -> Scale:
        """The free parameters in prior spreads around the data sheet."""
        a, free = self.assembly, list(self.free)
        return Scale([a.parameters[i] for i in free], a.values()[free])

    def start(self) -> Array:
        """Start of a fit (SI): the data sheet, or an earlier fit's posterior."""
        p = self.assembly.values()
        if self.prior is not None:
            p[list(self.free)] = self.scale.outside(self.prior.at)
        return p

    @cached_property
    def noise(self) -> Array:
        """Noise of the sensors, per channel (SI)."""
        return noise_of(self.tracks, stated_noise(self.assembly.rig, self.assembly.program.outputs))

    @property
    def window(self) -> int:
        """Samples per window of the longest recording."""
        longest = max(self.tracks, key=len)
        return self.windows(longest)[0].stop

    def windows(self, track: Track) -> list[Window]:
        seconds = self.window_s or FIT_WINDOW * track.timescale_s
        return cut(len(track), max(SHORTEST, round(seconds / track.period_s)))


@dataclass(frozen=True, eq=False)
class FitStart:
    """Where a fit begins.

    p: parameters (SI; default: `Problem.start`; the priors do not depend on them); starts: states
    at the start of every window, per track (default: estimated); weights: of the residuals
    (default: the sensor noise); stepping: integration steps per sample (default: chosen for the
    recordings); continuity: weights of the jumps between windows, per track (default: from the
    first point); known: slopes of a stepped rig along the same tracks, reused while they hold.
    """

    p: Array | None = None
    starts: tuple[Array, ...] | None = None
    weights: Weights | None = None
    stepping: Stepping | None = None
    continuity: tuple[Array, ...] = ()
    known: tuple[KnownSlopes | None, ...] = ()


FIRST_START = FitStart()


@dataclass(frozen=True)
class Fit:
    """Result of a fit. p: all parameters (SI); covariance of the free ones in prior spreads (see
    `Scale`); held: half the gradient of the cost by them where a bound holds the fit, else 0."""

    problem: Problem
    p: Array
    starts: tuple[Array, ...]  # per track: windows x rig states
    weights: Weights
    cost: float
    covariance: Array
    iterations: int
    converged: bool
    why: str
    stepping: Stepping
    # per track: information of the continuity from window to window, per rig state
    continuity: tuple[Array, ...] = ()
    # per track: samples x channels, model - measured
    residuals: tuple[Array, ...] = field(repr=False, default=())
    held: Array = field(repr=False, default_factory=lambda: np.zeros(0))
    # per track: slopes of a simulator, for a fit that goes on from here
    known: tuple[KnownSlopes | None, ...] = field(repr=False, compare=False, default=())

    @property
    def end(self) -> FitStart:
        """Where the fit has ended, as the start of another."""
        return FitStart(self.p, self.starts, self.weights, self.stepping, self.continuity)


class Scale:
    """Parameters in units of their prior spread around their prior mean (logarithms where the prior
    is)."""

    def __init__(self, bounds: list[Bound], centre: Array) -> None:
        self.log = np.array([b.log for b in bounds], bool)
        self.spread = np.array([b.spread for b in bounds])
        self.centre = np.where(
            self.log, np.log(np.where(self.log, np.maximum(centre, 1e-300), 1.0)), centre
        )
        low, high = np.array([b.low for b in bounds]), np.array([b.high for b in bounds])
        with np.errstate(divide="ignore"):
            raw_low = np.where(self.log, np.log(np.where(self.log, np.maximum(low, 0.0), 1.0)), low)
            raw_high = np.where(self.log, np.log(np.where(self.log, high, 1.0)), high)
        self.low, self.high = (
            (raw_low - self.centre) / self.spread,
            (raw_high - self.centre) / self.spread,
        )

    def inside(self, p: Array) -> Array:
        raw = np.where(self.log, np.log(np.where(self.log, np.maximum(p, 1e-300), 1.0)), p)
        return (raw - self.centre) / self.spread

    def outside(self, s: Array) -> Array:
        raw = self.centre + s * self.spread
        return np.where(self.log, np.exp(np.where(self.log, raw, 0.0)), raw)

    def held(self, s: Array, g: Array) -> NDArray[np.bool_]:
        """Parameters at a bound that a step against the gradient g would cross: the active set of a
        projected step (Nocedal and Wright (2006), ch. 16.7)."""
        at_bound: NDArray[np.bool_] = ((s <= self.low + 1e-12) & (g > 0)) | (
            (s >= self.high - 1e-12) & (g < 0)
        )
        return at_bound

    def slope(self, p: Array) -> Array:
        """Derivatives of the parameters (SI) by the scaled ones."""
        return self.spread * np.where(self.log, p, 1.0)


def free_parameters(assembly: Assembly, tracks: tuple[Track, ...]) -> tuple[int, ...]:
    """Fitted parameters that any recording leaves open."""
    return tuple(
        i
        for i, b in enumerate(assembly.parameters)
        if b.fitted and any(i not in t.known for t in tracks)
    )


def careful_stepping(problem: Problem, p: Array) -> Stepping:
    """The most careful of the steppings that the recordings need."""
    a = problem.assembly
    steppings = []
    for track in problem.tracks:
        values = Runner(a, track, Stepping()).parameters(p)
        steppings.append(choose_stepping(a, track.u, values, track.period_s, a.start(values)))
    return most_careful(steppings)


def most_careful(steppings: Iterable[Stepping]) -> Stepping:
    """Implicit before explicit, then the finest."""
    return max(steppings, key=lambda s: (s.implicit, s.substeps))
