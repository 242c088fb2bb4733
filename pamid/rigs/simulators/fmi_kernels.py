"""Calls of an FMU's functions from compiled code, at every sample.

Every function returns a status: that of the FMU (2 and above: failure), or any of those below. The
index of the failing function is in `report[0]`. C ignores surplus arguments, so that the same call
serves FMI 2.0 and 3.0 if their arguments begin alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.function_calls import call_foreign
from pamid.engine.numba_cache import carray, cfunc, njit, types

Places = NDArray[np.uint32]

# names of the functions in FMI 2.0 and 3.0, by their place
SET, GET, STEP, SAVE, RESTORE, TIME, PUT_X, GET_X, RATES, INDICATORS, EVENT, DISCRETE = range(12)
CONTINUOUS, COMPLETED = 12, 13
NAMES = {
    2: "SetReal GetReal DoStep GetFMUstate SetFMUstate SetTime SetContinuousStates "
    "GetContinuousStates GetDerivatives GetEventIndicators EnterEventMode NewDiscreteStates "
    "EnterContinuousTimeMode CompletedIntegratorStep",
    3: "SetFloat64 GetFloat64 DoStep GetFMUState SetFMUState SetTime SetContinuousStates "
    "GetContinuousStates GetContinuousStateDerivatives GetEventIndicators EnterEventMode "
    "UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep",
}

# statuses of this file
ENDED, RESTLESS, STIFF, CROWDED, NO_NUMBERS = -1, -2, -3, -4, -5
SAID = {
    ENDED: "it ended the simulation itself",
    RESTLESS: "its events do not come to rest: it asks for one event iteration after another",
    STIFF: "its equations need too short steps for an explicit method; export it for "
    "co-simulation, with a solver of its own",
    NO_NUMBERS: "its derivatives are not finite",
    CROWDED: "its events follow each other too closely",
}
FAILED_FROM = 2  # statuses of an FMU: 0 in order, 1 a warning, then discard, error, fatal

ROUNDING = 1e-9  # of an exchange: rounding errors of summed times are smaller
MOST_ITERATIONS = 100
MOST_EVENTS = 1000  # in an exchange
MOST_STEPS = 4096  # in an exchange
BISECTIONS = 40  # of a step, to find where an indicator changes its sign
STEP_TOLERANCE = 1e-8  # of a state's size, per step
SAFETY, MOST_GROWTH, LEAST_SHRINKAGE = 0.9, 5.0, 0.2


class UnitScale(NamedTuple):
    """Conversion from an FMU's units to SI: value * scale + offset."""

    scale: Array
    offset: Array

    def outside(self, values: Array) -> Array:
        scaled: Array = (values - self.offset) / self.scale
        return scaled

    def inside(self, values: Array) -> Array:
        scaled: Array = values * self.scale + self.offset
        return scaled


class FmuUnits(NamedTuple):
    inputs: UnitScale
    outputs: UnitScale
    parameters: UnitScale
    states: UnitScale


class FmiModel(NamedTuple):
    """An FMU for compiled code.

    at: addresses of the functions of NAMES; exchanges: True for model exchange; report: words that
    return from compiled code. The remaining fields are value references, the number of event
    indicators, and typical sizes of states.
    """

    at: NDArray[np.int64]
    version: int
    exchanges: bool
    inputs: Places
    outputs: Places
    states: Places
    rates: Places
    indicators: int
    sizes: Array
    report: NDArray[np.int64]


@njit(cache=True)
def _failed(m: FmiModel, status: int, place: int) -> int:
    """0 after success; else the status, with the index of the called function noted."""
    if status < FAILED_FROM:
        return 0
    m.report[0] = place
    return status


@njit(cache=True)
def put_inputs(m: FmiModel, c: int, f: Array) -> int:
    n = len(m.inputs)
    return _failed(m, call_foreign(m.at[SET], c, m.inputs, n, f, n), SET)


@njit(cache=True)
def get_outputs(m: FmiModel, c: int, y: Array) -> int:
    n = len(m.outputs)
    return _failed(m, call_foreign(m.at[GET], c, m.outputs, n, y, n), GET)


@njit(cache=True)
def do_step(m: FmiModel, c: int, t: float, h: float) -> int:
    flags, last = np.zeros(3, np.int64), np.array([t + h])
    status = call_foreign(m.at[STEP], c, t, h, 1, flags[0:1], flags[1:2], flags[2:3], last)
    status = _failed(m, status, STEP)
    if status == 0 and m.version == 3 and (flags[1] or last[0] < t + h - 1e-9 * h):
        return ENDED
    return status


# ---- model exchange ------------------------------------------------------------------------------


