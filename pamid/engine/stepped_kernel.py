"""Compiled loop of a stepped program.

An exchange is that of `pamid.engine.stepped`, with slopes by differences over copies
(`pamid.engine.stepped.slopes_of`), or known slopes (`pamid.engine.known_slopes`). The copies are
a single structure of the simulator, set anew for each of them. numba takes its cache of this file's
functions for stale by the stamp of this file alone: touch it where `sweep` takes other arguments.

Arguments: c, w, t are a `LibraryStep`, `StepScales` and `KnownSlopes`; e is an `Exchange` of
these.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pamid.engine.function_calls import call_pair, number_at, put_number
from pamid.engine.integrator import BLOWN_UP, Inputs, Times, sweep
from pamid.engine.numba_cache import njit
from pamid.engine.simulator import PROBED, THIN

SIDES_AGREE = 0.1  # of a step's action: curvature leaves 1e-6 of it, a jump ten times as much
SLOPE_ROUNDING = 1e-9  # of a value's size: rounding error of a slope by differences
STILL_HOLDS = 0.1  # of a step's action: a change within which slopes hold
FAR = 0.3  # of a parameter: at rest, nothing else shows that it has moved


class Exchange(NamedTuple):
    """Arguments of an exchange with a simulator: its step, the widths of its differences, and the
    slopes known along the recording."""

    step: Any
    scales: Any
    known: Any


@njit(cache=True)
def _advance(c, model, x, f, after):  # type: ignore[no-untyped-def]
    """Readings and states after an exchange from moved values x, f, with the model at an
    address."""
    # Numbers left of the exchange before, such as a warm start, would make copies depend on the
    # order in which they run.
    for i in range(c.cleared_at.shape[0]):
        put_number(c.cleared_at[i], 0.0)
    for i in range(x.shape[0]):
        put_number(c.state_at[i], x[i])
    for i in range(f.shape[0]):
        put_number(c.force_at[i], f[i])
    for _ in range(c.repeats):
        call_pair(c.step, model, c.data)
    readings = c.reading_at.shape[0]
    for i in range(readings):
        after[i] = number_at(c.reading_at[i])
    for i in range(x.shape[0]):
        after[readings + i] = number_at(c.state_at[i])


@njit(cache=True)
def _step(c, x, f, after):  # type: ignore[no-untyped-def]
    """Readings and states after the exchange itself, from x under f."""
    if c.leads_at:
        put_number(c.leads_at, 1.0)
    _advance(c, c.models[0], x, f, after)
    if c.leads_at:
        put_number(c.leads_at, 0.0)


@njit(cache=True)
def _in_reach(w, t, row, f):  # type: ignore[no-untyped-def]
    """Whether the row has slopes by every force and parameter that moved, none of them far."""
    if not t.filled[row]:
        return False
    for k in range(f.shape[0]):
        if f[k] != t.f[row, k] and not t.pushed[row, k]:
            return False
    for i in range(w.p.shape[0]):
        dp = abs(w.p[i] - t.p[row, i])
        if dp > FAR * abs(t.p[row, i]):
            return False
        if dp != 0.0:
            chosen = False
            for k in range(t.chosen.shape[0]):
                chosen = chosen or t.chosen[k] == i
            if not chosen:
                return False
    return True


@njit(cache=True)
def _difference(w, t, x, f, before, dz):  # type: ignore[no-untyped-def]
    """Fill dz (states + forces + chosen parameters): from `before`, a tuple of states, forces and
    parameters, to x under f."""
    nx, nf, (x0, f0, p0) = x.shape[0], f.shape[0], before
    for i in range(nx):
        dz[i] = x[i] - x0[i]
    for i in range(nf):
        dz[nx + i] = f[i] - f0[i]
    for i in range(t.chosen.shape[0]):
        dz[nx + nf + i] = w.p[t.chosen[i]] - p0[t.chosen[i]]


@njit(cache=True)
def _linear_change(w, t, row, j, dz):  # type: ignore[no-untyped-def]
    """Change of the j-th value by the slopes of a row, and the change of its action."""
    shift, differently, diagonal = 0.0, 0.0, j - w.level.shape[0] + t.x.shape[1]
    for i in range(dz.shape[0]):
        slope = t.slopes[row, j, i]
        shift += slope * dz[i]
        differently += abs((slope - 1.0 if i == diagonal else slope) * dz[i])
    return shift, differently


@njit(cache=True)
def _larger_in_levels(most, size, level):  # type: ignore[no-untyped-def]
    """The larger of `most` and the size in levels; infinite for a value without a level that is not
    zero."""
    if size == 0.0:
        return most
    return max(most, size / level if level > 0.0 else np.inf)


@njit(cache=True)
def _distance(w, t, row, dz):  # type: ignore[no-untyped-def]
    """Largest change of the action, in levels."""
    largest = 0.0
    for j in range(w.level.shape[0]):
        largest = _larger_in_levels(largest, _linear_change(w, t, row, j, dz)[1], w.level[j])
    return largest


@njit(cache=True)
def _predict(w, t, row, x, f, after):  # type: ignore[no-untyped-def]
    """Fill `after` with the predicted step from x under f; False beyond the checked distance."""
    if t.prediction_limit == 0.0 or not _in_reach(w, t, row, f):
        return False
    dz, nx, at = np.empty(t.slopes.shape[2]), x.shape[0], x.shape[0] + f.shape[0]
    last = t.last[row]
    _difference(w, t, x, f, (last[:nx], last[nx:at], last[at:]), dz)
    way = _distance(w, t, row, dz)
    base, reach, bend = t.trust[row, 0], t.trust[row, 1], t.trust[row, 2]
    # NaN fails the comparison
    near = way == 0.0 or bend * (2.0 * base + way) * way <= t.prediction_limit
    if not (near and way <= reach):
        return False
    for j in range(after.shape[0]):
        after[j] = t.last_after[row, j] + _linear_change(w, t, row, j, dz)[0]
    return True


@njit(cache=True)
def _check(w, t, row, x, f, plain):  # type: ignore[no-untyped-def]
    """Compare a step to `plain` that was made with its prediction, and update the trust."""
    if t.prediction_limit == 0.0 or not _in_reach(w, t, row, f):
        return
    dz, nx, at = np.empty(t.slopes.shape[2]), x.shape[0], x.shape[0] + f.shape[0]
    last = t.last[row]
    _difference(w, t, x, f, (last[:nx], last[nx:at], last[at:]), dz)
    way, base = _distance(w, t, row, dz), t.trust[row, 0]
    if 0.0 < way < np.inf:
        missed = 0.0
        for j in range(plain.shape[0]):
            off = abs(plain[j] - t.last_after[row, j] - _linear_change(w, t, row, j, dz)[0])
            missed = _larger_in_levels(missed, off, w.level[j])
        t.trust[row, 1] = way
        t.trust[row, 2] = missed / ((2.0 * base + way) * way)
    last[:nx] = x
    last[nx:at] = f
    last[at:] = w.p
    t.last_after[row] = plain
    _difference(w, t, x, f, (t.x[row], t.f[row], t.p[row]), dz)
    t.trust[row, 0] = _distance(w, t, row, dz)


@njit(cache=True)
def _hold(w, t, row, x, f, plain):  # type: ignore[no-untyped-def]
    """Whether the slopes by states and forces, and those by parameters, hold without a probe for a
    step from x under f to `plain`."""
    if not _in_reach(w, t, row, f):
        return False, False
    dz, acts = np.empty(t.slopes.shape[2]), True
    _difference(w, t, x, f, (t.x[row], t.f[row], t.p[row]), dz)
    readings = plain.shape[0] - x.shape[0]
    for j in range(plain.shape[0]):
        tiny = SLOPE_ROUNDING * (abs(plain[j]) + w.level[j])
        change = plain[j] - t.after[row, j]
        shift, differently = _linear_change(w, t, row, j, dz)
        # NaN fails the comparison
        if not abs(change - shift) <= STILL_HOLDS * differently + tiny:
            return False, False
        moved = dz[j - readings] if j >= readings else 0.0
        if not abs(change - moved) <= STILL_HOLDS * w.level[j] + tiny:
            acts = False
    return True, acts or t.chosen.shape[0] == 0


@njit(cache=True)
def _keep(w, t, row, x, f, plain):  # type: ignore[no-untyped-def]
    """Store the slopes of a row. The limits of trust stay."""
    nx, at = x.shape[0], x.shape[0] + f.shape[0]
    t.x[row] = x
    t.f[row] = f
    t.p[row] = w.p
    t.after[row] = plain
    t.last[row, :nx] = x
    t.last[row, nx:at] = f
    t.last[row, at:] = w.p
    t.last_after[row] = plain
    if not t.filled[row]:
        t.trust[row, 1] = 0.0
        t.trust[row, 2] = np.inf
    t.trust[row, 0] = 0.0
    t.filled[row] = True


@njit(cache=True)
def _forward_differences(c, x, f, steps, models, plain, slopes):  # type: ignore[no-untyped-def]
    """Fill columns of `slopes` (values, states + forces + moved parameters) by differences over
    these steps, where they are not zero; models: addresses, each with a parameter moved."""
    nx, nf = x.shape[0], f.shape[0]
    moved = np.empty(plain.shape[0])
    for i in range(steps.shape[0]):
        if steps[i] == 0.0:
            continue
        if i < nx + nf:
            at, k = (x, i) if i < nx else (f, i - nx)
            value = at[k]
            at[k] = value + steps[i]
            _advance(c, c.models[0], x, f, moved)
            at[k] = value
        else:
            _advance(c, models[i - nx - nf], x, f, moved)
        slopes[:, i] = (moved - plain) / steps[i]


@njit(cache=True)
def _agree(c, model, x, f, steps, plain, slopes):  # type: ignore[no-untyped-def]
    """Whether slopes predict the step with everything moved to the other side. model: with moved
    parameters."""
    nx, at = x.shape[0], x.shape[0] + f.shape[0]
    moved, readings = np.empty(plain.shape[0]), plain.shape[0] - nx
    _advance(c, model, x - steps[:nx], f - steps[nx:at], moved)
    for j in range(plain.shape[0]):
        predicted, differently = plain[j], 0.0
        for i in range(steps.shape[0]):
            predicted -= slopes[j, i] * steps[i]
            diagonal = i == j - readings
            differently += abs((slopes[j, i] - 1.0 if diagonal else slopes[j, i]) * steps[i])
        # NaN fails the comparison
        if not abs(moved[j] - predicted) <= SIDES_AGREE * differently + SLOPE_ROUNDING * abs(
            plain[j]
        ):
            return False
    return True


@njit(cache=True)
def _slopes(c, w, x, f, steps, plain, slopes):  # type: ignore[no-untyped-def]
    """Fill columns of `slopes` as `pamid.engine.stepped.slopes_of` does, where these steps of a
    difference are not zero."""
    at, n = x.shape[0] + f.shape[0], w.place.shape[0]
    _forward_differences(c, x, f, steps, c.models[1 : 1 + n], plain, slopes)
    moved = 0
    for k in range(n):
        moved += steps[at + k] != 0.0
    # a model with all parameters moved down probes all of them together
    some = 0 < moved < n
    if not some and _agree(c, c.models[1 + n if moved else 0], x, f, steps, plain, slopes):
        return
    other = slopes.copy()
    _forward_differences(c, x, f, -THIN * steps, c.models[2 + n :], plain, other)
    for j in range(plain.shape[0]):
        for i in range(slopes.shape[1]):
            still = 1.0 if i == j - plain.shape[0] + x.shape[0] else 0.0
            if abs(other[j, i] - still) < abs(slopes[j, i] - still):
                slopes[j, i] = other[j, i]


@njit(cache=True)
def _probed(e, row, x, f, steps, plain, moves):  # type: ignore[no-untyped-def]
    """Work out slopes of a row anew that are in doubt and fail a probe; were there any? moves: only
    those by parameters are in doubt."""
    c, w, t = e
    at, slopes, far = x.shape[0] + f.shape[0], t.slopes[row], np.zeros(steps.shape[0], np.bool_)
    # Slopes scale with their parameters, unless these have moved too far.
    for k in range(t.chosen.shape[0]):
        before, now = t.p[row, t.chosen[k]], w.p[t.chosen[k]]
        far[at + k] = abs(now - before) > FAR * abs(before)
        if before != now and now != 0.0:
            for j in range(slopes.shape[0]):
                slopes[j, at + k] *= before / now
    motion, parameters = steps.copy(), steps.copy()
    motion[at:] = 0.0
    parameters[:at] = 0.0
    if not (moves or _agree(c, c.models[0], x, f, PROBED * motion, plain, slopes)):
        _slopes(c, w, x, f, steps, plain, slopes)
        return True
    anew = bool(far.any())
    if anew:
        _slopes(c, w, x, f, np.where(far, steps, 0.0), plain, slopes)
    if parameters.shape[0] > at and not _agree(
        c, c.models[-1], x, f, PROBED * parameters, plain, slopes
    ):
        _slopes(c, w, x, f, parameters, plain, slopes)
        anew = True
    return anew


@njit(cache=True)
def _known_or_new_slopes(e, row, x, f, pushed, steps, plain):  # type: ignore[no-untyped-def]
    """Provide slopes of a row for a step from x under f, and fill `plain` with its result. pushed
    (forces,): forces with slopes; steps: widths of all differences."""
    c, w, t = e
    nx, nf, known = x.shape[0], f.shape[0], t.filled[row]
    lacking = np.zeros(steps.shape[0])
    for k in range(nf):
        wanted = pushed[k] or t.pushed[row, k] or (known and f[k] != t.f[row, k])
        if not wanted:
            steps[nx + k] = 0.0
        elif known and not t.pushed[row, k]:
            lacking[nx + k] = steps[nx + k]
        t.pushed[row, k] = wanted
    if not known:
        _step(c, x, f, plain)
        t.slopes[row] = 0.0
        _slopes(c, w, x, f, steps, plain, t.slopes[row])
        t.counts[0] += 1
        _keep(w, t, row, x, f, plain)
        return
    if lacking.any():
        _step(c, x, f, plain)
        _slopes(c, w, x, f, lacking, plain, t.slopes[row])
    predicted = _predict(w, t, row, x, f, plain)
    if not predicted:
        _step(c, x, f, plain)
        _check(w, t, row, x, f, plain)
    moves, acts = _hold(w, t, row, x, f, plain)
    if acts:
        t.counts[1] += 1
        t.counts[2] += predicted
        return
    if predicted:
        _step(c, x, f, plain)
    anew = _probed(e, row, x, f, steps, plain, moves)
    t.counts[0 if anew else 1] += 1
    _keep(w, t, row, x, f, plain)


@njit(cache=True)
def _widths(w, x, f):  # type: ignore[no-untyped-def]
    """Widths of all differences (states + forces + moved parameters,)."""
    nx, at = x.shape[0], x.shape[0] + f.shape[0]
    steps = np.empty(at + w.moved_by.shape[0])
    for i in range(nx):
        steps[i] = w.difference * max(abs(x[i]), w.state_size[i])
    for k in range(f.shape[0]):
        steps[nx + k] = w.difference * max(abs(f[k]), w.force_size[k])
    steps[at:] = w.moved_by
    return steps


@njit(cache=True)
def step_slopes(c, w, x, f, pushed, after, slopes):  # type: ignore[no-untyped-def]
    """Fill `after` with readings and states after a step from x under f, and the columns of
    `slopes` by states, pushed forces and moved parameters."""
    steps = _widths(w, x, f)
    steps[x.shape[0] : x.shape[0] + f.shape[0]] *= pushed
    _step(c, x, f, after)
    _slopes(c, w, x, f, steps, after, slopes)


@njit(cache=True)
def _exchange(e, row, values, f, by, S, sensitive):  # type: ignore[no-untyped-def]
    """Move `values` (readings and states,) and, on request, their rows of S (all in place) over
    an exchange under f (forces,), whose sensitivities are `by` (forces, columns)."""
    c, w, t = e
    readings, seen = c.reading_at.shape[0], values.shape[0]
    x = values[readings:]
    nx, nf, wide, n = x.shape[0], f.shape[0], S.shape[1], w.place.shape[0]
    plain, keep = np.empty(seen), t.filled.shape[0] > 0
    if not sensitive:
        if keep and _predict(w, t, row, x, f, plain):
            t.counts[2] += 1
        else:
            _step(c, x, f, plain)
            if keep:
                _check(w, t, row, x, f, plain)
        values[:] = plain
        return
    pushed = np.zeros(nf, np.bool_)
    for k in range(nf):
        pushed[k] = by[k].any()
    if keep:
        slopes = t.slopes[row]
        _known_or_new_slopes(e, row, x, f, pushed, _widths(w, x, f), plain)
    else:
        slopes = np.zeros((seen, nx + nf + n))
        step_slopes(c, w, x, f, pushed, plain, slopes)
    # A new array, because every row of S is needed until the last product has been taken.
    rows = np.zeros((seen, wide))
    for i in range(nx + nf):
        for j in range(seen):
            slope = slopes[j, i]
            # Most readings depend on few states, and a row of S may have hundreds of columns.
            if slope == 0.0:
                continue
            for m in range(wide):
                rows[j, m] += slope * (S[readings + i, m] if i < nx else by[i - nx, m])
    for k in range(n):
        # in proportion to the parameter they stay as they are
        share = 1.0
        if keep and t.p[row, t.chosen[k]] != w.p[t.chosen[k]] and w.p[t.chosen[k]] != 0.0:
            share = t.p[row, t.chosen[k]] / w.p[t.chosen[k]]
        for j in range(seen):
            rows[j, w.place[k]] += share * slopes[j, nx + nf + k]
    S[:seen] = rows
    values[:] = plain


@njit(cache=True)
def stepped_sweep(equations, memory, inputs, times, results, e, made):  # type: ignore[no-untyped-def]
    """Run over the rows of u, filling `made`: Y (samples, seen) and, with sensitivities, JY
    (samples, seen, columns). `results` hold a sample, with what goes into the simulator behind what
    is seen. Memory is carried on in place; readings and states of the simulator are the first in
    it. Returns the first sample at which a state is no longer finite, or -1."""
    c, Y, JY = e.step, made[0], made[1]
    inside = c.reading_at.shape[0] + c.state_at.shape[0]
    seen, sensitive = Y.shape[1], inputs.sensitive
    begin, join = times.begin, times.join
    f = np.empty(c.force_at.shape[0])
    x, S = memory.x, memory.S
    for k in range(inputs.u.shape[0]):
        sample_inputs = Inputs(inputs.u[k : k + 1], inputs.p, inputs.column, inputs.sensitive)
        for sub in range(times.substeps):
            now = Times(
                times.time_s + k * times.period_s,
                times.period_s,
                times.substeps,
                times.implicit,
                begin,
                join,
                sub,
            )
            sweep(equations, memory, sample_inputs, now, results)
            begin = False
            join = False
            if sub == 0:
                Y[k] = results.Y[0, :seen]
                if sensitive:
                    JY[k] = results.JY[0, :seen]
            f[:] = results.Y[0, seen:]
            row = k * times.substeps + sub
            _exchange(e, row, x[:inside], f, results.JY[0, seen:], S, sensitive)
        for i in range(x.shape[0]):
            if not abs(x[i]) < BLOWN_UP:
                Y[k + 1 :] = np.nan
                if sensitive:
                    JY[k + 1 :] = np.nan
                return k
    return -1
