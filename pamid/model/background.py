"""Tolerance-sized nuisance terms: the deviations of every real specimen, part of every model that
is compared.

They are effects like any other, a copy per place, with a prior as wide as the tolerance. An
effect of the catalogue counts only beyond their contribution.

    background = {"muscle": SmoothGain("force_map", ("position", 0.0, 0.25), tolerance=0.03)}
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np

from pamid.engine.symbolic.vocabulary import Expr, Number, clip, cos, where
from pamid.model.effect import KINDS, Effect
from pamid.model.parameter import Parameter

LEVEL = 0.3  # of the tolerance: deviation of a single place as a whole
HALF_WARM = 0.3  # of the longest recording: default time constant of the warm-up
FULL_TOLERANCE_DEGREE = 3  # degree up to which a bend may take the whole tolerance
ORDINARY_ROUGHNESS = 0.02  # of most maps; data/rigs/README.md
ROUGH_WAVES = 10  # terms of a rough curve: bumps as short as a quarter of the range
BEYOND_SIZE = 1.25  # of the size of a signal (95th percentile): where a rough curve ends
REACH = 3.0  # tolerances that bound a nuisance term: beyond lies structure


class Background(Effect):
    """Base of the nuisance terms; `name` is their name in the report."""

    family = "background"
    kinds = tuple(KINDS)

    def __init__(self, name: str, tolerances: dict[str, float], reach: float = REACH) -> None:
        self.name = name  # type: ignore[misc]
        self.parameters = tuple(  # type: ignore[misc]
            Parameter(
                term,
                0.0,
                low=-reach * tolerance,
                high=reach * tolerance,
                spread=tolerance,
                null=0.0,
                source=f"tolerance {tolerance:g}",
            )
            for term, tolerance in tolerances.items()
        )


def pull_of(term: Effect, strains: Sequence[float]) -> float:
    """Deviation of a term in tolerances, from those of its parameters: of a rough curve the root
    mean square, of any other the largest."""
    if isinstance(term, RoughMap):
        return float(np.sqrt(np.mean(np.square(strains))))
    return max(map(abs, strains), default=0.0)


class SmoothGain(Background):
    """value * (1 + level + a smooth function of a signal, of a second signal, and a slow drift),
    within the tolerance.

    over     (signal, low, high): Chebyshev terms of degree 1..degree over that range; from the
    fourth on their
             tolerance falls with the degree, as a measured map's roughness does
    along    (signal, low, high): two such terms
    drift    a change as the machine warms up, half of it within `warming_s` of the recording's
             start; where it is not stated, within a share of the longest recording
    """

    def __init__(
        self,
        name: str,
        over: tuple[str, float, float],
        *,
        tolerance: float,
        degree: int = 3,
        along: tuple[str, float, float] | None = None,
        level: bool = False,
        drift: bool = False,
        warming_s: float | None = None,
    ) -> None:
        self.over, self.along, self.degree = over, along, degree
        self.level, self.drift = level, drift
        terms = {"level": LEVEL * tolerance} if level else {}
        terms |= {
            f"bend_{i}": tolerance * min(1.0, FULL_TOLERANCE_DEGREE / i)
            for i in range(1, degree + 1)
        }
        terms |= {f"along_{i}": tolerance for i in (1, 2)} if along else {}
        super().__init__(name, terms | ({"drift": tolerance} if drift else {}))
        self.warming_s = warming_s
        if drift and warming_s is None:
            warming = Parameter(
                "warming",
                HALF_WARM,
                low=0.1 * HALF_WARM,
                high=1.0,
                size="time",
                fitted=False,
                source="estimate: a machine that warms up shows it within the recording",
            )
            self.parameters = (*self.parameters, warming)  # type: ignore[misc]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        total: Number = p.level if self.level else 0.0
        bends = [getattr(p, f"bend_{i}") for i in range(1, self.degree + 1)]
        total = total + _chebyshev(_scaled(at, self.over), bends)
        if self.along:
            total = total + _chebyshev(_scaled(at, self.along), [p.along_1, p.along_2])
        if self.drift:
            half = p.warming if self.warming_s is None else self.warming_s
            total = total + p.drift * (at.time / (at.time + half))
        return value * (1.0 + total)


def _scaled(at: Any, over: tuple[str, float, float]) -> Expr:
    """A signal on -1 .. 1 for a range of it, and a little beyond."""
    signal, low, high = over
    return clip((getattr(at, signal) - low) * (2.0 / (high - low)) - 1.0, -1.2, 1.2)


def _chebyshev(s: Expr, weights: list[Expr]) -> Number:
    """Weighted Chebyshev polynomials of degree 1, 2, ... in s."""
    before: Number = 1.0
    value: Number = s
    total: Number = 0.0
    for weight in weights:
        total = total + weight * value
        before, value = value, 2.0 * s * value - before
    return total


class RoughMap(Background):
    """value + of * (a rough curve over a signal): no machine follows the formula of its map
    everywhere.

    The curve is a half-range cosine series over the range of the signal (s = 0 .. 1),

        sum over i = 1 .. waves of c_i cos(i pi s)

    with a common prior for all c_i, so that its root mean square is the tolerance: a smooth random
    function by the first terms of its trigonometric series (Wahba 1990, Spline Models for
    Observational Data, chapter 2). A single term may be all of it, as the slots of a motor are a
    single wave. REACH therefore bounds the root mean square, and a single term may reach that
    bound.

    over      "value", what passes, or a signal of the port, as far as the recordings reach
    of        "value", or a signal in the same unit of which the curve is a share: where what passes
              is a balance of forces or flows, any of these
    positive  the signal is never below zero
    waves     terms: two make a whole period over the range
    """

    def __init__(
        self,
        name: str,
        over: str = "value",
        *,
        tolerance: float,
        of: str = "value",
        positive: bool = False,
        waves: int = ROUGH_WAVES,
    ) -> None:
        self.over, self.of, self.positive = over, of, positive
        each = tolerance * (2.0 / waves) ** 0.5
        terms = {f"wave_{i}": each for i in range(1, waves + 1)}
        super().__init__(name, terms, reach=REACH * waves**0.5)
        self.waves = tuple(p.name for p in self.parameters)
        reach = Parameter(
            "reach",
            BEYOND_SIZE,
            size=over,
            fitted=False,
            source="read off: what the recordings reach",
        )
        self.parameters = (*self.parameters, reach)  # type: ignore[misc]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        x = value if self.over == "value" else getattr(at, self.over)
        s = x / p.reach if self.positive else 0.5 * (x / p.reach + 1.0)
        # cos(i a) is the Chebyshev polynomial of degree i in cos a
        weights = [getattr(p, wave) for wave in self.waves]
        total = _chebyshev(cos(pi * clip(s, 0.0, 1.0)), weights)
        return value + (value if self.of == "value" else getattr(at, self.of)) * total


class SplitGain(Background):
    """value * (1 + positive) where it is positive, * (1 + negative) where it is negative: two-way
    tolerances."""

    def __init__(self, name: str, *, tolerance: float) -> None:
        super().__init__(name, {"positive": tolerance, "negative": tolerance})

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + where(value > 0.0, p.positive, p.negative))


class Gain(Background):
    """value * (1 + gain)."""

    def __init__(self, name: str, *, tolerance: float) -> None:
        super().__init__(name, {"gain": tolerance})

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + p.gain)