@njit(cache=True)
def settle(m: FmiModel, c: int, inside: bool, due: Array) -> int:
    """Iterate events until nothing changes, then enter continuous time.

    inside: True if the instance is in event mode already; due: (1,) time of the next event,
    overwritten, infinite if unknown. m.report[1] is 1 if states changed.
    """
    status = 0
    if not inside:
        status = _failed(m, call_foreign(m.at[EVENT], c), EVENT)
    info = np.zeros(4)
    flags, changed = info.view(np.int32), 0
    for _ in range(MOST_ITERATIONS):
        if status != 0:
            return status
        info[:] = 0.0
        if m.version == 2:
            status = call_foreign(m.at[DISCRETE], c, info)
        else:
            status = call_foreign(
                m.at[DISCRETE],
                *(c, flags[0:1], flags[1:2], flags[2:3], flags[3:4], flags[4:5], info[3:4]),
            )
        status = _failed(m, status, DISCRETE)
        changed |= flags[3]
        if status == 0 and flags[1]:
            return ENDED
        if status == 0 and not flags[0]:
            due[0] = info[3] if flags[4] else np.inf
            m.report[1] = changed
            return _failed(m, call_foreign(m.at[CONTINUOUS], c), CONTINUOUS)
    return RESTLESS


@njit(cache=True)
def stand(m: FmiModel, c: int, t: float, x: Array) -> int:
    """Set time and states of the instance."""
    status = _failed(m, call_foreign(m.at[TIME], c, t), TIME)
    if status == 0 and len(x):
        status = _failed(m, call_foreign(m.at[PUT_X], c, x, len(x)), PUT_X)
    return status


@njit(cache=True)
def rates_at(m: FmiModel, c: int, t: float, x: Array, dx: Array) -> int:
    status = stand(m, c, t, x)
    if status == 0 and len(x):
        status = _failed(m, call_foreign(m.at[RATES], c, dx, len(x)), RATES)
    return status


@njit(cache=True)
def indicators_at(m: FmiModel, c: int, z: Array) -> int:
    if m.indicators == 0:
        return 0
    return _failed(m, call_foreign(m.at[INDICATORS], c, z, m.indicators), INDICATORS)


# Dormand and Prince (1980), J. Comput. Appl. Math. 6(1), 19-26: orders 5 and 4
_C = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array(
    [
        *(71 / 57600, 0.0, -71 / 16695, 71 / 1920),
        *(-17253 / 339200, 22 / 525, -1 / 40),
    ]
)


@njit(cache=True)
def _try_step(
    m: FmiModel, c: int, t: float, x: Array, dt: float, xn: Array, err: Array, K: Array
) -> int:
    """Try a step of dt from x, into xn.

    err (1): its error, in tolerances; K (7, states): scratch. The instance then stands at the
    step's end.
    """
    nx = len(x)
    for i in range(7):
        xn[:] = x
        for j in range(i):
            for k in range(nx):
                xn[k] += dt * _A[i, j] * K[j, k]
        status = rates_at(m, c, t + _C[i] * dt, xn, K[i])
        if status != 0:
            return status
    worst = 0.0
    for k in range(nx):
        e = 0.0
        for i in range(7):
            e += _E[i] * K[i, k]
        scale = max(m.sizes[k], abs(x[k]), abs(xn[k]))
        part = abs(dt * e) / (STEP_TOLERANCE * scale)
        worst = part if not part <= worst else worst
    err[0] = worst
    return 0


@njit(cache=True)
def _crosses_event(before: Array, after: Array) -> bool:
    return bool(((before > 0.0) != (after > 0.0)).any())


@njit(cache=True)
def _locate_event(
    m: FmiModel, c: int, t: float, x: Array, dt: float, z: Array, xn: Array
) -> tuple[int, float]:
    """Shortest step from x after which an indicator has changed its sign, to a trillionth of dt.

    xn is its end, and the instance stands there.
    """
    low, high = 0.0, dt
    err, now, K = np.zeros(1), np.zeros(len(z)), np.zeros((7, len(x)))
    for k in range(BISECTIONS + 1):
        middle = 0.5 * (low + high) if k < BISECTIONS else high
        status = _try_step(m, c, t, x, middle, xn, err, K)
        if status == 0:
            status = indicators_at(m, c, now)
        if status != 0:
            return status, high
        if _crosses_event(z, now):
            high = middle
        else:
            low = middle
    return 0, high


