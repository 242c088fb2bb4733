"""Muscle hysteresis as parallel elasto-slip elements.

What it is
    Threads rub on threads and on rubber. Four springs in parallel, each slipping at its own
    stretch, hold back every change of length; the memory is non-local, so minor loops close. The
    friction grows with the pressure that presses the braid together.
What it looks like
    Static force-contraction and pressure-angle loops that do not depend on the rate (0.01-1 Hz);
    their width grows with pressure and, up to a few reaches, with the stroke.
Looks like it
    Dry friction in the joint (width independent of pressure); muscle damping (grows with the rate);
    Bouc-Wen and Prandtl-Ishlinskii forms of the same loops; thread friction, which has one short
    reach.
Equation
    force -= A(p) sum_i w_i stop(contraction, d_i)/d_i; A = level (0.2 + 0.8 p/6 bar), w = .4 .3 .2
    .1, d = (0.1, 0.4, 1, 2.5) reach
References
    Vo-Minh, Tjahjowidodo, Ramon, Van Brussel (2011), IEEE/ASME Trans. Mechatronics 16(1), 177-186.
"""

from __future__ import annotations

from typing import Any

from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.symbolic.vocabulary import Expr, Number, expression, maximum, stop

NOMINAL_PA = 6e5
ELEMENTS = ((0.4, 0.1), (0.3, 0.4), (0.2, 1.0), (0.1, 2.5))  # (weight, stretch in reaches)


def pressed(at: Any) -> Expr:
    """How much of the friction at 6 bar is there at this pressure; 1 where the port offers no
    pressure."""
    if not at.offers("pressure"):
        return expression(1.0)
    return 0.2 + (0.8 / NOMINAL_PA) * maximum(at.pressure, 0.0)


class MaxwellSlipHysteresis(Effect):
    """Four elasto-slip elements, stiffer under pressure; `level` is the friction force at 6 bar."""

    family = "muscle-hysteresis"
    kinds = ("actuator-force",)
    signals = ("position",)
    parameters = (
        Parameter(
            "level",
            0.05,
            low=0.0,
            high=0.25,
            spread=0.05,
            size="value",
            null=0.0,
            label="{value}",
            source="20-80 N at 6 bar; data sheet: at most 3 % of 1500 N",
        ),
        Parameter(
            "reach",
            0.05,
            low=0.008,
            high=0.4,
            spread=2.5,
            log=True,
            size="position",
            tries=(0.02, 0.15),
            source="estimate: 0.4 % of contraction",
        ),
    )
    look_alikes = (
        "bouc-wen-hysteresis",
        "prandtl-ishlinskii-hysteresis",
        "thread-friction",
        "coulomb-friction",
    )
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        held: Number = 0.0
        for weight, stretch in ELEMENTS:
            width = stretch * p.reach
            held = held + weight * stop(at.position, width) / width
        return value - p.level * pressed(at) * held
