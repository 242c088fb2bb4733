"""Functions of several parameters under a posterior: derivatives, spreads, names;
and the coordinates in which such a posterior is straight."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.units import column_size, split_column, unit_label
from pamid.estimation.prior import Coordinates
from pamid.estimation.problem import Fit, Problem
from pamid.model.assembly import Assembly
from pamid.model.trace import Names

Measure = Callable[[Array], float]  # all parameters (SI) -> the quantity, in its unit

NEW = 0.2  # part of a direction that must not follow from those before
STEP = 1e-5  # of a prior spread, for derivatives
# correlation with a logarithm from which on a positive parameter is taken by its logarithm
TOGETHER = 0.9
# relative: above this deviation a parameter has no logarithm; lowest value of such a parameter
LOOSE, FLOOR = 0.5, 1e-3


@dataclass(frozen=True, eq=False)
class Quantity:
    """A function of the parameters and its derivatives by the scaled ones, at the fit and at the
    data sheet."""

    name: str
    unit: str
    of: Measure
    value: float
    prior: float
    slope: Array
    slope_prior: Array
    log: bool  # positive whatever the parameters


Terms = list[tuple[Quantity, float]]  # quantities and their powers (or weights)


class Space:
    """The fit's parameters in prior spreads of the data sheet, without the background (which is
    marginalised)."""

    def __init__(self, problem: Problem, p: Array, covariance: Array) -> None:
        bounds = problem.assembly.parameters
        self.places = list(problem.free)
        self.scale = problem.scale
        self.bounds = [bounds[i] for i in self.places]
        self.names = [b.full_name for b in self.bounds]
        self.covariance, self.p = covariance, p
        self.named = [k for k, b in enumerate(self.bounds) if not b.nuisance]
        self.s = self.scale.inside(p[self.places])

    def at(self, s: Array) -> Array:
        """All parameters (SI) at scaled free ones."""
        p = self.p.copy()
        p[self.places] = self.scale.outside(s)
        return p

    def quantity(self, name: str, unit: str, of: Measure, log: bool | None = None) -> Quantity:
        """log: default: a positive function of positive parameters that rises in all of them."""
        sheet = np.zeros(len(self.s))
        value, prior, slope = of(self.at(self.s)), of(self.at(sheet)), self.slope(of, self.s)
        if log is None:
            log = bool((slope >= 0.0).all()) and all(
                self.bounds[k].low >= 0.0 for k in np.flatnonzero(slope)
            )
        return Quantity(
            name,
            unit,
            of,
            value,
            prior,
            slope,
            self.slope(of, sheet),
            log and min(value, prior) > 0.0,
        )

    def slope(self, of: Measure, s: Array) -> Array:
        """Derivatives at s by the scaled parameters, by central differences."""
        out = np.zeros(len(s))
        for k in self.named:
            step = np.zeros(len(s))
            step[k] = STEP
            out[k] = (of(self.at(s + step)) - of(self.at(s - step))) / (2.0 * STEP)
        return out

    def single(self, k: int) -> Quantity:
        """A parameter by itself, in its unit."""
        i, factor = self.places[k], self.bounds[k].factor
        return self.quantity(self.names[k], self.bounds[k].unit, lambda p: float(p[i] / factor))

    def together(self, terms: Terms) -> Quantity:
        """Product of powers of quantities (a x b^2 / c), or where any may not be positive their
        weighted sum."""
        if not all(q.log for q, _ in terms):
            name = " ".join(
                f"{'-' if n < 0.0 else '+'} {'' if abs(n) == 1.0 else f'{abs(n):g} '}{q.name}"
                for q, n in terms
            ).removeprefix("+ ")
            return self.quantity(
                name, "", lambda p: math.fsum(n * q.of(p) for q, n in terms), False
            )
        above = " x ".join(_power(q.name, n) for q, n in terms if n > 0.0)
        below = "".join(f" / {_power(q.name, -n)}" for q, n in terms if n < 0.0)
        return self.quantity(
            above + below, "", lambda p: math.prod(q.of(p) ** n for q, n in terms), True
        )

    def share_together(self, terms: Terms) -> tuple[Array, float]:
        """Derivatives of `together` of these terms (of its logarithm for a product), and its
        share."""
        log = all(q.log for q, _ in terms)
        slope, there = np.zeros(len(self.s)), np.zeros(len(self.s))
        for q, n in terms:
            slope += n * (q.slope / q.value if log else q.slope)
            there += n * (q.slope_prior / q.prior if log else q.slope_prior)
        return slope, self.share(slope, there)

    def share(self, slope: Array, slope_prior: Array) -> float:
        """Posterior over prior standard deviation of a quantity with these derivatives."""
        prior = float(np.linalg.norm(slope_prior))
        return self.spread(slope) / prior if prior else 1.0

    def spread(self, slope: Array) -> float:
        """Posterior standard deviation of a quantity with these derivatives."""
        return math.sqrt(max(float(slope @ self.covariance @ slope), 0.0))


def _power(name: str, n: float) -> str:
    return name if n == 1.0 else f"{name}^{n:g}"


def declared(assembly: Assembly) -> dict[str, Measure]:
    """The rig's combinations by name, in the unit of the name."""
    places = [(b.key, i) for i, b in enumerate(assembly.parameters) if not b.owner]

    def read(p: Array) -> dict[str, Any]:
        return assembly.rig.combinations(
            Names({key: float(p[i]) for key, i in places}, "parameter")
        )

    def measure(name: str) -> Measure:
        shown = column_size(name, 1.0)
        return lambda p: shown * float(read(p)[name])

    return {name: measure(name) for name in read(assembly.values())}


