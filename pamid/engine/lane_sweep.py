"""Time integration of several hypotheses side by side: eight lanes of a vector each, group by
group.

The recursion is that of `pamid.engine.integrator`, without sensitivities, and so are the names.
Ticks are shared, and mostly inputs; every other array has the lanes last. Nothing that happens in a
lane reaches another: where a state is no longer finite its lane alone is reported, and goes on
computing what is not read.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pamid.engine.function_calls import borrowed, call
from pamid.engine.integrator import BLOWN_UP, OUTPUTS, PHASES, RATES
from pamid.engine.lane_newton import sdirk2_lanes
from pamid.engine.numba_cache import njit
from pamid.engine.simd import LANES


class LaneEquations(NamedTuple):
    """A model compiled on lanes; all arrays are int64.

    address         of the rates, the outputs and the phases of the cells; for implicit steps, last,
                    of the rates and their partials by the states
    phase_n, phase_first, phase_delay, pointer, columns
                    as in `pamid.engine.integrator.CompiledEquations`
    """

    address: Any
    phase_n: Any
    phase_first: Any
    phase_delay: Any
    pointer: Any
    columns: Any


class LaneArrays(NamedTuple):
    """Carried on from step to step, in place: x (groups, nx, LANES) states; cells, past (groups,
    nc, LANES); buffers (groups, delays, length, LANES) and heads (groups, delays) of the delay
    lines. Without the first axis these are the arrays of a group."""

    x: Any
    cells: Any
    past: Any
    buffers: Any
    heads: Any


class LaneInputs(NamedTuple):
    """u (1, samples, inputs) where all lanes share it, else (groups, samples, inputs * LANES); p
    (groups, parameters and derived ones, LANES). Without the first axis these are a group's."""

    u: Any
    p: Any


class LaneTimes(NamedTuple):
    """begin, join: as in `pamid.engine.integrator.Times`."""

    time_s: float
    period_s: float
    substeps: int
    implicit: bool
    begin: bool
    join: bool


class LaneWindows(NamedTuple):
    """edges (windows + 1): first sample of each window, and the end of the last window; entered
    (windows, n, groups, LANES): the first n states at their starts; dependent: first lane that
    takes over the memory of lane 0 there."""

    edges: Any
    entered: Any
    dependent: int


class LaneResults(NamedTuple):
    """Y (samples, outputs, groups, LANES), ends (windows, nx, groups, LANES), bad (groups, LANES):
    first sample at which a state was no longer finite, or -1."""

    Y: Any
    ends: Any
    bad: Any


class LaneScratch(NamedTuple):
    """Scratch of a sweep; with a last axis of lanes that of
    `pamid.engine.integrator.SweepScratch`, where x0, slope and out are flat.

    worst, left         sizes of Newton's steps, from here and from where the step would lead
    reach               by which a step is shortened
    going, trying       lanes that Newton's method goes on with, that look for a shorter step
    """

    out: Any
    ticks: Any
    x0: Any
    slope: Any
    M: Any
    pivots: Any
    step: Any
    next_step: Any
    before: Any
    base: Any
    worst: Any
    left: Any
    reach: Any
    going: Any
    trying: Any


def lane_scratch(equations, states, outputs, cells):  # type: ignore[no-untyped-def]
    """Scratch for so many states, outputs and cells."""
    width = max(states + len(equations.columns), outputs, cells) + 2
    by_state = [np.zeros((states, LANES)) for _ in range(4)]
    return LaneScratch(
        np.zeros(width * LANES),
        np.zeros(8),
        np.zeros(states * LANES),
        np.zeros(states * LANES),
        np.zeros((states, states, LANES)),
        np.zeros((states, LANES), np.int64),
        *by_state,
        *(np.zeros(LANES) for _ in range(3)),
        *(np.zeros(LANES, np.bool_) for _ in range(2)),
    )