@njit(cache=True)
def exchange(
    m: FmiModel,
    c: int,
    begin: float,
    h: float,
    f: Array,
    x: Array,
    due: Array,
    grid: Array,
) -> int:
    """Advance the states x by h seconds from `begin` under the inputs f.

    due: (1,) time of the next event, overwritten; grid: ends of the steps from `begin`, up to a
    zero. If it begins with a zero, the steps are chosen, and noted there. m.report[2] is the number
    of events within.
    """
    # an event between two exchanges belongs to the later exchange, so that it gets the new inputs
    near = ROUNDING * h
    first = due[0] if abs(due[0] - begin) <= near else begin
    status = change_inputs(m, c, first, f, x, due)
    m.report[2] = 0
    z, after = np.zeros(m.indicators), np.zeros(m.indicators)
    xn, err, K = np.zeros(len(x)), np.zeros(1), np.zeros((7, len(x)))
    status = status or indicators_at(m, c, z)
    follows, at, step, count = grid[0] > 0.0, 0.0, h, 0
    while status == 0 and at < h:
        if follows:
            while 0.0 < grid[count] <= at:
                count += 1
            follows = grid[count] > at
            step = grid[count] - at if follows else h - at
        stop = max(due[0] - begin, at) if due[0] - begin < h - near else h
        dt = min(step, stop - at)
        dt = stop - at if stop - at < 1.0001 * dt else dt
        status = _try_step(m, c, begin + at, x, dt, xn, err, K)
        if status == 0 and not follows and not err[0] <= 1.0:
            step = dt * max(LEAST_SHRINKAGE, SAFETY * err[0] ** -0.2) if err[0] < np.inf else dt / 8
            if step < h / MOST_STEPS:
                return NO_NUMBERS if np.isnan(err[0]) else STIFF
            continue
        status = status or indicators_at(m, c, after)
        crossed = status == 0 and _crosses_event(z, after)
        if crossed:
            status, dt = _locate_event(m, c, begin + at, x, dt, z, xn)
        x[:] = xn
        reached = not crossed and dt == stop - at
        at = stop if reached else at + dt
        if not follows:
            if count + 1 >= len(grid):
                return STIFF
            grid[count], grid[count + 1], count = at, 0.0, count + 1
            step = min(h, dt * min(MOST_GROWTH, SAFETY * max(err[0], 1e-4) ** -0.2))
        status = status or _complete(m, c, x, z, due, crossed or (reached and stop < h))
    return status


@njit(cache=True)
def change_inputs(m: FmiModel, c: int, t: float, f: Array, x: Array, due: Array) -> int:
    """Set the inputs at the start of an exchange. A jump of the inputs is an event."""
    status = stand(m, c, t, x)
    status = status or _failed(m, call_foreign(m.at[EVENT], c), EVENT)
    status = status or put_inputs(m, c, f)
    status = status or settle(m, c, True, due)
    return status or _read_states(m, c, x)


@njit(cache=True)
def _read_states(m: FmiModel, c: int, x: Array) -> int:
    """States after an event."""
    if m.report[1] == 0 or len(x) == 0:
        return 0
    return _failed(m, call_foreign(m.at[GET_X], c, x, len(x)), GET_X)


@njit(cache=True)
def _complete(m: FmiModel, c: int, x: Array, z: Array, due: Array, event: bool) -> int:
    """Complete a step; returns whether an event is due."""
    flags = np.zeros(2, np.int64)
    status = call_foreign(m.at[COMPLETED], c, 1, flags[0:1], flags[1:2])
    status = _failed(m, status, COMPLETED)
    if status == 0 and flags[1]:
        return ENDED
    if status == 0 and (event or flags[0]):
        m.report[2] += 1
        if m.report[2] > MOST_EVENTS:
            return CROWDED
        status = settle(m, c, False, due)
        status = status or _read_states(m, c, x)
    return status or indicators_at(m, c, z)


@njit(cache=True)
def advance_copies(
    m: FmiModel,
    handles: NDArray[np.int64],
    saved: NDArray[np.int64],
    standing: int,
    times: Array,
    f: Array,
    h: float,
    x: Array,
    due: Array,
    y: Array,
    statuses: NDArray[np.int64],
) -> None:
    """Advance every copy by h (s), except those with a failure.

    handles: instances of the copies; saved: addresses of saved states, 0 if each copy has an
    instance; standing: copy in the single instance, -1 for none; times (s), f (inputs), y (outputs,
    overwritten) and statuses (updated): a row for each copy. For model exchange x (states) and due
    (times of next events) are overwritten, too, and all copies take the steps of the first copy,
    because differences between copies are smooth then.
    """
    n, grid = len(handles), np.zeros(MOST_STEPS + 1)
    for k in range(n):
        if statuses[k] != 0:
            continue
        c, status = handles[k], 0
        if saved[k] and standing != k:
            status = _failed(m, call_foreign(m.at[RESTORE], c, saved[k]), RESTORE)
        if m.exchanges:
            status = status or exchange(m, c, times[k], h, f[k], x[k], due[k], grid)
        else:
            status = status or put_inputs(m, c, f[k])
            status = status or do_step(m, c, times[k], h)
        if status == 0 and saved[k] and n > 1:
            status = _failed(m, call_foreign(m.at[SAVE], c, saved[k : k + 1]), SAVE)
        statuses[k] = status or get_outputs(m, c, y[k])


