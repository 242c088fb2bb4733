"""The language of equations: identity of equal expressions, folding, printing, refusals, and what
memory means."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from compiled import PERIOD_S, parameter, program, run, signal, state, steps
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.engine.symbolic.expression import ONE, const, power, substitute, text, walk
from pamid.engine.symbolic.vocabulary import (
    ZERO,
    EquationError,
    Expr,
    bristle,
    clip,
    delay,
    exp,
    expression,
    lag,
    log,
    minimum,
    play,
    sign,
    sin,
    smooth_step,
    sqrt,
    stop,
    tanh,
    where,
)

A, B = parameter("a"), parameter("b")
U = signal()


# ---- the graph --------------------


def test_the_same_expression_is_the_same_object():
    assert A * sin(B) + 2.0 is A * sin(B) + 2
    assert play(U, A) is play(U, A) and play(U, A) is not play(U, B)
    assert A + B is not B + A  # floating-point sums are kept as written
    assert parameter("a") is not state("a")
    assert const(0.0) is const(-0.0) is ZERO


def test_folding():
    assert A + 0.0 is A and 0.0 + A is A and A - 0 is A and 0.0 - A is -A
    assert A * 1.0 is A and A * 0.0 is ZERO and A / 1.0 is A and 0.0 / A is ZERO
    assert (
        A - A is ZERO
        and (A * B).__neg__().__neg__() is A * B
        and A * -1.0 is -A
        and A + (-B) is A - B
    )
    assert A**0 is ONE and A**1 is A and A**2 is A * A and A**0.5 is sqrt(A) and A**3 is A * (A * A)
    assert expression(3.0) + 4.0 is const(7.0) and (const(2.0) < 3.0) is ONE
    assert (
        where(const(1.0), A, B) is A and where(const(0.0), A, B) is B and where(U > 0.0, A, A) is A
    )
    assert float(tanh(const(0.3))) == math.tanh(0.3) and float(power(2.0, -0.5)) == 2.0**-0.5
    assert float(minimum(2.0, 3.0)) == 2.0 and float(clip(5.0, -1.0, 1.0)) == 1.0
    assert [float(sign(x)) for x in (-0.3, 0.0, 2.0)] == [-1.0, 0.0, 1.0]
    assert [float(smooth_step(x)) for x in (-1.0, 0.25, 2.0)] == [0.0, 0.15625, 1.0]


@pytest.mark.parametrize(
    "misuse",
    [
        lambda: A if A > 0.0 else B,
        lambda: max(A, B),
        lambda: min(A, 1.0),
        lambda: A > 0.0 and B > 0.0,
        lambda: not A,
    ],
    ids=["if", "max", "min", "and", "not"],
)
def test_python_decisions_on_a_signal_are_refused_with_the_cure(misuse):
    with pytest.raises(EquationError) as caught:
        misuse()
    assert "where(condition, a, b)" in caught.value.hint and caught.value.exit_code == 3


@pytest.mark.parametrize(
    "nonsense",
    [
        lambda: A / 0.0,
        lambda: const(math.nan),
        lambda: A + math.inf,
        lambda: sqrt(const(-1.0)),
        lambda: log(const(0.0)),
        lambda: exp(const(1e4)),
        lambda: delay(U, A, 0.0),
        lambda: expression("3 apples"),
        lambda: expression(None),
    ],
    ids=["division", "nan", "infinite", "root", "log", "overflow", "no length", "text", "None"],
)
def test_nonsense_is_refused_where_it_is_written(nonsense):
    with pytest.raises(EquationError) as caught:
        nonsense()
    assert str(caught.value)


@pytest.mark.parametrize(
    ("written", "shown"),
    [
        (A - (B - U) / U, "a - (b - u) / u"),
        (where(A < B, U, 0.25), "where(a < b, u, 0.25)"),
        (A * -2.0, "a * (-2)"),
        (play(U, A), "play(u, a)"),
        (sqrt(abs(A)), "sqrt(abs(a))"),
        (power(-A, 1.5), "(-a)**1.5"),
    ],
)
def test_printing(written, shown):
    assert text(written) == shown


_LEAF = st.sampled_from([A, B, U, const(0.5), const(-2.0)])
_TREES = st.recursive(
    _LEAF,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["+", "-", "*", "/"]), inner, inner),
        st.tuples(st.sampled_from(["neg", "pow"]), inner),
    ),
    max_leaves=8,
)


def _built(tree: object) -> Expr:
    if isinstance(tree, Expr):
        return tree
    assert isinstance(tree, tuple)
    a = [_built(x) for x in tree[1:]]
    match tree[0]:
        case "+":
            return a[0] + a[1]
        case "-":
            return a[0] - a[1]
        case "*":
            return a[0] * a[1]
        case "/":
            return a[0] / (a[1] * a[1] + 1.0)
        case "neg":
            return -a[0]
    return power(a[0] * a[0] + 1.0, 1.5)


def _value(node: Expr, values: dict[Expr, Expr]) -> float:
    return float(substitute([node], values)[0])


@settings(max_examples=150, deadline=None)
@given(_TREES)
def test_what_is_printed_means_what_was_built(tree):
    node = _built(tree)
    # six digits are printed
    assume(all(float(f"{n.value:.6g}") == n.value for n in walk([node]) if n.op == "const"))
    numbers = {"a": 0.7, "b": -1.3, "u": 0.4}
    values = {A: const(0.7), B: const(-1.3), U: const(0.4)}
    assert eval(text(node), {}, numbers) == pytest.approx(_value(node, values), rel=1e-9, abs=1e-9)


# ---- memory, against plain loops --------------------


def remembered(
    make: Callable[[Expr, Expr], Expr], u: Array, value: float, substeps: int = 1
) -> Array:
    """Output of a memory operator on an input held over each sample."""
    made = program({"x": ZERO}, {"y": make(U, A)}, ["a"])
    return run(made, u, [value], [0.0], Stepping(substeps))[:, 0]


def moving(
    make: Callable[[Expr, Expr], Expr], u: Array, value: float, stepping: Stepping
) -> tuple[Array, Array]:
    """Output of a memory operator on a state that moves with speed u, and that state."""
    made = program({"x": U}, {"x": state("x"), "y": make(state("x"), A)}, ["a"])
    found = run(made, u, [value], [0.3], stepping)
    return found[:, 0], found[:, 1]


@pytest.mark.parametrize("substeps", [1, 3])
def test_play_is_a_clearance(substeps):
    u, r = steps(1, 200, hold=3), 0.23
    expected, y = [], float(u[0])
    for x in u.tolist():
        y = max(x - r, min(x + r, y))
        expected.append(y)
    np.testing.assert_allclose(remembered(play, u, r, substeps), expected, atol=1e-14)
    x, found = moving(play, 30.0 * u, r, Stepping(substeps))
    y, expected = float(x[0]), []
    for value in x.tolist():
        y = max(value - r, min(value + r, y))
        expected.append(y)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_bristle_is_dahls_law():
    u, reach = steps(3, 120, hold=2), 0.4
    expected, z, last = [], 0.0, float(u[0])
    for x in u.tolist():
        d = (x - last) / 4000.0
        for _ in range(4000 if d else 0):  # midpoint rule
            middle = z + 0.5 * d * (1.0 - z * np.sign(d) / reach)
            z += d * (1.0 - middle * np.sign(d) / reach)
        expected.append(z)
        last = x
    np.testing.assert_allclose(remembered(bristle, u, reach), expected, atol=1e-7)


@pytest.mark.parametrize("substeps", [1, 2])
def test_lag_of_a_held_input_is_the_mean_over_the_step(substeps):
    u, tau = steps(4, 60, hold=4), 0.017
    h = PERIOD_S / substeps
    inside = (np.arange(20000) + 0.5) / 20000 * h
    expected, y = [], float(u[0])
    for x in u.tolist():
        expected.append(float(np.mean(x + (y - x) * np.exp(-inside / tau))))
        y = x + (y - x) * math.exp(-PERIOD_S / tau)
    np.testing.assert_allclose(remembered(lag, u, tau, substeps), expected, atol=1e-9)


@pytest.mark.parametrize(
    "stepping", [Stepping(1), Stepping(4), Stepping(1, implicit=True)], ids=str
)
@pytest.mark.parametrize("tau", [0.002, 0.05])
def test_lag_of_a_moving_input_is_the_differential_equation(stepping, tau):
    u = steps(5, 60, hold=5, size=20.0)
    x, found = moving(lag, u, tau, stepping)
    y, expected = float(x[0]), []
    for k, speed in enumerate(u.tolist()):
        expected.append(y)
        start = float(x[k])

        def slope(t, value, start=start, speed=speed):
            return (start + speed * t - value) / tau

        y = float(solve_ivp(slope, (0.0, PERIOD_S), [y], rtol=1e-10, atol=1e-12).y[0, -1])
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("samples", [0.0, 0.4, 1.0, 2.75, 9.0])
@pytest.mark.parametrize("substeps", [1, 2])
def test_delay_of_a_held_input(samples, substeps):
    """Linear between steps: with one step per sample that is linear between samples."""
    u, h = steps(6, 80, hold=3), PERIOD_S / substeps
    found = remembered(lambda x, s: delay(x, s, 0.09), u, samples * PERIOD_S, substeps)
    fine = np.repeat(u, substeps)
    position = samples * PERIOD_S / h
    whole = int(position + 1e-9)
    part = position - whole
    at = np.arange(len(u)) * substeps
    expected = (1.0 - part) * fine[np.maximum(at - whole, 0)] + part * fine[
        np.maximum(at - whole - 1, 0)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("late_s", [0.0, 0.004, 0.0254, 0.03, 0.0375])
def test_a_held_command_that_comes_within_a_sample_is_not_smeared(late_s):
    """What is made of it counts by its mean over the sample: a command that changes its sign at
    every sample opens a valve as far as one that stays. Against a hundredth of the step."""
    u = np.random.default_rng(3).standard_normal(90)
    flow = where(U > 0.2, 3.0 * U, -U * U)

    def filled(input_):
        (made,) = substitute([flow], {U: input_})
        return {"x": made}

    found = run(program(filled(delay(U, A, 0.05)), {"y": state("x")}, ["a"]), u, [late_s], [0.0])
    ideal = run(program(filled(U), {"y": state("x")}), np.repeat(u, 100), (), [0.0])[:, 0] / 100.0
    at = 100 * np.arange(len(u)) - round(1e4 * late_s)
    before = np.minimum(at, 0) / 100.0 * -PERIOD_S  # it stood at its first value
    first = 3.0 * u[0] if u[0] > 0.2 else -(u[0] ** 2)
    expected = ideal[np.maximum(at, 0)] - before * first
    np.testing.assert_allclose(found[:, 0], expected - expected[0], atol=1e-12)


# operator, and whether it leaves x (or nothing)
NULLS: dict[str, tuple[Callable[[Expr, Expr], Expr], bool]] = {
    "play": (play, True),
    "stop": (stop, False),
    "lag": (lag, True),
    "delay": (lambda x, s: delay(x, s, 0.1), True),
}


@pytest.mark.parametrize("name", NULLS)
@pytest.mark.parametrize("substeps", [1, 3])
def test_nulls_are_exact(name, substeps):
    make, identity = NULLS[name]
    u = steps(10, 200, hold=3)
    held = remembered(make, u, 0.0, substeps)
    x, moved = moving(make, 30.0 * u, 0.0, Stepping(substeps))
    for found, signal_ in ((held, u), (moved, x)):
        expected = signal_ if identity else np.zeros_like(signal_)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 if name == "lag" else 0.0)


def test_an_algebraic_loop_is_named():
    from pamid.engine.symbolic.expression import symbol
    from pamid.engine.symbolic.memory_cells import Cell, expand_memory

    one, other = symbol("cell", "one"), symbol("cell", "other")
    with pytest.raises(EquationError, match="algebraic loop through one, other"):
        expand_memory(
            {"x": one},
            {"y": other},
            (Cell("one", 2.0 * other, other), Cell("other", one + 1.0, one)),
        )
