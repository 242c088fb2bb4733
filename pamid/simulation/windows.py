"""Recordings cut into windows, and one window run from a start state: the ground of fitting and of
scoring.

The rig's own states are set anew at the start of each window; what effects remember (plays, lags,
creep) is carried on from the window before, so that no effect has to be told its past.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.units import split_column, to_si
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.program import Memory, Stepping
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.noise import sensor_noise
from pamid.recording.recording import Recording
from pamid.simulation.simulate import input_table, known_values, output_table

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """One recording as a fit sees it. SI throughout.

    u (samples x inputs), y (samples x channels; NaN where a channel was not recorded), known:
    places of parameters that are held for it, p their values put into the data sheet's; jump: by
    what each of the rig's states may depart, where a window begins, from what the window before has
    led to; first: index in the recording file of the first sample (for time and reports); lead:
    samples at the beginning that only serve to find the state, and are never scored.
    """

    name: str
    u: Array
    y: Array
    p: Array
    known: tuple[int, ...]
    period_s: float
    jump: Array
    first: int = 0
    lead: int = 0

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Which channels were recorded."""
        return np.logical_not(np.isnan(self.y).any(axis=0))

    def part(self, start: int, stop: int, lead: int = 0) -> Track:
        """Samples start..stop, led in by up to `lead` samples before them."""
        begin = max(0, start - lead)
        return replace(
            self,
            u=self.u[begin:stop],
            y=self.y[begin:stop],
            first=self.first + begin,
            lead=start - begin,
        )


def track_of(
    assembly: Assembly, recording: Recording, channels: tuple[str, ...], jump: Array | None = None
) -> Track:
    """The recording's inputs and measured channels for this assembly; without `jump` states depart
    as they like."""
    p, known = known_values(assembly, recording.known)
    free = np.full(len(assembly.rig.states), np.inf)
    return Track(
        recording.name,
        input_table(assembly, recording),
        _measured(channels, recording),
        p,
        tuple(known),
        recording.sampling_period_s,
        free if jump is None else jump,
    )


def stated_noise(rig: Rig, channels: Sequence[str]) -> Array:
    """What the rig says of its sensors: standard deviation per channel (SI), 0 where it says
    nothing."""
    units = [split_column(name)[1] for name in channels]
    return np.array(
        [
            to_si(rig.noise.get(name, 0.0), unit) - to_si(0.0, unit)
            for name, unit in zip(channels, units, strict=True)
        ]
    )


def _measured(channels: tuple[str, ...], recording: Recording) -> Array:
    """The channels, NaN those that were not recorded."""
    seen = tuple(c for c in channels if recording.has(c))
    if seen == channels:
        return output_table(channels, recording)
    y = np.full((len(recording), len(channels)), np.nan)
    y[:, [channels.index(c) for c in seen]] = output_table(seen, recording)
    return y


def noise_of(tracks: Sequence[Track], stated: Array) -> Array:
    """Noise level per channel over all tracks that have it; NaN where none has. stated: see
    `sensor_noise`."""
    if all(t.seen.all() for t in tracks):
        return sensor_noise([t.y for t in tracks], stated)
    noise = np.full(tracks[0].y.shape[1], np.nan)
    for c in range(noise.size):
        own = [t.y[:, [c]] for t in tracks if t.seen[c]]
        noise[c] = sensor_noise(own, stated[[c]])[0] if own else np.nan
    return noise


@dataclass(frozen=True)
class Window:
    start: int
    stop: int