# ---- as a compiled function of two addresses -----------------------------------------------------

_TABLE_HEAD, STATUS, _DUE, LEADS, _STEP_S = 10, 5, 6, 7, 8
_FUNCTION_COUNT = len(NAMES[2].split())


class ExchangeTable(NamedTuple):
    """Memory of an exchange, views of an array of words.

    The words are version, states, inputs, outputs, indicators; the status of the first failure, 0
    for none (STATUS); as floats the next event, whether the steps within are chosen (LEADS), the
    length of an exchange (s); then the arrays below.

    x, f, y                  states, inputs and outputs (SI)
    own_x, own_f             the same in the FMU's units
    states, inputs, outputs  conversions of their units
    grid                     ends of the steps within
    """

    model: FmiModel
    x: Array
    f: Array
    y: Array
    own_x: Array
    own_f: Array
    states: UnitScale
    inputs: UnitScale
    outputs: UnitScale
    grid: Array


@njit(cache=True)
def _length(nx: int, nf: int, ny: int) -> int:
    """Number of words of a table with so many states, inputs and outputs."""
    return _TABLE_HEAD + _FUNCTION_COUNT + 4 + 7 * nx + 5 * nf + 4 * ny + MOST_STEPS + 2


@njit(cache=True)
def table_in(words: NDArray[np.int64]) -> ExchangeTable:
    """Table in an array of words, whose leading counts are set."""
    nx, nf, ny = words[1], words[2], words[3]
    numbers = words.view(np.float64)
    a = _TABLE_HEAD + _FUNCTION_COUNT
    # value references are half as long as a word
    v = a + 4
    xs, rs = words[v : v + nx].view(np.uint32)[:nx], words[v + nx :].view(np.uint32)[:nx]
    v += 2 * nx
    fs, ys = words[v : v + nf].view(np.uint32)[:nf], words[v + nf :].view(np.uint32)[:ny]
    v += nf + ny
    x = numbers[v : v + 5 * nx].reshape(5, nx)
    v += 5 * nx
    f = numbers[v : v + 4 * nf].reshape(4, nf)
    v += 4 * nf
    y = numbers[v : v + 3 * ny].reshape(3, ny)
    v += 3 * ny
    report = words[a : a + 4]
    model = FmiModel(words[_TABLE_HEAD:a], words[0], True, fs, ys, xs, rs, words[4], x[0], report)
    states, inputs, outputs = UnitScale(x[3], x[4]), UnitScale(f[2], f[3]), UnitScale(y[1], y[2])
    grid = numbers[v : v + MOST_STEPS + 1]
    return ExchangeTable(model, x[1], f[0], y[0], x[2], f[1], states, inputs, outputs, grid)


def exchange_words(m: FmiModel, units: FmuUnits, h: float) -> NDArray[np.int64]:
    """Words of a table for exchanges of h seconds."""
    counts = len(m.states), len(m.inputs), len(m.outputs)
    words = np.zeros(_length(*counts), np.int64)
    words[:5] = m.version, *counts, m.indicators
    words.view(np.float64)[_STEP_S] = h
    t = table_in(words)
    for name in ("at", "inputs", "outputs", "states", "rates", "sizes"):
        getattr(t.model, name)[:] = getattr(m, name)
    t.states.scale[:], t.states.offset[:] = units.states
    t.inputs.scale[:], t.inputs.offset[:] = units.inputs
    t.outputs.scale[:], t.outputs.offset[:] = units.outputs
    return words


@cfunc(types.void(types.CPointer(types.int64), types.CPointer(types.int64)), cache=True)
def exchange_of(handle, data):  # type: ignore[no-untyped-def]
    """Exchange of the instance with its handle at an address, over the table at another address.

    States and outputs are NaN after a failure.
    """
    head = carray(data, _TABLE_HEAD)
    words = carray(data, _length(head[1], head[2], head[3]))
    t, numbers = table_in(words), words.view(np.float64)
    t.own_x[:] = (t.x - t.states.offset) / t.states.scale
    t.own_f[:] = (t.f - t.inputs.offset) / t.inputs.scale
    if numbers[LEADS] != 0.0:
        t.grid[0] = 0.0
    due, c = numbers[_DUE : _DUE + 1], handle[0]
    due[0] = 0.0
    status = exchange(t.model, c, 0.0, numbers[_STEP_S], t.own_f, t.own_x, due, t.grid)
    status = status or get_outputs(t.model, c, t.y)
    if status != 0:
        words[STATUS] = words[STATUS] or status
        t.x[:] = np.nan
        t.y[:] = np.nan
        return
    t.x[:] = t.own_x * t.states.scale + t.states.offset
    t.y[:] = t.y * t.outputs.scale + t.outputs.offset
