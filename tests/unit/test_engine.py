"""The engine: orders of convergence, stiffness, exact sensitivities, held inputs, joined runs."""

from collections.abc import Callable

import numpy as np
import pytest
from compiled import (
    PERIOD_S,
    begin,
    differences,
    parameter,
    program,
    run,
    sensitivities,
    signal,
    state,
    steps,
)

from pamid.base.arrays import Array
from pamid.engine.program import Program, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.vocabulary import (
    Expr,
    absolute,
    bristle,
    delay,
    integral,
    lag,
    maximum,
    play,
    rate_of,
    sin,
    sqrt,
    stop,
    tanh,
    where,
)
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Port, Rig
from pamid.simulation.free_runs import choose_stepping, free_run
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, Window

EXPLICIT, IMPLICIT = Stepping(1), Stepping(1, implicit=True)
BOTH = pytest.mark.parametrize("implicit", [False, True], ids=["rk4", "sdirk2"])
X, V, U = state("x"), state("v"), signal()


# ---- order, stiffness, held inputs --------------------


def _riccati() -> tuple[Program, Array]:
    """dx/dt = -30 x^2 (x = 1/(1 + 30 t)) beside a vibration at 40 rad/s that x does not touch."""
    made = program({"x": -30.0 * X * X, "v": 40.0 * state("w"), "w": -40.0 * V}, {"x": X, "v": V})
    time = np.arange(30) * PERIOD_S
    return made, np.stack([1.0 / (1.0 + 30.0 * time), np.sin(40.0 * time)], axis=1)


@pytest.mark.parametrize(
    ("implicit", "coarsest", "order", "off"), [(False, 2, 4, 0.15), (True, 8, 2, 0.1)]
)
def test_order_of_convergence(implicit, coarsest, order, off):
    made, truth = _riccati()
    errors = [
        float(np.abs(run(made, np.zeros(30), x=[1.0, 0.0, 1.0], stepping=step) - truth).max())
        for step in (Stepping(coarsest * 2**k, implicit) for k in range(4))
    ]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(3 * [order], abs=off)


def test_sdirk2_follows_a_slow_input_through_a_rate_of_1e5():
    """One step per sample over 1000 time constants: no oscillation, the held input is reached
    within two samples."""
    made = program({"x": -1e5 * (X - U), "v": X - V}, {"x": X, "v": V})
    u = steps(1, 200, hold=10)
    found = run(made, u, x=[5.0, 0.0], stepping=IMPLICIT)
    settled = np.arange(200) % 10 >= 3
    np.testing.assert_allclose(found[settled, 0], u[settled], atol=1e-6)
    slow = [0.0]
    for value in u[:-1].tolist():
        slow.append(value + (slow[-1] - value) * np.exp(-PERIOD_S))
    np.testing.assert_allclose(found[:, 1], slow, atol=2e-4)
    blown_up = made.run(
        begin(made, [5.0, 0.0], EXPLICIT),
        SampledInputs(u[:, None], PERIOD_S),
        np.zeros(0),
        stepping=EXPLICIT,
    )[2]
    assert blown_up >= 0


@pytest.mark.parametrize("width", [1e-1, 1e-2, 1e-4])
def test_sdirk2_sticks_where_friction_is_a_steep_tanh(width):
    """A push of at most 100 against a friction of 1000: the speed stays within a tenth of the
    width."""
    made = program({"v": 100.0 * U - 1e3 * tanh(V / width)}, {"v": V})
    found = run(made, steps(3, 100, hold=10), x=[0.5], stepping=IMPLICIT)
    assert np.abs(found[5:]).max() < 0.2 * width


def test_a_run_that_blows_up_names_its_sample():
    made = program({"x": X * X}, {"x": X})
    _, _, bad = made.run(
        begin(made, [20.0], EXPLICIT), SampledInputs(np.zeros((100, 1)), PERIOD_S), np.zeros(0)
    )
    assert 4 <= bad <= 8  # x = 1/(0.05 - t) has its pole at sample 5


# ---- sensitivities --------------------

A, B = parameter("a"), parameter("b")
_OSCILLATOR = {"x": V, "v": 8.0 * U - A * X - B * V - 0.3 * X * X * X}
Model = tuple[dict[str, Expr], dict[str, Expr], list[float]]


def _held_by(force: Expr, p: tuple[float, float] = (40.0, 3.0), **read: Expr) -> Model:
    """The oscillator with a further force, its place read and what else is named."""
    return {**_OSCILLATOR, "v": _OSCILLATOR["v"] - force}, {"x": X, **read}, list(p)


def _driven_by(force: Expr, p: tuple[float, float], **read: Expr) -> Model:
    """An oscillator of fixed stiffness under a force."""
    return {"x": V, "v": force - 40.0 * X - V}, {"x": X, **read}, list(p)


