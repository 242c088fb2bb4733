"""Hysteresis of no known law, of a force.

What it is
    A force that depends on where the motion has turned and not on how fast it is: a bank of
    elasto-slip elements that slip after an eightieth of the range up to after four fifths of it,
    each twice as late as the element before, with a separate force.
What it looks like
    Loops of what is missing over the position, the same slow and fast, that differ with the length
    of the way.
Looks like it
    Dry friction, whose loops are rectangles; a spring, which is an element that never slips;
    damping, whose loops grow with the speed.
Equation
    value -= sum_j c_j stop(position, r_j) / r_j, r = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6) half
    the range
References
    Kuhnen (2003), European J. Control 9(4), 407-418; Iwan (1966), A distributed-element model for
    hysteresis, J. Appl. Mech. 33(4), 893-900.
"""

from typing import Any, ClassVar

import numpy as np

from pamid.engine.symbolic.vocabulary import Expr, stop
from pamid.model.free_form import (
    CURVE_POINTS,
    ORDINALS,
    FormShapes,
    FreeFormEffect,
    coefficient,
    half_width,
)

SLIPS = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # halves of the range
ELEMENT_NAMES = tuple(f"{place}_element" for place in ORDINALS[: len(SLIPS)])


def bank(x: Expr, half: Any) -> list[Expr]:
    """Stops of these widths, each of which comes to 1."""
    return [stop(x, slip * half) / (slip * half) for slip in SLIPS]


def loop(half: float, low: float, high: float) -> FormShapes:
    """The bank on its way up from low to high and back, as it closes after the first time."""
    up = np.linspace(low, high, CURVE_POINTS)
    way = np.concatenate([up, up[::-1]])
    widths = half * np.array(SLIPS)
    held, columns = np.zeros(len(widths)), np.empty((len(way), len(widths)))
    before = low
    for x, row in zip(np.tile(way, 2), np.tile(np.arange(len(way)), 2), strict=True):
        held = np.clip(held + (x - before), -widths, widths)
        before, columns[row] = x, held / widths
    return FormShapes(way, np.zeros_like(way), columns)


class FreeHysteresis(FreeFormEffect):
    """A bank of elasto-slip elements on the position."""

    family = "hysteresis"
    families: ClassVar[dict[str, str]] = {"actuator-force": "muscle-hysteresis"}
    kinds = ("motion", "actuator-force")
    signals = ("position",)
    parameters = (*(coefficient(name, 0.3, 0.5) for name in ELEMENT_NAMES), half_width("position"))
    look_alikes = ("maxwell-slip-hysteresis", "bouc-wen-hysteresis", "coulomb-friction")
    along = "position"
    shown = "force beyond that of the rig"
    known_by = "a force that remembers where the motion turned"

    @classmethod
    def placed(cls, low: float, high: float) -> dict[str, float]:
        return {"half": 0.5 * (high - low)}

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        return bank(x, p.half)

    def curve(self, p: Any, low: float, high: float) -> FormShapes:
        return loop(p.half, low, high)