def straight_coordinates(problem: Problem, p: Array, covariance: Array) -> Coordinates:
    """Coordinates in which the ridges of a posterior (SI, scaled) are straight.

    These are the scaled parameters, as many as possible replaced by the rig's combinations, by
    their logarithms where they are positive. A ridge along which masses and centres may slide is
    straight in those. So is a ridge along which a friction grows with the scale of all inertias: a
    positive parameter tied to a logarithm is replaced by its logarithm.
    """
    space = Space(problem, p, covariance)
    chosen: list[tuple[int, Quantity]] = []
    rows = np.zeros((0, len(space.s)))
    # Gaussian elimination with pivots: a combination takes the place of the parameter that it moves
    # most and no earlier combination has taken, so that the new coordinates stay independent
    for q in declared_quantities(space, problem.assembly):
        row = q.slope / np.linalg.norm(q.slope)
        for (pivot, _), before in zip(chosen, rows, strict=True):
            row = row - row[pivot] / before[pivot] * before
        pivot = int(np.argmax(np.abs(row)))
        if abs(row[pivot]) > NEW:
            chosen.append((pivot, q))
            rows = np.vstack([rows, row])

    def coordinates(s: Array) -> tuple[Array, Array]:
        x, J = s.copy(), np.eye(len(s))
        for pivot, q in chosen:
            value, slope = q.of(space.at(s)), space.slope(q.of, s)
            least = max(value, FLOOR * q.value)
            x[pivot], J[pivot] = (math.log(least), slope / least) if q.log else (value, slope)
        return x, J

    turn = coordinates(space.s)[1]
    together = turn @ covariance @ turn.T
    spread = np.sqrt(together.diagonal())
    logs = space.scale.log | np.isin(
        np.arange(len(spread)), [pivot for pivot, q in chosen if q.log]
    )
    for k in (
        k for k in space.named if not space.scale.log[k] and all(k != pivot for pivot, _ in chosen)
    ):
        q, shared = (
            space.single(k),
            np.abs(together[k] / (spread[k] * spread))[logs].max(initial=0.0),
        )
        if q.log and shared > TOGETHER and space.spread(q.slope) < LOOSE * q.value:
            chosen.append((k, q))
    return coordinates


def declared_quantities(space: Space, assembly: Assembly) -> list[Quantity]:
    """The rig's combinations that hold a free parameter."""
    quantities = [
        space.quantity(name, unit_label(split_column(name)[1]), of)
        for name, of in declared(assembly).items()
    ]
    return [q for q in quantities if q.slope.any()]


def reported_values(fitted: Fit) -> Array:
    """All parameters (SI) as fitted; those that every recording states alike as stated."""
    p, tracks = fitted.p.copy(), fitted.problem.tracks
    for i in set.intersection(*(set(t.known) for t in tracks)):
        stated = {float(t.p[i]) for t in tracks}
        p[i] = stated.pop() if len(stated) == 1 else p[i]
    return p
