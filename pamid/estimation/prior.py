"""Prior of the parameters, in prior spreads of the data sheet (`problem.Scale`): the data sheet
itself and, where it exists, an earlier fit.

The data sheet costs |s|^2. An earlier fit adds its recordings' Laplace approximation, |R (x(s) -
x(at)) + a|^2 with R'R their information and R'a half their gradient. The coordinates x make its
ridges straight: in s itself the quadratic would hold along a curved ridge only nearby.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array

# scaled parameters -> coordinates (k,), derivatives (k, k)
Coordinates = Callable[[Array], tuple[Array, Array]]

NEWTON = 4  # steps back from the other coordinates


def terms_of_sheet(s: Array, drawn: Array | None = None) -> tuple[float, Array, Array]:
    """Cost, information and half the cost's gradient of the data sheet at scaled parameters s (k,);
    drawn: where another draw of it would lie (k,)."""
    away = s.copy() if drawn is None else s - drawn
    return float(away @ away), np.eye(len(s)), away


@dataclass(frozen=True, eq=False)
class Prior:
    """The recordings of an earlier fit, in addition to the data sheet: |root (x - x at) +
    away|^2 for the k free parameters in coordinates x in which it is straight."""

    at: Array
    coordinates: Coordinates
    root: Array
    away: Array

    @classmethod
    def about(
        cls, at: Array, information: Array, gradient: Array, coordinates: Coordinates
    ) -> Prior:
        """From the information (k, k) and half the cost's gradient (k,) of those recordings at
        scaled parameters `at`."""
        turn = np.linalg.inv(coordinates(at)[1])
        values, vectors = np.linalg.eigh(turn.T @ information @ turn)
        # Small and negative eigenvalues are rounding of a difference of two inverses. Their
        # gradient, divided by a root, would be arbitrary.
        informed = values > 1e-9 * max(float(values[-1]), 1e-9)
        # information V E V' in x: with root = E^1/2 V' and away = E^-1/2 V' gradient the square
        # has information root'root and half gradient root'away, where anything is known at all
        roots, vectors = np.sqrt(values[informed]), vectors[:, informed]
        return cls(
            at, coordinates, roots[:, None] * vectors.T, vectors.T @ (turn.T @ gradient) / roots
        )

    def terms(self, s: Array, drawn: Array | None = None) -> tuple[float, Array, Array]:
        """Cost, information and half the cost's gradient at s, the data sheet's (see
        `terms_of_sheet`) included."""
        cost, information, gradient = terms_of_sheet(s, drawn)
        x, turned = self.coordinates(s)
        left, J = self.root @ (x - self.coordinates(self.at)[0]) + self.away, self.root @ turned
        return cost + float(left @ left), information + J.T @ J, gradient + J.T @ left

    def moved(self, s: Array, ds: Array) -> Array:
        """s + ds, but straight in the prior's coordinates: a stiff ridge is not left by a long step
        along it."""
        x, turned = self.coordinates(s)
        goal, solution = x + turned @ ds, s + ds  # Newton's method for x(s) = goal
        for _ in range(NEWTON):
            x, turned = self.coordinates(solution)
            solution = solution - np.linalg.lstsq(turned, x - goal, rcond=None)[0]
        return solution if np.isfinite(solution).all() else s + ds

    def drawn(self, random: np.random.Generator) -> Prior:
        """The prior as if those recordings had been made another time: for the bootstrap."""
        return replace(self, away=self.away + random.standard_normal(len(self.away)))
