"""Slopes of a step by differences, where the step jumps close by, as where a contact closes."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.simulator import DIFFERENCE
from pamid.engine.stepped import slopes_of

H = 0.01
NONE = np.zeros(0, np.intp)
SPEED, RATE = -0.3, 0.2


@dataclass
class Ball:
    """Falls, and is pushed up at once by a kick below the ground's height: a soft contact whose
    damper acts as soon as it closes. Parameters: the ground's height, the kick, gravity."""

    sizes: tuple[Array, Array] = field(default_factory=lambda: (np.ones(2), np.ones(1)))
    longest_s: float = np.inf
    copies: int = 0

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        self.copies += len(x)
        height, speed = x.T
        ground, kick, gravity = p.T
        kicked = np.where(height < ground, kick, 0.0)
        after = speed + h * (f[:, 0] - gravity * np.cos(RATE * height)) + kicked
        return np.stack([height + h * after, after], axis=1), height[:, None] ** 2

    def reads(self, x: Array, p: Array) -> Array:
        return x[:, :1] ** 2

    def in_c(self, p: Array, h: float) -> Any:
        return nullcontext()


def _slopes(height: float, kick: float, chosen: NDArray[np.intp] = NONE) -> tuple[Array, int]:
    ball = Ball()
    p = np.array([1.0, kick, 9.81])
    found = slopes_of(ball, np.array([height, SPEED]), np.zeros(1), p, H, chosen)
    whole = np.concatenate([found.by_state, found.by_force, found.by_parameter], axis=1)
    return whole, ball.copies


@pytest.mark.parametrize("share", [-0.9, -0.5, -0.1, 0.1, 0.5, 0.9])
def test_a_contact_that_closes_within_a_difference_is_not_taken_for_a_slope(share):
    """To either side of the ground, and as close to it; the ground's own height is a parameter."""
    chosen = np.arange(3)
    near, _ = _slopes(1.0 + share * DIFFERENCE, 0.5, chosen)
    below = share < 0.0
    far, _ = _slopes(1.0 + np.sign(share) * 10.0 * DIFFERENCE, 0.5, chosen)
    assert np.abs(near - far).max() < 1e-4  # of curvature; the jump would be 1e5
    assert far[2, 4] == pytest.approx(1.0 if below else 0.0)  # of the speed by the kick


def test_without_a_jump_the_slopes_are_forward_differences_as_they_were():
    ball, p, x = Ball(), np.array([1.0, 0.5, 9.81]), np.array([1.3, SPEED])
    found = slopes_of(ball, x, np.zeros(1), p, H, np.array([2]))
    assert ball.copies == 1 + 4 + 1  # plain, each moved, and all of them to the other side
    plain, _ = ball.steps(x[None], np.zeros((1, 1)), p[None], H)
    for i in range(2):
        by = DIFFERENCE * max(abs(x[i]), 1.0)
        moved = x.copy()
        moved[i] += by
        after, _ = ball.steps(moved[None], np.zeros((1, 1)), p[None], H)
        assert np.array_equal(found.by_state[1:, i], (after[0] - plain[0]) / by)
