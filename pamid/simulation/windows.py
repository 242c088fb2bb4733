"""Tracks cut into windows, and a window simulated from a start state with its sensitivities: the
common part of multiple shooting, replays and smoothing.

The rig's states are set anew at the start of each window. Memories of effects (plays, lags,
creep) are carried on from the window before, because no window by itself shows them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Memory, SimulatedWindow, Stepping, WindowStarts
from pamid.model.assembly import Assembly
from pamid.simulation.tracks import Track


@dataclass(frozen=True)
class Window:
    start: int
    stop: int


def cut(samples: int, length: int) -> list[Window]:
    """Windows of about `length` samples that cover everything; the last takes the rest."""
    count = max(1, round(samples / length))
    edges = np.linspace(0, samples, count + 1).round().astype(int)
    return [Window(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]


@dataclass(frozen=True, eq=False)
class Runner:
    """Runs windows of a track with given parameters.

    free: places of the parameters that get sensitivity columns; after them come the rig's states
    at the window's start, so a Jacobian has len(free) + rig_states columns; known: slopes of
    a stepped rig's exchanges along the track, where they are kept from run to run.
    """

    assembly: Assembly
    track: Track
    stepping: Stepping
    free: tuple[int, ...] = ()
    all_states: bool = False  # set anew the effects' states, too
    known: KnownSlopes | None = None

    @cached_property
    def start_states(self) -> int:
        return len(self.assembly.program.states if self.all_states else self.assembly.rig.states)

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        chosen = np.full(len(self.assembly.parameters), -1, np.int64)
        for column, place in enumerate(self.free):
            if place not in self.track.known:
                chosen[place] = column
        return chosen

    def keeping(self, other: KnownSlopes | None = None) -> Runner:
        """The same, keeping slopes from run to run, where there are any to keep; other: that were
        kept along this track before, from which these begin."""
        program = self.assembly.program
        room = program.room(len(self.track), self.stepping.substeps, self.columns)
        if room is None:
            return self
        return replace(self, known=other.copy() if other and other.fits(room) else room)

    def parameters(self, p: Array) -> Array:
        """p with the known values of this recording."""
        out = p.copy()
        out[list(self.track.known)] = self.track.p[list(self.track.known)]
        return out

    def memory(self, p: Array) -> Memory:
        return self.assembly.program.memory(
            self.assembly.start(p),
            len(self.free) + self.start_states,
            stepping=self.stepping,
            period_s=self.track.period_s,
        )

    def widened(self, memory: Memory) -> Memory:
        """A copy of another run's memory with this runner's (empty) sensitivities."""
        fresh = self.assembly.program.memory(
            memory.x,
            len(self.free) + self.start_states,
            stepping=self.stepping,
            period_s=self.track.period_s,
        )
        wide = replace(memory.copy(), S=fresh.S, buffer_S=fresh.buffer_S)
        wide.forget(0)
        return wide

    def enter(self, memory: Memory, x: Array) -> None:
        """Start a window at state x (start states,)."""
        memory.enter(x, len(self.free))

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
        program = self.assembly.program
        if self.known is not None:
            program = program.with_slopes(self.known.part(window.start, window.stop))
        Y, J, bad = program.run(
            memory,
            self.track.inputs.part(window.start, window.stop),
            p,
            stepping=self.stepping,
            columns=self.columns if sensitivities else None,
            weights=weights,
        )
        return (
            Y,
            J.reshape(J.shape[0] * J.shape[1], J.shape[2]),
            bad < 0 and bool(np.isfinite(Y).all()),
        )

    def run_windows(
        self,
        memory: Memory,
        windows: Sequence[Window],
        starts: Array,
        p: Array,
        sensitivities: bool,
        weights: Array | None = None,
    ) -> Iterator[SimulatedWindow]:
        """The windows in order, each from its start (windows x start states); Jacobians as those
        of `run`. See `Program.run_windows` for the memory between two of them."""
        t, program = self.track, self.assembly.program
        if self.known is not None:
            program = program.with_slopes(self.known)
        return program.run_windows(
            memory,
            t.inputs,
            p,
            window_starts(t, windows, starts, len(self.free)),
            stepping=self.stepping,
            columns=self.columns if sensitivities else None,
            weights=weights,
        )


def window_starts(
    track: Track, windows: Sequence[Window], starts: Array, column: int = 0
) -> WindowStarts:
    """Windows of a track with the states at their starts (windows x states); column: of the first
    of these among the sensitivities."""
    edges = np.array([(w.start, w.stop) for w in windows], np.int64).reshape(-1, 2)
    return WindowStarts(edges, starts, column)
