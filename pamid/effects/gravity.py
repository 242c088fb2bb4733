"""Weight of an arm that does not turn in a horizontal plane.

What it is
    A tilted axis or a vertical plane lets the weight of arm and load pull towards its lowest
    position. Two coefficients, of the sine and the cosine of the angle, hold size and direction, so
    that the zero of the angle may lie anywhere.
What it looks like
    A static torque that depends on the angle alone: opposite drifts on the two sides of the lowest
    position, equal in newton metres at every pressure.
Looks like it
    A constant offset or a soft spring over a small range of angles; unequal muscles. Tests at two
    stiffnesses of the joint separate them: the angle error of a torque goes with 1/stiffness.
Equation
    value -= sine sin(position) + cosine cos(position)
References
    Siciliano, Sciavicco, Villani, Oriolo (2009), Robotics: Modelling, Planning and Control,
    Springer.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, cos, sin
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Gravity(Effect):
    family = "gravity"
    kinds = ("motion",)
    signals = ("position",)
    unit = "N m"
    parameters = (
        Parameter.level(0.05, -0.6, 0.6, name="sine", spread=0.1).with_source(
            "m g l of 0.5-3.5 N m, tilted by 1-5 deg or hanging"
        ),
        Parameter.level(0.0, -0.6, 0.6, name="cosine", spread=0.1).with_source(
            "m g l of 0.5-3.5 N m, tilted by 1-5 deg or hanging"
        ),
    )
    symptoms = ("position", "load")
    look_alikes = ("linear-stiffness", "constant-offset", "force-asymmetry", "length-asymmetry")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - (p.sine * sin(at.position) + p.cosine * cos(at.position))
