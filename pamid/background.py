"""Tolerance-sized nuisance terms: what every real specimen differs by, part of every model that is compared.

They are effects like any other, one copy per place, with a prior as wide as the tolerance. An effect of the catalogue
counts only beyond what they explain.

    background = {"muscle": SmoothGain("force_map", "contraction", (0.0, 0.25), tolerance=0.03)}
"""

from __future__ import annotations

from typing import Any

from pamid.effect import KINDS, Effect
from pamid.equations import Expr, Number, clip, where
from pamid.parameter import Parameter

REACH = 3.0  # tolerances a nuisance term may go to: what lies beyond is structure


class Background(Effect):
    """Base of the nuisance terms; `name` is what the report calls them."""

    family = "background"
    kinds = tuple(KINDS)

    def __init__(self, name: str, tolerance: float, terms: tuple[str, ...]) -> None:
        self.name = name  # type: ignore[misc]
        self.parameters = tuple(  # type: ignore[misc]
            Parameter(t, 0.0, low=-REACH * tolerance, high=REACH * tolerance, spread=tolerance, null=0.0,
                      source=f"tolerance {tolerance:g}") for t in terms)


class SmoothGain(Background):
    """value * (1 + a smooth function of one signal, and a slope over a second one), all within the tolerance.

    over     (signal, low, high): Chebyshev terms of degree 1..degree over that range
    slope    (signal, low, high): one linear term
    """

    def __init__(self, name: str, over: tuple[str, float, float], *, tolerance: float, degree: int = 3,
                 slope: tuple[str, float, float] | None = None) -> None:
        self.over, self.slope, self.degree = over, slope, degree
        super().__init__(name, tolerance, (*(f"bend_{i}" for i in range(1, degree + 1)),
                                           *(("slope",) if slope else ())))

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        signal, low, high = self.over
        s = clip((getattr(at, signal) - low) * (2.0 / (high - low)) - 1.0, -1.2, 1.2)
        before: Number = 1.0
        here: Number = s
        total: Number = 0.0
        for i in range(1, self.degree + 1):
            total = total + getattr(p, f"bend_{i}") * here
            before, here = here, 2.0 * s * here - before
        if self.slope:
            name, bottom, top = self.slope
            total = total + p.slope * ((getattr(at, name) - bottom) * (2.0 / (top - bottom)) - 1.0)
        return value * (1.0 + total)


class SplitGain(Background):
    """value * (1 + positive) where it is positive, * (1 + negative) where it is negative: two-way tolerances."""

    def __init__(self, name: str, *, tolerance: float) -> None:
        super().__init__(name, tolerance, ("positive", "negative"))

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + where(value > 0.0, p.positive, p.negative))


class Gain(Background):
    """value * (1 + gain)."""

    def __init__(self, name: str, *, tolerance: float) -> None:
        super().__init__(name, tolerance, ("gain",))

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + p.gain)
