"""A constant force that the model does not know.

What it is
    A tilted guide, a counterweight that does not quite balance, an amplifier whose zero is off, a
    preloaded cable.
What it looks like
    Motion one way needs more force than the other, at every place and every speed; without drive
    the mechanism creeps away unless friction holds it.
Looks like it
    An offset of the command (the same for a drive without gain); a spring far from its rest;
    friction that differs between the two directions.
Equation
    value += level
References
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on Nonlinear
    System Identification Benchmarks, Eindhoven.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ConstantOffset(Effect):
    family = "offset"
    general_kinds = ("motion",)
    parameters = (
        Parameter.level(0.02, -0.5, 0.5, spread=0.1, tries=(-0.02,)).with_source(
            "estimate: tilt, preload and amplifier zero, 1-10 % of the force"
        ),
    )
    symptoms = ("direction", "constant-error")
    look_alikes = ("offset", "linear-stiffness", "gravity")
    absorbed_by = ("offset",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value + p.level
