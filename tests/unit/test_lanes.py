"""Hypotheses side by side are the runs of each by itself, whatever happens in the other lanes."""

import ctypes
from collections.abc import Sequence

import numpy as np
import pytest
from compiled import PERIOD_S, parameter, signal, state, steps
from compiled import program as scalar_program

from pamid.base.arrays import Array
from pamid.engine.jit_cache import addresses
from pamid.engine.lane_ir import lane_module_text
from pamid.engine.lane_program import LaneProgram, build_lane_program
from pamid.engine.program import Memory, Program, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.serial_lanes import SerialLanes
from pamid.engine.symbolic.expression import Expr
from pamid.engine.symbolic.memory_cells import expand_memory
from pamid.engine.symbolic.vocabulary import (
    cos,
    delay,
    exp,
    floor,
    integral,
    log,
    play,
    sin,
    sqrt,
    tanh,
)
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named

TOLERANCE = 1e-9  # of the largest output: lanes and single runs round differently
SAMPLES = 300
X, V, U = state("x"), state("v"), signal()
#: effects with delay lines, plays, hysteresis, friction, stops, drifts and other states
CASES = [
    ("cascaded-tanks", ("overflow-into-store", "dead-time@pump")),
    ("cylinder-bench", ("maxwell-slip-hysteresis", "play@gauge")),
    ("damper-bench", ("dahl-friction", "hardening-hysteresis")),
    ("dc-motor", ("backlash", "pwm-quantisation")),
    ("linear-axis", ("cogging", "signal-hysteresis@drive")),
    ("muscle-mass", ("muscle-creep", "prandtl-ishlinskii-hysteresis")),
    ("one-dof", ()),
    ("one-dof", ("coulomb-friction", "backlash")),
    ("one-dof", ("lugre-friction", "dead-time")),
    ("servo-axis", ("stribeck-friction", "play@encoder")),
    ("servo-pendulum", ("dead-zone@driver", "external-vibration", "first-order-lag@encoder")),
    ("switched-joint", ("tube-lag", "angle-sensor-lag")),
    ("thermal-block", ("second-store", "orifice-loss")),
    ("two-link", ("valve-dead-band@command",)),
    ("two-masses", ("bouc-wen-hysteresis@spring", "end-stop@carriage_2")),
]


def lane_program(
    rates: dict[str, Expr],
    outputs: dict[str, Expr],
    parameters: Sequence[str] = (),
    linear: tuple[str, ...] = (),
) -> LaneProgram:
    lowered = expand_memory(rates, outputs, (), linear)
    return build_lane_program(lowered, ("u",), tuple(parameters), tuple(outputs), linear)