#: made anew for every test
MODELS: dict[str, Callable[[], Model]] = {
    "states": lambda: (_OSCILLATOR, {"x": X, "product": A * X * V}, [40.0, 3.0]),
    "branches": lambda: (
        {
            "x": V,
            "v": where(U > 0.0, sqrt(absolute(X) + A), -B * X) - maximum(V, A * X) - absolute(X),
        },
        {"x": X},
        [0.7, 2.0],
    ),
    "play": lambda: _held_by(30.0 * play(X, B * 0.01), y=play(X, B * 0.02)),
    "stop": lambda: _held_by(A * stop(X, B * 0.05)),
    "bristle": lambda: _held_by(A * bristle(X, B * 0.05)),
    "lag of a state": lambda: _held_by(9.0 * lag(X, B * 0.01), y=lag(V, 0.01 * B)),
    "lag of an input": lambda: (
        {"x": V, "v": 8.0 * lag(U, 0.01 * B) - A * X - V},
        {"x": X, "y": lag(A * U, 0.02 * B)},
        [40.0, 3.0],
    ),
    "delay of a state": lambda: _held_by(
        9.0 * delay(X, B, 0.1), (40.0, 0.0347), y=delay(A * V, B, 0.1)
    ),
    "delay of an input": lambda: _driven_by(8.0 * delay(A * U, B, 0.1), (1.3, 0.0347)),
    "delay of a rectified input": lambda: _driven_by(
        80.0 * abs(A * delay(U, B, 0.1) - 0.1),
        (1.3, 0.0347),
        y=integral(abs(delay(U, 0.5 * B, 0.1))),
    ),
    "integral": lambda: _held_by(A * integral(X - B * 0.1)),
    "memories of memories": lambda: _held_by(
        20.0 * play(delay(lag(X, 0.01), 0.001 * A, 0.1), 0.01 * B),
        (41.3, 3.0),
        y=delay(play(X, 0.01 * B), 0.0005 * A, 0.1),
    ),
}


@BOTH
@pytest.mark.parametrize("name", MODELS)
def test_sensitivities_equal_central_differences(name, implicit):
    rates, outputs, p = MODELS[name]()
    x = [0.31, -0.1]
    made = program(rates, outputs, ["a", "b"])
    u, stepping = steps(12, 120, hold=17), Stepping(2, implicit)
    exact, apart = sensitivities(made, u, p, x, stepping), differences(made, u, p, x, stepping)
    size = np.abs(apart).max(axis=0)
    assert (size.max(axis=0) > 0.0).all(), "every column acts on some output"
    error = np.abs(exact - apart).max(axis=0) / (size + 1e-12)
    assert error.max() < 2e-6, error


def test_sensitivities_of_the_joint_in_its_own_loop():
    """The whole one-dof rig with memories, under its controller: exact against differences."""
    rig = rig_named("one-dof")
    attached = tuple(
        attach(rig, n, effects()) for n in ("coulomb-friction", "dead-time", "angle-sensor-lag")
    )
    a = Assembly(rig, attached, controller=tuple(rig.controller.items()))
    made, p = a.program, a.values()
    p[a.index_of("dead-time:delay_s")] = 0.0047
    u = np.zeros((300, len(made.inputs)))
    u[20:, made.inputs.index("reference_deg")] = np.radians(20.0)
    names = [
        "damping",
        "conductance_out",
        "dead-time:delay",
        "coulomb-friction:level",
        "angle-sensor-lag:time_constant",
    ]
    free = [a.keys[n] for n in names]
    chosen = np.full(len(p), -1, np.int64)
    chosen[free] = range(len(free))

    def outputs(values, sens):
        memory = made.memory(a.start(values), len(free), stepping=Stepping(2), period_s=0.003)
        y, J, bad = made.run(
            memory,
            SampledInputs(u, 0.003),
            values,
            stepping=Stepping(2),
            columns=chosen if sens else None,
        )
        assert bad == -1
        return y, J

    _, J = outputs(p, True)
    for column, i in enumerate(free):
        h = 1e-6 * abs(p[i])
        high, low = p.copy(), p.copy()
        high[i], low[i] = p[i] + h, p[i] - h
        apart = (outputs(high, False)[0] - outputs(low, False)[0]) / (2.0 * h)
        error = np.quantile(np.abs(J[:, :, column] - apart), 0.99, axis=0) / np.abs(apart).max(
            axis=0
        )
        assert error.max() < 1e-4, (names[column], error)


# ---- stepping --------------------