@njit(cache=True)
def _update_cells(equations, memory, u, row, p, work):  # type: ignore[no-untyped-def]
    """All cells at the start of a step, as `pamid.engine.integrator._update_cells` does it."""
    x, c, b = memory.x, memory.cells, memory.past
    buffers, heads, out, t = memory.buffers, memory.heads, work.out, work.ticks
    cells, past = c.ravel(), b.ravel()
    for i in range(cells.shape[0]):
        past[i] = cells[i]
    for phase in range(equations.phase_n.shape[0]):
        n, delay = equations.phase_n[phase], equations.phase_delay[phase]
        call(equations.address[PHASES + phase], x, c, b, u, row, p, t, out)
        at = equations.phase_first[phase] * LANES
        for i in range(n * LANES):
            cells[at + i] = out[i]
        if delay >= 0:
            size = buffers.shape[1]
            head = (heads[delay] + 1) % size
            heads[delay] = head
            for lane in range(LANES):
                pushed = out[n * LANES + lane]
                if t[4] > 0.5:  # before the run the input stood at its first value
                    buffers[delay, :, lane] = pushed
                buffers[delay, head, lane] = pushed
                position = min(max(out[(n + 1) * LANES + lane] / t[1], 0.0), size - 2.0)
                steps = int(position)
                part = position - steps
                near, far = (head - steps) % size, (head - steps - 1) % size
                before, after = buffers[delay, far, lane], buffers[delay, near, lane]
                cells[at + n * LANES + lane] = (1.0 - part) * after + part * before


@njit(cache=True)
def _rk4(equations, memory, u, row, p, h, work):  # type: ignore[no-untyped-def]
    """A step of h in all lanes, as `pamid.engine.integrator._rk4` does it."""
    t, out, x0, acc = work.ticks, work.out, work.x0, work.slope
    x = memory.x.ravel()
    size = x.shape[0]
    begun, share = t[6], h / t[2]
    for i in range(size):
        x0[i] = x[i]
        acc[i] = 0.0
    for stage in range(4):
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        reach = 0.5 * h if stage < 2 else h
        t[7] = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0)
        t[6] = begun + t[7] * share
        call(equations.address[RATES], memory.x, memory.cells, memory.past, u, row, p, t, out)
        for i in range(size):
            acc[i] += weight * out[i]
            x[i] = x0[i] + reach * out[i]
    for i in range(size):
        x[i] = x0[i] + acc[i]


@njit(cache=True)
def _sweep(equations, memory, inputs, times, begin, end, Y, bad, work):  # type: ignore[no-untyped-def]
    """Run a group of lanes over the rows begin .. end of u, as `pamid.engine.integrator.sweep`
    does it; ends where no lane is left."""
    u, p, t, out = inputs.u, inputs.p, work.ticks, work.out
    x = memory.x.ravel()
    nu, ny = u.shape[1], Y.shape[1]
    h = times.period_s / times.substeps
    t[1], t[2] = h, times.period_s
    for k in range(begin, end):
        row = k * nu
        for sub in range(times.substeps):
            first = k == begin and sub == 0
            t[0] = times.time_s + k * times.period_s + sub * h
            t[3] = 1.0 if sub == 0 else 0.0
            t[4] = 1.0 if times.begin and first else 0.0
            t[5] = 1.0 if times.join and first else 0.0
            t[6] = sub / times.substeps
            t[7] = 0.0
            if memory.cells.shape[0] > 0:
                _update_cells(equations, memory, u, row, p, work)
            if sub == 0:
                call(
                    equations.address[OUTPUTS],
                    memory.x,
                    memory.cells,
                    memory.past,
                    u,
                    row,
                    p,
                    t,
                    out,
                )
                for i in range(ny):
                    for lane in range(LANES):
                        Y[k, i, lane] = out[i * LANES + lane]
            if times.implicit:
                sdirk2_lanes(equations, memory, u, row, p, h, bad, work)
            else:
                _rk4(equations, memory, u, row, p, h, work)
        lost = 0
        for i in range(x.shape[0]):
            # A sum in place of an early exit lets the loop run in vectors. The comparison is also
            # false for NaN.
            lost += 0 if abs(x[i]) < BLOWN_UP else 1
        if lost > 0 and _note_lost(memory.x, k, bad):
            return


@njit(cache=True)
def _note_lost(x, k, bad):  # type: ignore[no-untyped-def]
    """Note the lanes that sample k has left without a finite state; is none left?"""
    left = 0
    for lane in range(LANES):
        for i in range(x.shape[0]):
            if bad[lane] < 0 and not abs(x[i, lane]) < BLOWN_UP:
                bad[lane] = k
        left += bad[lane] < 0
    return left == 0