def _random_inputs(assembly: Assembly, random: np.random.Generator) -> Array:
    """Levels within the inputs' ranges, held for ten samples (samples x inputs)."""
    ranges = [assembly.rig.ranges.get(n, (-1.0, 1.0)) for n in assembly.traced.inputs]
    levels = [
        random.uniform(max(low, -10.0), min(high, 10.0), SAMPLES // 10) for low, high in ranges
    ]
    return np.repeat(np.array(levels).reshape(len(ranges), -1).T, 10, axis=0)


def _largest_error(Y: Array, single: Array) -> float:
    return float((np.abs(Y - single).max(axis=0) / np.abs(single).max(axis=0)).max())


@pytest.mark.parametrize("rig, names", CASES, ids=[f"{r}-{'-'.join(n)}" for r, n in CASES])
@pytest.mark.parametrize(
    "stepping",
    [Stepping(1), Stepping(2), Stepping(1, implicit=True)],
    ids=["one", "two", "implicit"],
)
def test_lanes_are_single_runs(rig, names, stepping):
    machine = rig_named(rig)
    effect = tuple(attach(machine, name, effects()) for name in names)
    assembly = Assembly(machine, effect, background=True, sensitive=frozenset())
    random = np.random.default_rng(7)
    u, lanes, nominal = _random_inputs(assembly, random), 11, assembly.values()
    p = nominal[:, None] * (1.0 + 0.02 * random.standard_normal((len(nominal), lanes)))
    x = np.stack([assembly.start(p[:, lane]) for lane in range(lanes)], axis=1)
    side_by_side = assembly.lane_program
    assert isinstance(side_by_side, LaneProgram)
    course = {"period_s": machine.period_s, "stepping": stepping}
    inputs = SampledInputs(u, machine.period_s)
    memory = side_by_side.memory(x, **course)
    Y, bad = side_by_side.run(memory, inputs, p, stepping=stepping)
    assert Y.shape == (len(u), len(side_by_side.outputs), lanes)
    for lane in (0, 3, 10):
        single = assembly.program.memory(x[:, lane], **course)
        y, _, lost = assembly.program.run(single, inputs, p[:, lane], stepping=stepping)
        assert bad[lane] == lost
        finite = len(u) if lost < 0 else lost
        assert _largest_error(Y[:finite, :, lane], y[:finite]) < TOLERANCE
        if lost < 0 and len(x):
            assert _largest_error(memory.x[:, lane][None], single.x[None]) < TOLERANCE


# ---- vector functions ----------------------------------------------------------------------------


def _evaluated(function: Expr, values: Array) -> Array:
    """An expression in state 0 at these values, by vector code."""
    text = lane_module_text({"f": [function]}, lambda space, name: 0)
    (address,) = addresses(text, ["f"])
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7)(address)
    padded = np.concatenate([values, np.zeros(-len(values) % 8)])
    out = np.empty_like(padded)
    for i in range(0, len(padded), 8):
        lanes, result = padded[i : i + 8].copy(), np.empty(8)
        call(*[lanes.ctypes.data] * 6, result.ctypes.data)
        out[i : i + 8] = result
    return out[: len(values)]


def _full_range() -> Array:
    random = np.random.default_rng(3)
    sizes = 10.0 ** random.uniform(-320.0, 308.0, 2000)
    edges = [0.0, np.inf, np.nan, 5e-324, 2.2e-308, 709.782712893384, 709.7827128933841, 710.0]
    edges += [708.0, 745.13, 745.14, 744.0, 746.0, 20.0, 40.0, 0.5 * np.log(2.0)]
    values = np.concatenate([sizes, random.uniform(0.0, 760.0, 4000), edges])
    # apart from the others: angles far from zero take another way, for all lanes of a vector
    turns = 0.5 * np.pi * np.arange(-640000, 640000, 311)
    near = [random.uniform(-size, size, 2000) for size in (1e-3, 2.0, 40.0, 1e6)]
    return np.concatenate([values, -values, np.zeros(-2 * len(values) % 8), turns, *near])


@pytest.mark.parametrize("name", ["exp", "tanh", "sqrt", "sin", "cos", "log", "floor"])
def test_vector_functions_are_those_of_numpy(name):
    written = {"exp": exp, "tanh": tanh, "sqrt": sqrt, "sin": sin, "cos": cos, "log": log}
    values = _full_range()
    if name in ("sin", "cos"):
        values = values[~np.isinf(values)]
    with np.errstate(all="ignore"):
        exact = getattr(np, name)(values)
    result = _evaluated(({**written, "floor": floor}[name])(X), values)
    finite = np.isfinite(exact)
    assert np.array_equal(np.isnan(result), np.isnan(exact))
    assert np.array_equal(result[np.isinf(exact)], exact[np.isinf(exact)])
    # some units in the last place; of a denormal the last place is 5e-324
    bound = 1e-15 * np.abs(exact[finite]) + 1.5e-323
    assert (np.abs(result[finite] - exact[finite]) <= bound).all()


# ---- lanes that diverge --------------------------------------------------------------------------


def _explosive() -> tuple[LaneProgram, Program]:
    """dx/dt = a x^3, which leaves every bound where a > 0, and an input behind a delay."""
    rates, outputs = {"x": parameter("a") * X * X * X}, {"x": X, "late": delay(U, 0.03, 0.05)}
    return lane_program(rates, outputs, ["a"]), scalar_program(rates, outputs, ["a"])


