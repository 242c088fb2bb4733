"""Drag that grows with the cube of speed.

What it is
    A force against the motion that is next to nothing at ordinary speed and steep at the top:
    turbulent air in a narrow guide, a fan load, or the first odd term of any smooth law that bends
    upwards.
What it looks like
    Slow and middle strokes fit; only the fastest ones fall short, and they do so sharply.
Looks like it
    Quadratic drag, a little less steep; saturation of the drive, which trims the fastest strokes as
    well; dry friction seen through a viscous fit, which bends the other way.
Equation
    value -= drag * velocity^3
References
    Merritt (1967), Hydraulic Control Systems, Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class CubicDrag(Effect):
    family = "drag"
    general_kinds = ("motion",)
    signals = ("velocity",)
    parameters = (
        Parameter.slope(
            "drag", "velocity/velocity/velocity", 0.05, 0.0, 2.0, spread=0.2
        ).with_source("estimate: 2-20 % of the force at full speed"),
    )
    symptoms = ("speed",)
    look_alikes = ("quadratic-drag", "viscous-friction", "saturation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.drag * at.velocity**3
