"""Tolerance-sized nuisance terms: what every real specimen differs by, part of every model that is
compared.

They are effects like any other, one copy per place, with a prior as wide as the tolerance. An
effect of the catalogue counts only beyond what they explain.

    background = {"muscle": SmoothGain("force_map", ("position", 0.0, 0.25), tolerance=0.03)}
"""

from __future__ import annotations

from typing import Any

from pamid.model.effect import KINDS, Effect
from pamid.model.parameter import Parameter
from pamid.symbolic.vocabulary import Expr, Number, clip, where

LEVEL = 0.3  # of the tolerance: what a single place may be off as a whole
HALF_WARM = 0.3  # of the longest recording: where nobody says how long the machine warms up
FULL_TOLERANCE_DEGREE = 3  # degree up to which a bend may take the whole tolerance
REACH = 3.0  # tolerances a nuisance term may go to: what lies beyond is structure


class Background(Effect):
    """Base of the nuisance terms; `name` is what the report calls them."""

    family = "background"
    kinds = tuple(KINDS)

    def __init__(self, name: str, tolerances: dict[str, float]) -> None:
        self.name = name  # type: ignore[misc]
        self.parameters = tuple(  # type: ignore[misc]
            Parameter(
                term,
                0.0,
                low=-REACH * tolerance,
                high=REACH * tolerance,
                spread=tolerance,
                null=0.0,
                source=f"tolerance {tolerance:g}",
            )
            for term, tolerance in tolerances.items()
        )


class SmoothGain(Background):
    """value * (1 + level + a smooth function of one signal, of a second one, and a slow drift),
    within the tolerance.

    over     (signal, low, high): Chebyshev terms of degree 1..degree over that range; from the
    fourth on their
             tolerance falls with the degree, as a measured map's roughness does
    along    (signal, low, high): two such terms
    drift    a change as the machine warms up, half of it within `warming_s` of the recording's
             start; where that is not said, within a share of the longest recording
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
        self.over, self.along, self.degree, self.level, self.drift = (
            over,
            along,
            degree,
            level,
            drift,
        )
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
        total = total + _chebyshev(
            at, self.over, [getattr(p, f"bend_{i}") for i in range(1, self.degree + 1)]
        )
        if self.along:
            total = total + _chebyshev(at, self.along, [p.along_1, p.along_2])
        if self.drift:
            half = p.warming if self.warming_s is None else self.warming_s
            total = total + p.drift * (at.time / (at.time + half))
        return value * (1.0 + total)


def _chebyshev(at: Any, over: tuple[str, float, float], weights: list[Expr]) -> Number:
    """Weighted Chebyshev polynomials of degree 1, 2, ... in a signal scaled to a range."""
    signal, low, high = over
    s = clip((getattr(at, signal) - low) * (2.0 / (high - low)) - 1.0, -1.2, 1.2)
    before: Number = 1.0
    here: Number = s
    total: Number = 0.0
    for weight in weights:
        total = total + weight * here
        before, here = here, 2.0 * s * here - before
    return total


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