def test_a_lane_that_diverges_leaves_the_others_alone():
    lanes, single = _explosive()
    a = np.array([-1.0, 300.0, -2.0, 30.0, 0.0, -3.0, 1e4, -4.0, 40.0, -5.0])
    u, x = steps(1, 120)[:, None], np.ones((1, len(a)))
    Y, bad = lanes.run(lanes.memory(x, period_s=PERIOD_S), SampledInputs(u, PERIOD_S), a[None])
    for k, value in enumerate(a):
        memory = single.memory(x[:, k], period_s=PERIOD_S)
        y, _, lost = single.run(memory, SampledInputs(u, PERIOD_S), np.array([value]))
        assert (lost < 0) == (value <= 0.0)
        assert bad[k] == lost
        np.testing.assert_allclose(Y[:, :, k], y, rtol=1e-12)
    assert len({*bad.tolist()}) > 3


# ---- windows -------------------------------------------------------------------------------------


def _remembering() -> tuple[LaneProgram, Program]:
    """A mass behind a play, with a late force, and an integral that no window start sets."""
    slack = parameter("k") * play(X, parameter("r"))
    push = delay(U, parameter("late"), 0.08)
    rates: dict[str, Expr] = {"x": V, "v": push - slack - 0.5 * V - 0.2 * integral(X)}
    outputs = {"x": X, "held": slack, "push": push}
    given = (rates, outputs, ("k", "r", "late"))
    return lane_program(*given, linear=("u",)), scalar_program(*given, linear=("u",))


def _windows_case() -> tuple[Array, Array, Array, Array]:
    random = np.random.default_rng(11)
    u, edges = steps(2, 150, 9, 4.0)[:, None], np.array([0, 40, 90, 150])
    p = np.array([30.0, 0.05, 0.034])[:, None] * (1.0 + 0.2 * random.uniform(-1, 1, (3, 11)))
    return u, edges, p, 0.3 * random.standard_normal((3, 2, 11))


@pytest.mark.parametrize("serial", [False, True], ids=["side by side", "serial"])
@pytest.mark.parametrize("dependent", [None, 1, 4, 9])
def test_windows_carry_the_memory_of_their_lane_or_of_lane_0(dependent, serial):
    """Lanes from `dependent` on begin every window with the memory of lane 0."""
    together, single = _remembering()
    lanes = SerialLanes(single) if serial else together  # type: ignore[arg-type]
    rounding = {"rtol": 1e-12} if serial else {"rtol": 0.0, "atol": 1e-11}
    u, edges, p, entered = _windows_case()
    if dependent is not None:
        p[:, dependent:] = p[:, :1]
    x, inputs = np.zeros((3, 11)), SampledInputs(u, PERIOD_S, 1.0)
    memory = lanes.memory(x, period_s=PERIOD_S)
    Y, ends, bad = lanes.run_windows(memory, inputs, p, edges, entered, dependent=dependent)
    assert (bad == -1).all() and Y.shape == (150, 3, 11) and ends.shape == (3, 3, 11)
    leading: list[Memory] = []
    for lane in range(11):
        alone = single.memory(x[:, lane], period_s=PERIOD_S)
        for w, (start, stop) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            if w and dependent is not None and lane >= dependent:
                alone = leading[w - 1].copy()
            alone.x[:2], alone.join = entered[w, :, lane], True
            y, _, lost = single.run(alone, inputs.part(start, stop), p[:, lane])
            assert lost < 0
            if lane == 0:
                leading.append(alone.copy())
            np.testing.assert_allclose(Y[start:stop, :, lane], y, **rounding)
            np.testing.assert_allclose(ends[w, :, lane], alone.x, **rounding)


def test_windows_may_begin_within_a_track():
    lanes, _ = _remembering()
    u, edges, p, entered = _windows_case()
    memory = lanes.memory(np.zeros((3, 11)), period_s=PERIOD_S)
    late, ends, bad = lanes.run_windows(
        memory.copy(), SampledInputs(u, PERIOD_S, 1.0), p, edges[1:], entered[1:]
    )
    moved, same_ends, _ = lanes.run_windows(
        memory,
        SampledInputs(u[edges[1] :], PERIOD_S, 1.0 + edges[1] * PERIOD_S),
        p,
        edges[1:] - edges[1],
        entered[1:],
    )
    assert (bad == -1).all() and late.shape == (110, 3, 11)
    np.testing.assert_allclose(late, moved, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ends, same_ends, rtol=0, atol=1e-12)