def cut(samples: int, length: int) -> list[Window]:
    """Windows of about `length` samples that cover everything; the last one takes the rest."""
    count = max(1, round(samples / length))
    edges = np.linspace(0, samples, count + 1).round().astype(int)
    return [Window(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]


@dataclass(frozen=True, eq=False)
class Runner:
    """Runs windows of one track with given parameters.

    free: places of the parameters that get sensitivity columns; after them come the rig's own
    states at the window's start, so a Jacobian has len(free) + rig_states columns.
    """

    assembly: Assembly
    track: Track
    stepping: Stepping
    free: tuple[int, ...] = ()
    whole: bool = False  # set anew the effects' states, too

    @cached_property
    def rig_states(self) -> int:
        return len(self.assembly.program.states if self.whole else self.assembly.rig.states)

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        chosen = np.full(len(self.assembly.parameters), -1, np.int64)
        for column, place in enumerate(self.free):
            if place not in self.track.known:
                chosen[place] = column
        return chosen

    def parameters(self, p: Array) -> Array:
        """p with what this recording knows put in."""
        out = p.copy()
        out[list(self.track.known)] = self.track.p[list(self.track.known)]
        return out

    def memory(self, p: Array) -> Memory:
        return self.assembly.program.memory(
            self.assembly.start(p),
            len(self.free) + self.rig_states,
            stepping=self.stepping,
            period_s=self.track.period_s,
        )

    def widened(self, memory: Memory) -> Memory:
        """A copy of another run's memory with this runner's (empty) sensitivities."""
        fresh = self.assembly.program.memory(
            memory.x,
            len(self.free) + self.rig_states,
            stepping=self.stepping,
            period_s=self.track.period_s,
        )
        return replace(memory.copy(), S=fresh.S, buffer_S=fresh.buffer_S)

    def enter(self, memory: Memory, x: Array) -> None:
        """Start a window at rig state x: sensitivities to x begin here, those to parameters live on
        in memories."""
        n, k = self.rig_states, len(self.free)
        memory.x[:n] = x
        memory.join = True
        memory.S[:n] = 0.0
        memory.S[:, k:] = 0.0
        memory.S[:n, k : k + n] = np.eye(n)
        memory.buffer_S[:, :, k:] = 0.0

    def run(
        self,
        memory: Memory,
        window: Window,
        p: Array,
        sensitivities: bool,
        weights: Array | None = None,
    ) -> tuple[Array, Array, bool]:
        """Outputs, Jacobian (samples x channels, padded columns) times weights per channel; did all
        stay finite?"""
        t = self.track
        Y, J, bad = self.assembly.program.run(
            memory,
            t.u[window.start : window.stop],
            p,
            period_s=t.period_s,
            time_s=(t.first + window.start) * t.period_s,
            stepping=self.stepping,
            columns=self.columns if sensitivities else None,
            weights=weights,
        )
        return (
            Y,
            J.reshape(J.shape[0] * J.shape[1], J.shape[2]),
            bad < 0 and bool(np.isfinite(Y).all()),
        )


PULL = 1e-5  # information of a carried state against what a window says by itself


class _At(NamedTuple):
    """A state at the start of a window, its cost, half Hessian and half gradient there."""

    x: Array
    cost: float
    H: Array
    g: Array


@dataclass(frozen=True, eq=False)
class _InitialState(LeastSquares[_At, Array]):
    """The least squares of one window over its initial state, with the carried state as prior (the
    arrival cost of moving-horizon estimation: Rao, Rawlings and Mayne (2003), IEEE TAC 48(2))."""

    runner: Runner
    memory: Memory
    window: Window
    p: Array
    y: Array
    weight: Array
    carried: Array
    known: Array  # information of the carried state
    # the first point counted as a step taken: 0.1 x 1e-3
    rule = DampingRule(1e-4, falls=0.1, least=1e-9, rises=30.0, most=1e8)

    def at(self, x: Array) -> _At:
        run, n, away = self.runner, self.runner.rig_states, x - self.carried
        m = run.widened(self.memory)
        run.enter(m, x)
        Y, A, fine = run.run(m, self.window, self.p, True, self.weight)
        if not fine:
            return _At(x, np.inf, np.zeros((n, n)), np.zeros(n))
        r = ((Y - self.y) * self.weight).ravel()
        cost = float(r @ r) + float((away**2 * self.known).sum())
        H, g = (A.T @ A)[:n, :n], (A.T @ r)[:n]
        holds = np.maximum(PULL * H.diagonal(), self.known)
        return _At(x, cost, H + np.diag(holds), g + holds * away)

    def step(self, at: _At, damping: float) -> Array | None:
        if not np.isfinite(at.H).all():
            return None
        scale = at.H.diagonal() + 1e-300
        found = np.linalg.lstsq(at.H + np.diag(damping * scale), -at.g, rcond=None)[0]
        return np.asarray(found, np.float64) if np.isfinite(found).all() else None

    def moved(self, at: _At, step: Array, last: bool) -> _At:
        return self.at(at.x + step)

    def settled(self, gain: float, before: _At, after: _At) -> bool:
        return gain < 1e-4 * after.cost + 1e-9


def estimate_start(
    runner: Runner,
    memory: Memory,
    window: Window,
    p: Array,
    weight: Array,
    carried: Array,
    jump: Array | None,
    steps: int = 11,
) -> tuple[Array, bool]:
    """Rig state at the start of a window from its data, by Gauss-Newton with a pull to the carried
    state.

    memory is left untouched. weight: 1/sigma per channel. jump: by what each state may depart from
    the carried value (standard deviation; None or infinite where nothing is known of it: a weak
    pull remains). Returns the state, and whether it is usable.
    """
    own = Runner(runner.assembly, runner.track, runner.stepping, whole=runner.whole)
    y, seen = runner.track.y[window.start : window.stop], runner.track.seen
    if not seen.all():
        weight, y = np.where(seen, weight, 0.0), np.where(seen, y, 0.0)
    known = np.zeros(own.rig_states) if jump is None else 1.0 / jump**2
    problem = _InitialState(own, memory, window, p, y, weight, carried, known)
    begun = problem.at(carried.copy())
    if not np.isfinite(begun.cost):
        return begun.x, False
    return iterate(problem, Iteration(begun, problem.rule.start), steps).point.x, True
