"""Vectors of expressions, and spatial vectors about the world's origin.

A motion vector is (angular, linear of the point at the origin), a force vector (moment about the
origin, force); the inertia of a body or of several is (mass, first moment, second moment about the
origin). Featherstone (2008), Rigid Body Dynamics Algorithms, ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.symbolic.vocabulary import ZERO, Expr, Number, expression

Array = NDArray[np.float64]
Vec = tuple[Expr, Expr, Expr]
Mat = tuple[Vec, Vec, Vec]  # rows
NOUGHT: Vec = (ZERO, ZERO, ZERO)
IDENTITY: Mat = tuple(  # type: ignore[assignment]
    tuple(expression(1.0 if i == k else 0.0) for k in range(3)) for i in range(3)
)


def vec(values: Sequence[Number]) -> Vec:
    a, b, c = values
    return expression(a), expression(b), expression(c)


def plus(a: Vec, b: Vec) -> Vec:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vec, b: Vec) -> Vec:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def times(s: Number, a: Vec) -> Vec:
    return s * a[0], s * a[1], s * a[2]


def dot(a: Vec, b: Vec) -> Expr:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec, b: Vec) -> Vec:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def through(m: Mat, a: Vec) -> Vec:
    """m a"""
    return dot(m[0], a), dot(m[1], a), dot(m[2], a)


def transposed(m: Mat) -> Mat:
    return tuple(zip(*m, strict=True))  # type: ignore[return-value]


def product(m: Mat, n: Mat) -> Mat:
    columns = list(zip(*n, strict=True))
    rows = [tuple(dot(row, c) for c in columns) for row in m]  # type: ignore[arg-type]
    return rows[0], rows[1], rows[2]  # type: ignore[return-value]


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


def constant(m: Array) -> Mat:
    """Matrix of numbers; entries that are zero or one up to rounding are exact."""
    near = np.round(m)
    clean = np.where(np.abs(m - near) < 1e-15, near, m)
    return vec(clean[0]), vec(clean[1]), vec(clean[2])


class Spatial(NamedTuple):
    """A motion vector (angular, linear) or a force vector (moment, force)."""

    a: Vec
    b: Vec

    def __add__(self, other: Spatial) -> Spatial:  # type: ignore[override]
        return Spatial(plus(self.a, other.a), plus(self.b, other.b))

    def by(self, s: Number) -> Spatial:
        return Spatial(times(s, self.a), times(s, self.b))

    def dot(self, other: Spatial) -> Expr:
        """Power of a force along a motion."""
        return dot(self.a, other.a) + dot(self.b, other.b)

    def cross(self, other: Spatial) -> Spatial:
        """Motion x motion."""
        return Spatial(cross(self.a, other.a), plus(cross(self.a, other.b), cross(self.b, other.a)))

    def cross_force(self, force: Spatial) -> Spatial:
        """Motion x* force."""
        return Spatial(plus(cross(self.a, force.a), cross(self.b, force.b)), cross(self.a, force.b))


AT_REST = Spatial(NOUGHT, NOUGHT)


class Inertia(NamedTuple):
    """mass, first moment, and second moment (xx, yy, zz, xy, xz, yz), about the origin."""

    mass: Expr
    first: Vec
    second: tuple[Expr, Expr, Expr, Expr, Expr, Expr]

    def __add__(self, other: Inertia) -> Inertia:  # type: ignore[override]
        second = tuple(a + b for a, b in zip(self.second, other.second, strict=True))
        return Inertia(self.mass + other.mass, plus(self.first, other.first), second)  # type: ignore[arg-type]

    def by(self, s: Number) -> Inertia:
        second = tuple(s * a for a in self.second)
        return Inertia(s * self.mass, times(s, self.first), second)  # type: ignore[arg-type]

    def matrix(self) -> Mat:
        """The second moment."""
        xx, yy, zz, xy, xz, yz = self.second
        return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)

    def momentum(self, v: Spatial) -> Spatial:
        """Inertia times motion."""
        return Spatial(
            plus(through(self.matrix(), v.a), cross(self.first, v.b)),
            plus(times(self.mass, v.b), cross(v.a, self.first)),
        )

    def moved(self, turn: Mat, to: Vec) -> Inertia:
        """Inertia in a frame in which its frame is rotated and lies at `to`."""
        m, first = self.matrix(), through(turn, self.first)
        half = product(turn, m)
        turned = [
            dot(half[i], turn[k]) for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ]
        whole = plus(first, times(self.mass, to))
        # about the new origin: + (first . to + to . whole) 1 - to first' - whole to'
        trace = [first[i] * to[i] + to[i] * whole[i] for i in range(3)]
        second = (
            turned[0] + (trace[1] + trace[2]),
            turned[1] + (trace[0] + trace[2]),
            turned[2] + (trace[0] + trace[1]),
            turned[3] - (to[0] * first[1] + whole[0] * to[1]),
            turned[4] - (to[0] * first[2] + whole[0] * to[2]),
            turned[5] - (to[1] * first[2] + whole[1] * to[2]),
        )
        return Inertia(self.mass, whole, second)


MASSLESS = Inertia(ZERO, NOUGHT, (ZERO,) * 6)


class Coriolis(NamedTuple):
    """2 B of a body, the change of the velocity-dependent force with a motion.

    Only the angular part of the motion matters: (square w, -2 force x w).

    B(I, v) = ((v x*) I - I (v x) + (I v) x*) / 2

    of Echeandia and Wensing (2021), J. Comput. Nonlinear Dyn. 16(9), 091004. Written out about the
    origin, the halves that meet the linear part cancel, and the upper one is

    2 w x S - tr(S) w x + 2 (v . h) 1 - 2 v h'
    """

    square: Mat
    force: Vec  # the body's linear momentum

    def __add__(self, other: Coriolis) -> Coriolis:  # type: ignore[override]
        rows = [plus(a, b) for a, b in zip(self.square, other.square, strict=True)]
        return Coriolis((rows[0], rows[1], rows[2]), plus(self.force, other.force))

    def along(self, motion: Spatial) -> Spatial:
        """2 B motion"""
        return Spatial(through(self.square, motion.a), times(-2.0, cross(self.force, motion.a)))

    def against(self, motion: Spatial) -> Vec:
        """motion' 2 B, whose linear part is zero"""
        columns = tuple(zip(*self.square, strict=True))
        return minus(
            through(columns, motion.a),  # type: ignore[arg-type]
            times(2.0, cross(motion.b, self.force)),
        )


