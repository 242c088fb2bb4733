"""Muscle hysteresis as a sum of stops, with unequal branches.

What it is
    Eight equal stops of evenly spaced widths give a loop whose curvature is spread over the whole
    reach. Measured muscle loops are often fatter on one branch; an asymmetry weighs the contracting
    against the extending branch.
What it looks like
    Rate-independent loops that keep widening with the stroke up to the reach; loading and unloading
    branches differ.
Looks like it
    Maxwell-slip and Bouc-Wen loops (symmetric, most of the bend near the reversal); dry friction,
    which has no reach.
Equation
    h = mean_j stop(contraction, r_j)/r_j, r_j = j reach/8; force -= A(p) h (1 + asymmetry h);
    A = level (0.2 + 0.8 p/6 bar)
References
    Kuhnen (2003), European J. Control 9(4), 407-418; Liu, Zang, Lin, Liu, Zhao (2017), Strojniski
    vestnik - J. Mech. Eng. 63(1), 56-64.
"""

from typing import Any

from pamid.effects.maxwell_slip_hysteresis import pressed
from pamid.engine.symbolic.vocabulary import Expr, Number, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

STOPS = 8


class PrandtlIshlinskiiHysteresis(Effect):
    """Evenly spaced stops with an asymmetry; `level` is the force at saturation and 6 bar."""

    family = "muscle-hysteresis"
    kinds = ("actuator-force",)
    signals = ("position",)
    parameters = (
        Parameter.level(0.05, 0.0, 0.25, spread=0.05).with_source(
            "20-80 N at 6 bar; data sheet: at most 3 % of 1500 N"
        ),
        Parameter.width("reach", 0.2, 0.02, 1.0, factor=2.5, tries=(0.06, 0.5)).with_source(
            "estimate: widths up to half of the stroke"
        ),
        Parameter("asymmetry", 0.0, -0.6, 0.6, spread=0.3).with_source(
            "estimate; measured loops of muscles are asymmetric"
        ),
    )
    symptoms = ("history",)
    look_alikes = (
        "maxwell-slip-hysteresis",
        "bouc-wen-hysteresis",
        "thread-friction",
        "coulomb-friction",
    )
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        held: Number = 0.0
        for j in range(1, STOPS + 1):
            width = (j / STOPS) * p.reach
            held = held + stop(at.position, width) / width
        mean = held * (1.0 / STOPS)
        return value - p.level * pressed(at) * mean * (1.0 + p.asymmetry * mean)
