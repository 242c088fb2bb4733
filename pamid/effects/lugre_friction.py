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

from __future__ import annotations

from typing import Any

from pamid.effects.stribeck_friction import falling_level
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.symbolic.vocabulary import Expr, Number, absolute, bristle


class LugreFriction(Effect):
    """LuGre friction with the bristle held by the engine, exact over a step one way; never stiff in
    its state."""

    family = "friction"
    kinds = ("motion",)
    signals = ("position", "velocity")
    parameters = (
        Parameter(
            "level",
            0.03,
            low=0.0,
            high=0.2,
            spread=0.08,
            size="value",
            null=0.0,
            label="{value}",
            source="shaft bearings and chain: 0.05-1 N m on a 10 N m joint",
        ),
        Parameter(
            "breakaway",
            1.5,
            low=1.0,
            high=2.5,
            spread=0.4,
            source="1.1-2 times the sliding friction",
        ),
        Parameter(
            "speed",
            0.025,
            low=0.005,
            high=0.2,
            spread=2.5,
            log=True,
            size="velocity",
            tries=(0.1,),
            source="0.01-0.2 rad/s on a joint that reaches 2 rad/s",
        ),
        Parameter(
            "give",
            0.0015,
            low=0.0007,
            high=0.02,
            spread=3.0,
            log=True,
            size="travel",
            hard=True,
            source="bristle stiffness of 150-900 N m/rad: 0.5-2 mrad",
        ),
        Parameter(
            "settling",
            0.667,
            low=0.0,
            high=1.0,
            spread=0.333,
            size="period",
            fitted=False,
            source="bristle damping over stiffness; kept below a sample so that it is never stiff",
        ),
    )
    look_alikes = ("coulomb-friction", "stribeck-friction", "maxwell-slip-hysteresis")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        reach = p.give * falling_level(at, p)
        bent = bristle(at.position, reach)
        bending = at.velocity - absolute(at.velocity) * bent / reach
        return value - p.level * (bent + p.settling * bending) / p.give