class Sprung(Rig):
    """A mass on a spring and a damper."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {"force": Port("motion", "N", ("velocity", "position")), "gauge": Port("reading", "m")}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 1.0, 0.01, 10.0, "kg", source="test"),
        Parameter("stiffness", 100.0, 1.0, 1e9, "N/m", source="test"),
        Parameter("damping", 2.0, 0.0, 1e9, "N s/m", source="test"),
    )
    period_s = PERIOD_S

    def rates(self, x, u, p, port):
        force = u.force_n - p.stiffness * x.position - p.damping * x.velocity
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x, u, p, port):
        return {"position_m": port("gauge", x.position)}


@pytest.mark.parametrize(
    ("stiffness", "damping", "expected"),
    [
        (100.0, 2.0, Stepping(1)),
        (1e5, 100.0, Stepping(2)),
        (100.0, 500.0, Stepping(4)),
        (100.0, 2e3, Stepping(16)),  # the implicit step would cost as much, and err more
        (100.0, 1e4, IMPLICIT),
        (1e8, 1e3, IMPLICIT),
    ],
)
def test_stepping_follows_stiffness(stiffness, damping, expected):
    a = Assembly(Sprung())
    p = np.array([1.0, stiffness, damping])
    u = steps(14, 300, hold=30)[:, None]
    assert choose_stepping(a, u, p, PERIOD_S, a.start(p)) == expected
    found = free_run(a, u, p, PERIOD_S)
    fine = free_run(a, u, p, PERIOD_S, stepping=Stepping(expected.substeps * 64, expected.implicit))
    assert found.blown_up == -1
    late = np.arange(300) % 30 > 20  # a vibration as fast as the steps is damped, not followed
    assert np.abs((found.outputs - fine.outputs)[late]).max() < 1e-3 * np.abs(fine.outputs).max()


# ---- runs that are joined --------------------


@BOTH
@pytest.mark.parametrize("cut", [1, 37, 119])
def test_two_calls_equal_one(cut, implicit):
    rates, outputs, _ = _held_by(
        20.0 * play(delay(lag(X, 0.01), 0.0347, 0.1), 0.01 * B)
        + 5.0 * bristle(X, 0.1)
        - sin(30.0 * symbol("tick", "time")),
        y=delay(play(X, 0.01 * B), 0.001 * A, 0.1),
        i=integral(X),
    )
    made = program(rates, outputs, ["a", "b"])
    u, p, stepping = steps(15, 120)[:, None], np.array([41.3, 3.0]), Stepping(2, implicit)
    chosen = np.arange(2, dtype=np.int64)

    def whole(edges):
        memory = begin(made, [0.3, -0.1], stepping, 4)
        memory.S[:2, 2:4] = np.eye(2)
        parts = [
            made.run(
                memory,
                SampledInputs(u[i:j], PERIOD_S, i * PERIOD_S),
                p,
                stepping=stepping,
                columns=chosen,
            )
            for i, j in zip(edges[:-1], edges[1:], strict=True)
        ]
        return np.concatenate([y for y, _, _ in parts]), np.concatenate([J for _, J, _ in parts])

    (y, J), (y2, J2) = whole([0, 120]), whole([0, cut, 120])
    np.testing.assert_allclose(y2, y, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(J2, J, rtol=1e-9, atol=1e-11)


def _stuck() -> tuple[Runner, Array]:
    rig = Sprung()
    friction = attach(rig, "coulomb-friction", effects())
    a = Assembly(rig, (friction,))
    p, u = a.values(), steps(17, 200, hold=20, size=30.0)[:, None]
    track = Track(
        "rec", u, np.zeros((200, 1)), p, (), PERIOD_S, np.full(len(a.rig.states), np.inf), 0.6
    )
    return Runner(a, track, EXPLICIT, free=(1, 2)), p


def test_a_new_window_keeps_what_effects_remember():
    """A corrected position is not a motion: the friction's deflection stays, and so does its
    force."""
    runner, p = _stuck()
    memory = runner.memory(p)
    runner.run(memory, Window(0, 90), p, False)
    names = runner.assembly.program.cells
    kept = [i for i, n in enumerate(names) if not n.endswith("_origin")]
    assert kept
    before, x = memory.cells[kept].copy(), memory.x.copy()
    assert np.abs(before).max() > 0.0
    moved = memory.copy()
    runner.enter(moved, x + np.array([0.05, 0.0]))
    runner.run(moved, Window(90, 91), p, False)
    np.testing.assert_allclose(moved.cells[kept], before, rtol=1e-12)
    # the same as a motion would be remembered
    driven = memory.copy()
    driven.x[0] += 0.05
    runner.run(driven, Window(90, 91), p, False)
    assert np.abs(driven.cells[kept] - before).max() > 1e-6


@pytest.mark.parametrize(
    "remembered",
    [play(U, 0.3 * B), bristle(U, 0.3 * B), rate_of(U), play(lag(U, 0.01), 0.3 * B)],
    ids=["play", "bristle", "rate", "play of a lag"],
)
@pytest.mark.parametrize("linear", [(), ("u",)], ids=["held", "linear"])
def test_a_memory_of_an_input_sees_the_step_with_which_a_window_begins(remembered, linear):
    """No state that is set anew corrects what was recorded: a command that changes with the first
    sample of a window has moved."""
    made = program({"x": remembered - X}, {"y": remembered}, ["b"], linear=linear)
    u, p = np.repeat([0.0, 5.0, 1.0, 4.0], 30)[:, None], np.array([2.0])
    whole, parts = begin(made, [0.0], EXPLICIT), begin(made, [0.0], EXPLICIT)
    y, _, _ = made.run(whole, SampledInputs(u, PERIOD_S), p)
    rows = []
    for first in range(0, len(u), 30):
        parts.join = first > 0
        after = u[first + 30] if first + 30 < len(u) else None
        rows.append(
            made.run(parts, SampledInputs(u[first : first + 30], PERIOD_S, after=after), p)[0]
        )
    np.testing.assert_allclose(np.concatenate(rows), y, rtol=1e-12, atol=1e-12)
