"""Held inputs that come late, of which a step sees two values."""

import numpy as np
import pytest
from compiled import parameter

from pamid.engine.program import build_program
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol, walk
from pamid.engine.symbolic.memory_cells import MOST_SPLIT, expand_memory
from pamid.engine.symbolic.vocabulary import Expr, delay, minimum, tangent, where

x, speed = symbol("state", "x"), symbol("state", "speed")


def late(name: str) -> Expr:
    return delay(symbol("input", name), parameter(f"delay_{name}"), 0.1)


def size(rate: Expr, linear: tuple[str, ...] = ()) -> int:
    return len(walk(expand_memory({"x": rate}, {"x": x}, linear=linear).rates))


def heavy(command: Expr) -> Expr:
    """A chain of many operations on a command, as of a mechanism with many bodies."""
    for k in range(50):
        command = command + float(k + 1) * x * speed
    return command


def test_a_robot_of_many_late_commands_is_not_copied_for_each():
    """A saturation of the sum is nonlinear in every command."""
    commands = [f"u{k}" for k in range(9)]
    limited = [heavy(minimum(sum(map(late, commands[:n]), 0.0 * x), 1.0)) for n in (1, 9)]
    one, many = map(size, limited)
    assert many < 2 * one


@pytest.mark.parametrize("solved", [False, True])
def test_what_is_linear_in_a_late_command_is_formed_once(solved):
    command = minimum(late("u"), 1.0)
    rate = tangent(heavy(command), heavy(command)) if solved else heavy(command)
    assert size(rate) < size(heavy(symbol("input", "u"))) + 30


@pytest.mark.parametrize("count", [1, MOST_SPLIT])
def test_a_step_sees_the_mean_of_what_is_made_of_a_command(count):
    """A valve that opens either way: half a step late, the mean of its flow is that of both."""
    names = [f"u{k}" for k in range(count)]
    opened = [where(late(n) > 0.0, 2.0 * late(n), -late(n)) for n in names]
    total = sum(opened[1:], opened[0])
    program = build_program(
        expand_memory({"x": total}, {"x": x}),
        tuple(names),
        tuple(f"delay_{n}" for n in names),
        ("x",),
    )
    period, u = 0.01, np.tile([[-1.0], [1.0], [1.0], [1.0]], (1, count))
    p = np.full(count, 0.5 * period)
    memory = program.memory(np.zeros(1), period_s=period)
    Y, _, _ = program.run(memory, SampledInputs(u, period), p)
    # the first step sees -1 throughout, the second -1 and then +1
    flow = np.array([1.0, 0.5 * 1.0 + 0.5 * 2.0, 2.0])
    np.testing.assert_allclose(np.diff(Y[:, 0]), count * period * flow, rtol=1e-9)
