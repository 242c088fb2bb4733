"""Vectors of expressions, and spatial vectors about the world's origin.

A motion vector is (angular, linear of the point at the origin), a force vector (moment about the
origin, force); the inertia of a body or of several is (mass, first moment, second moment about the
origin). Featherstone (2008), Rigid Body Dynamics Algorithms, ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import ZERO, Expr, Number, expression

Vec = NDArray[np.object_]  # (3,) of expressions
Mat = NDArray[np.object_]  # (3, 3)

#: every number of an array as an expression
_expressions: Callable[[Any], NDArray[np.object_]] = np.frompyfunc(expression, 1, 1)


def vec(values: Sequence[Number]) -> Vec:
    """Numbers or expressions as a vector, rows of them as a matrix."""
    return _expressions(np.array(values, object))


NOUGHT: Vec = vec([0.0, 0.0, 0.0])
IDENTITY: Mat = _expressions(np.eye(3))


def times(s: Any, a: NDArray[np.object_]) -> NDArray[np.object_]:
    """s a; the operator of an array would be left to the expression, which knows no arrays."""
    return np.asarray(np.multiply(s, a))


def cross(a: Vec, b: Vec) -> Vec:
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def rotation(quaternion: Sequence[float]) -> Array:
    """The matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def constant(m: Array) -> NDArray[np.object_]:
    """Numbers as expressions; those that are 0 or 1 up to rounding are exact."""
    return _expressions(clean(m))


def clean(values: Array) -> Array:
    """Numbers without the rounding errors of integers."""
    near = np.round(values)
    return np.where(np.abs(values - near) < 1e-15, near, values)


class Spatial(NamedTuple):
    """A motion vector (angular, linear) or a force vector (moment, force)."""

    a: Vec
    b: Vec

    def __add__(self, other: Spatial) -> Spatial:  # type: ignore[override]
        return Spatial(self.a + other.a, self.b + other.b)

    def by(self, s: Number) -> Spatial:
        return Spatial(times(s, self.a), times(s, self.b))

    def dot(self, other: Spatial) -> Expr:
        """Power of a force along a motion."""
        power: Expr = self.a @ other.a + self.b @ other.b
        return power

    def cross(self, other: Spatial) -> Spatial:
        """Motion x motion."""
        return Spatial(cross(self.a, other.a), cross(self.a, other.b) + cross(self.b, other.a))

    def cross_force(self, force: Spatial) -> Spatial:
        """Motion x* force."""
        return Spatial(cross(self.a, force.a) + cross(self.b, force.b), cross(self.a, force.b))

    def mapped(self, way: Callable[[Expr], Expr]) -> Spatial:
        """Apply a function to every component."""
        return Spatial(*(np.array([way(x) for x in part]) for part in self))


AT_REST = Spatial(NOUGHT, NOUGHT)


class Inertia(NamedTuple):
    """mass, first moment, and second moment, about the origin."""

    mass: Expr
    first: Vec
    second: Mat

    def __add__(self, other: Inertia) -> Inertia:  # type: ignore[override]
        return Inertia(self.mass + other.mass, self.first + other.first, self.second + other.second)

    def by(self, s: Number) -> Inertia:
        return Inertia(s * self.mass, times(s, self.first), times(s, self.second))

    def momentum(self, v: Spatial) -> Spatial:
        """Inertia times motion."""
        return Spatial(
            self.second @ v.a + cross(self.first, v.b),
            times(self.mass, v.b) + cross(v.a, self.first),
        )

    def moved(self, turn: Mat, to: Vec) -> Inertia:
        """Inertia in a frame in which its frame is rotated and lies at `to`."""
        half, first = turn @ self.second, turn @ self.first
        whole = first + times(self.mass, to)
        # about the new origin: + (first . to + to . whole) 1 - to first' - whole to'
        trace = first * to + to * whole
        second = np.empty((3, 3), object)
        for i in range(3):
            j, k = (m for m in range(3) if m != i)
            second[i, i] = half[i] @ turn[i] + (trace[j] + trace[k])
            for k in range(i + 1, 3):
                moved = to[i] * first[k] + whole[i] * to[k]
                second[i, k] = second[k, i] = half[i] @ turn[k] - moved
        return Inertia(self.mass, whole, second)


MASSLESS = Inertia(ZERO, NOUGHT, _expressions(np.zeros((3, 3))))


class Coriolis(NamedTuple):
    """2 B of a body, the change of the velocity-dependent force with a motion.

    Only the angular part of the motion matters: (square w, -2 force x w).

    B(I, v) = ((v x*) I - I (v x) + (I v) x*) / 2

    of Echeandia and Wensing (2021), J. Comput. Nonlinear Dyn. 16(9), 091004. Written out about the
    origin, the halves that meet the linear part cancel, and the upper half is

    2 w x S - tr(S) w x + 2 (v . h) 1 - 2 v h'
    """

    square: Mat
    force: Vec  # the body's linear momentum

    def __add__(self, other: Coriolis) -> Coriolis:  # type: ignore[override]
        return Coriolis(self.square + other.square, self.force + other.force)

    def along(self, motion: Spatial) -> Spatial:
        """2 B motion"""
        return Spatial(self.square @ motion.a, times(-2.0, cross(self.force, motion.a)))

    def against(self, motion: Spatial) -> Vec:
        """motion' 2 B, whose linear part is zero"""
        return self.square.T @ motion.a - times(2.0, cross(motion.b, self.force))


UNMOVED = Coriolis(MASSLESS.second, NOUGHT)


def coriolis(inertia: Inertia, v: Spatial, momentum: Spatial) -> Coriolis:
    """2 B of a body of this inertia and momentum that moves with v."""
    s, w = inertia.second, v.a
    trace, over = s[0, 0] + s[1, 1] + s[2, 2], v.b @ inertia.first
    square = np.empty((3, 3), object)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turning = times(w[j], s[k]) - times(w[k], s[j])
        square[i] = times(2.0, turning - times(v.b[i], inertia.first))
        square[i, i] = square[i, i] + 2.0 * over
        # - tr(S) w x
        square[i, j] = square[i, j] + trace * w[k]
        square[i, k] = square[i, k] - trace * w[j]
    return Coriolis(square, momentum.b)
