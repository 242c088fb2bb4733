"""Dry friction of bending bristles.

What it is
    The contact is a brush: bristles bend with the motion and slip when bent too far. This gives
    presliding stiffness, a breakaway that depends on how fast it is approached, friction that lags
    the speed and damping of the bristles.
What it looks like
    A small spring-like motion before the arm breaks away; loops in presliding; otherwise as dry
    friction with a level that falls with speed.
Looks like it
    Coulomb and Stribeck friction (same family, apart only in presliding, below 0.1 degree, and at
    creep speed).
Equation
    z = bristle(position, give g), g = 1 + (breakaway - 1) exp(-(velocity/speed)^2);
    value -= level (z + settling (velocity - |velocity| z/(give g))) / give
References
    Canudas de Wit, Olsson, Astrom, Lischinsky (1995), IEEE Trans. Automatic Control 40(3), 419-425.
"""

from typing import Any

from pamid.effects.stribeck_friction import FALLING, falling_level
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, bristle
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class LugreFriction(Effect):
    """LuGre friction with the bristle held by the engine, exact over a monotonic step; never stiff
    in its state."""

    family = "friction"
    kinds = ("motion",)
    signals = ("position", "velocity")
    parameters = (
        Parameter.level(0.03, 0.0, 0.2, spread=0.08).with_source(
            "shaft bearings and chain: 0.05-1 N m on a 10 N m joint"
        ),
        *FALLING,
        Parameter.width(
            "give", 0.0015, 0.0007, 0.02, factor=3.0, size="travel", hard=True
        ).with_source("bristle stiffness of 150-900 N m/rad: 0.5-2 mrad"),
        Parameter.held("settling", 0.667, 0.0, 1.0, spread=0.333, size="period").with_source(
            "bristle damping over stiffness; kept below a sample so that it is never stiff"
        ),
    )
    symptoms = ("reversals", "stops-short")
    look_alikes = ("coulomb-friction", "stribeck-friction", "maxwell-slip-hysteresis")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        reach = p.give * falling_level(at, p)
        bent = bristle(at.position, reach)
        bending = at.velocity - absolute(at.velocity) * bent / reach
        return value - p.level * (bent + p.settling * bending) / p.give