@njit(cache=True)
def _group(memory, g):  # type: ignore[no-untyped-def]
    return borrowed(
        LaneArrays(memory.x[g], memory.cells[g], memory.past[g], memory.buffers[g], memory.heads[g])
    )


@njit(cache=True, nogil=True)
def sweep_lanes(equations, memory, inputs, times, windows, results, work):  # type: ignore[no-untyped-def]
    """Run over all windows, filling Y, ends and bad; memory is carried on in place.

    It ends early where lane 0 is lost and others depend on it, or where no lane is left.
    """
    edges, entered, dependent = windows
    Y, ends, bad = results
    groups, nx, n = memory.x.shape[0], memory.x.shape[1], entered.shape[1]
    equations, work = borrowed(equations), borrowed(work)
    for w in range(edges.shape[0] - 1):
        if w > 0:
            # the memory of lane 0, behind the first n states, for the lanes from `dependent` on
            for g in range(groups):
                for lane in range(max(0, dependent - g * LANES), LANES):
                    memory.x[g, n:, lane] = memory.x[0, n:, 0]
                    memory.cells[g, :, lane] = memory.cells[0, :, 0]
                    memory.past[g, :, lane] = memory.past[0, :, 0]
                    memory.buffers[g, :, :, lane] = memory.buffers[0, :, :, 0]
        now = LaneTimes(
            times.time_s,
            times.period_s,
            times.substeps,
            times.implicit,
            times.begin and w == 0,
            times.join or w > 0,
        )
        left = False
        for g in range(groups):
            part = _group(memory, g)
            for i in range(n):
                for lane in range(LANES):
                    part.x[i, lane] = entered[w, i, g, lane]
            mine = borrowed(LaneInputs(inputs.u[min(g, inputs.u.shape[0] - 1)], inputs.p[g]))
            begin, end = edges[w], edges[w + 1]
            outputs, lost = borrowed((Y[:, :, g], bad[g]))
            _sweep(equations, part, mine, now, begin, end, outputs, lost, work)
            for i in range(nx):
                for lane in range(LANES):
                    ends[w, i, g, lane] = part.x[i, lane] if bad[g, lane] < 0 else np.nan
            for lane in range(LANES):
                left = left or bad[g, lane] < 0
        if not left or (bad[0, 0] >= 0 and dependent < groups * LANES):
            ends[w + 1 :] = np.nan
            Y[edges[w + 1] :] = np.nan
            break
    for g in range(groups):
        for lane in range(LANES):
            if bad[g, lane] >= 0:
                Y[bad[g, lane] + 1 :, :, g, lane] = np.nan


@njit(cache=True, nogil=True)
def prepare_lanes(address, p, first):  # type: ignore[no-untyped-def]
    """Fill the rows of p (groups, rows, LANES) from `first` on, which depend on those before."""
    for g in range(p.shape[0]):
        q = p[g]
        call(address, q, q, q, q, 0, q, q, q[first:])


@njit(cache=True, nogil=True)
def rate_matrices(equations, memory, inputs, times, work):  # type: ignore[no-untyped-def]
    """df/dx of all lanes (nx, nx, groups, LANES) where `memory` stands, at the first row of u."""
    groups, nx, t = memory.x.shape[0], memory.x.shape[1], work.ticks
    t[:] = 0.0
    t[0], t[1], t[2], t[3] = times.time_s, times.period_s, times.period_s, 1.0
    M = np.zeros((nx, nx, groups, LANES))
    for g in range(groups):
        u, p = inputs.u[min(g, inputs.u.shape[0] - 1)], inputs.p[g]
        x, c, b = memory.x[g], memory.cells[g], memory.past[g]
        call(equations.address[-1], x, c, b, u, 0, p, t, work.out)
        for i in range(nx):
            for e in range(equations.pointer[i], equations.pointer[i + 1]):
                for lane in range(LANES):
                    M[i, equations.columns[e], g, lane] = work.out[(nx + e) * LANES + lane]
    return M
