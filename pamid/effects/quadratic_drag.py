"""Drag that grows with the square of speed.

What it is
    A body that pushes a fluid aside, a piston that presses oil through an orifice, a fan: the force
    against the motion grows with the square of the speed.
What it looks like
    Nothing is felt at slow speed; the fastest strokes fall short; halving the amplitude quarters
    the missing force. Large swings die out faster than small ones.
Looks like it
    Viscous friction (a straight line; the two part only where fast and slow strokes are both
    recorded); dry friction bends the other way; saturation of the drive also trims the fastest
    strokes, but at rest as well.
Equation
    value -= drag * velocity * |velocity|
References
    Hoerner (1965), Fluid-Dynamic Drag, published by the author; Merritt (1967), Hydraulic Control
    Systems, Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class QuadraticDrag(Effect):
    family = "drag"
    general_kinds = ("motion",)
    signals = ("velocity",)
    parameters = (
        Parameter.slope("drag", "velocity/velocity", 0.05, 0.0, 2.0, spread=0.2).with_source(
            "estimate: 2-20 % of the force at full speed"
        ),
    )
    symptoms = ("speed",)
    look_alikes = ("viscous-friction", "coulomb-friction", "saturation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.drag * at.velocity * absolute(at.velocity)
