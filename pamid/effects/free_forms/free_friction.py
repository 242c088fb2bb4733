"""Friction of no known law.

What it is
    A force that depends on the velocity, and at rest holds as friction does: whatever curve it has
    over the speed, and as unequal as it may be in the two directions.
What it looks like
    What is missing, seen over the velocity, falls onto a line through the origin, or onto a line
    that jumps there.
Looks like it
    Hysteresis, where most of the motion is short and to and fro; a lag of the drive, where the
    force is fast.
Equation
    value -= sticking max(s, 0) + sticking_back min(s, 0) + sum_k c_k ramp_k(velocity),
    s = stop(position, give) / give; ramps between 0, 0.1, 0.35, 0.65 and 1 of the range
References
    Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7); Eilers, Marx (1996),
    Statistical Science 11(2), 89-121.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, expression, maximum, minimum, sign, stop
from pamid.model.free_form import FreeFormEffect, coefficient, half_width, ramps, rises
from pamid.model.parameter import Parameter

SPEEDS = (0.1, 0.35, 0.65, 1.0)


class FreeFriction(FreeFormEffect):
    """A function of the velocity that sticks."""

    family = "friction"
    kinds = ("motion", "actuator-force")
    signals = ("velocity",)
    parameters = (
        coefficient("sticking", 0.3, 0.5),
        coefficient("sticking_back", 0.3, 0.5),
        *rises(SPEEDS, 0.5, 0.5),
        half_width("velocity"),
        Parameter.held("give", 0.001, 0.0001, 0.02, size="position").with_source(
            "presliding of a thousandth of the stroke"
        ),
    )
    look_alikes = ("coulomb-friction", "viscous-friction", "quadratic-drag")
    along = "velocity"
    shown = "friction beyond that of the rig"
    known_by = "a function of the velocity"

    @classmethod
    def placed(cls, low: float, high: float) -> dict[str, float]:
        return {"half": max(abs(low), abs(high))}

    def shapes(self, x: Expr, p: Any) -> list[Expr]:
        """Shapes for a motion that has long kept its direction."""
        return self._with_bend(sign(x), x, p)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        bend = stop(at.position, p.give) / p.give
        return self.added_up(self._with_bend(bend, at.velocity, p), value, p)

    def _with_bend(self, bend: Expr, velocity: Expr, p: Any) -> list[Expr]:
        sticking = [maximum(bend, 0.0), minimum(bend, 0.0)]
        return [*sticking, *ramps(expression(velocity), 0.0, p.half, SPEEDS)]