UNMOVED = Coriolis((NOUGHT, NOUGHT, NOUGHT), NOUGHT)


def coriolis(inertia: Inertia, v: Spatial, momentum: Spatial) -> Coriolis:
    """2 B of a body of this inertia and momentum that moves with v."""
    second = inertia.matrix()
    trace = second[0][0] + second[1][1] + second[2][2]
    w = v.a
    over = dot(v.b, inertia.first)
    rows = []
    for i in range(3):
        a, b = w[(i + 1) % 3], w[(i + 2) % 3]
        turning = minus(times(a, second[(i + 2) % 3]), times(b, second[(i + 1) % 3]))
        row = [2.0 * (turning[k] - v.b[i] * inertia.first[k]) for k in range(3)]
        row[i] = row[i] + 2.0 * over
        # - tr(S) w x
        row[(i + 1) % 3] = row[(i + 1) % 3] + trace * b
        row[(i + 2) % 3] = row[(i + 2) % 3] - trace * a
        rows.append((row[0], row[1], row[2]))
    return Coriolis((rows[0], rows[1], rows[2]), momentum.b)


def mapped(way: Callable[[Expr], Expr], value: Spatial) -> Spatial:
    """Apply a function to every component."""
    a, b = (tuple(way(x) for x in part) for part in value)
    return Spatial(a, b)  # type: ignore[arg-type]
