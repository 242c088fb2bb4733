"""A free form of a family: the common property of the family, without a law.

A friction of no known law is still an odd or even function of the velocity; a spring of no known
law is a function of the position. A free form fixes the family and leaves the curve to the
recordings. It is a sum of fixed shapes over the range of the recordings, linear in its
coefficients,

    y(x) = sum_k c_k phi_k(x),    c_k ~ N(0, spread_k^2),

so that it is zero without coefficients, and stays at zero where the recordings show nothing. The
shapes of a function are ramps between knots: their coefficients are the rises from knot to knot,
and the prior of each is that of a random walk, with a variance in proportion to the distance. That
is a penalty on slopes: Eilers and Marx (1996), Statistical Science 11(2), 89-121. Beyond the last
knot the curve is constant, so that no effect can run away.

Free forms take no part in the ranking of causes: they name the family of an effect outside the
catalogue (`pamid.diagnosis.family_forms`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import Expr, Number, clip, expression, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

PLACED = "placed over the range that the recordings reach"
SHRUNKEN = "shrunken: nothing, unless the recordings say otherwise"
CURVE_POINTS = 81  # of a curve
QUARTERS = (0.25, 0.5, 0.75, 1.0)  # knots of a curve, shares of half the range
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh")
SLIPS = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # widths of the stops of a loop, halves of the range


@dataclass(frozen=True)
class FormShapes:
    """The curve of a free form over x (n,): y = base (n,) + columns (n, k) @ coefficients (k,),
    SI."""

    x: Array
    base: Array
    columns: Array


class FreeFormEffect(Effect):
    """Base of all free forms: `shapes` are the functions, `act` adds them up."""

    along: ClassVar[str] = ""  # the signal that its curve is drawn over
    shown: ClassVar[str] = ""  # quantity of its curve
    known_by: ClassVar[str] = ""  # common property of its family, in words
    subtracted: ClassVar[bool] = True  # its curve is taken off the value; else it is added

    @classmethod
    def coefficients(cls) -> tuple[str, ...]:
        """The parameters that the form is linear in, in the order of its shapes."""
        return tuple(p.name for p in cls.parameters if p.fitted)

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        """A function of x per coefficient."""
        raise NotImplementedError

    def added_up(self, shapes: Sequence[Number], value: Expr, p: Any) -> Number:
        """The value with these shapes taken off, or added."""
        whole: Number = 0.0
        for name, shape in zip(self.coefficients(), shapes, strict=True):
            whole = whole + getattr(p, name) * shape
        return value - whole if self.subtracted else value + whole

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        x = value if self.along == "value" else getattr(at, self.along)
        return self.added_up(self.shapes(x, p), value, p)

    @classmethod
    def placed(cls, low: float, high: float) -> dict[str, float]:
        """Places of its shapes (SI, by parameter), for a signal that goes from low to high."""
        return {"middle": 0.5 * (low + high), "half": 0.5 * (high - low)}

    def curve(self, p: Any, low: float, high: float) -> FormShapes:
        """Curve that `act` subtracts or adds between low and high; p: numbers (SI)."""
        x = np.linspace(low, high, CURVE_POINTS)
        columns = [[float(expression(s)) for s in self.shapes(expression(v), p)] for v in x]
        return FormShapes(x, np.zeros_like(x), np.array(columns))


class FreeCurve(FreeFormEffect):
    """Base of the forms whose curve is an offset and ramps between quarters of the range."""

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        return [expression(1.0), *ramps(x, p.middle, p.half, QUARTERS)]


class FreeLoop(FreeFormEffect):
    """Base of the forms that remember where a signal turned: a bank of stops, each of which comes
    to 1."""

    @classmethod
    def placed(cls, low: float, high: float) -> dict[str, float]:
        return {"half": 0.5 * (high - low)}

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        return [stop(x, slip * p.half) / (slip * p.half) for slip in SLIPS]

    def curve(self, p: Any, low: float, high: float) -> FormShapes:
        """The bank on its way up from low to high and back, as it closes after the first time."""
        up = np.linspace(low, high, CURVE_POINTS)
        way = np.concatenate([up, up[::-1]])
        widths = p.half * np.array(SLIPS)
        held, columns = np.zeros(len(widths)), np.empty((len(way), len(widths)))
        before = low
        for x, row in zip(np.tile(way, 2), np.tile(np.arange(len(way)), 2), strict=True):
            held = np.clip(held + (x - before), -widths, widths)
            before, columns[row] = x, held / widths
        return FormShapes(way, np.zeros_like(way), columns)


def ramps(x: Number, middle: Number, half: Number, knots: Sequence[float]) -> list[Expr]:
    """Functions that rise from 0 to 1 between two neighbouring knots (shares of half, from 0 on)
    above the middle, and fall from 0 to -1 between the same below it: an odd function has the same
    coefficients on both sides, an even function opposite coefficients."""
    share = (expression(x) - middle) / half
    columns = []
    for side in (1.0, -1.0):
        for before, after in zip((0.0, *knots), knots, strict=False):
            rise = clip((side * share - before) * (1.0 / (after - before)), 0.0, 1.0)
            columns.append(side * rise)
    return columns


def rises(
    knots: Sequence[float], spread: float, most: float, size: str = "value"
) -> tuple[Parameter, ...]:
    """Coefficients of `ramps`: the rises above the middle, then those below. spread: of the whole
    way to the last knot, of which every rise has its share (a random walk); most: of any single
    rise; both in multiples of the size."""
    return tuple(
        coefficient(f"{side}_{place}", spread * math.sqrt((after - before) / knots[-1]), most, size)
        for side in ("above", "below")
        for place, before, after in zip(ORDINALS, (0.0, *knots), knots, strict=False)
    )


def elements(spread: float, most: float) -> tuple[Parameter, ...]:
    """Coefficients of the stops of a loop; spread and most in multiples of the size."""
    names = [f"{place}_element" for place in ORDINALS[: len(SLIPS)]]
    return tuple(coefficient(name, spread, most) for name in names)


def coefficient(name: str, spread: float, most: float, size: str = "value") -> Parameter:
    """A coefficient by itself; spread and most in multiples of the size."""
    return Parameter(name, 0.0, -most, most, spread=spread, size=size, null=0.0, source=SHRUNKEN)


def places(signal: str) -> tuple[Parameter, Parameter]:
    """Middle and half width of the range that the shapes cover, in multiples of the signal's
    size."""
    return (
        Parameter.held("middle", 0.0, -10.0, 10.0, size=signal, source=PLACED),
        half_width(signal),
    )


def half_width(signal: str) -> Parameter:
    """Half width of the range that the shapes cover, in multiples of the signal's size."""
    return Parameter.held("half", 1.0, 0.001, 10.0, size=signal, source=PLACED)
