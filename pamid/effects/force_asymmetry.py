"""Two muscles of unequal strength.

What it is
    Specimens of the same type differ by 5-10 % in force. Half of the difference is given to the
    first muscle and taken from the second; their common scale is a parameter of the rig.
What it looks like
    At equal pressures the joint does not stand in the middle, and the place where it stands moves
    with the pressure; the answers to a command and to its mirror image differ.
Looks like it
    Unequal lengths or an offset of the angle sensor: there the middle does not move with pressure.
    A sweep of both pressures together separates them; nothing else does as well.
Equation
    force *= 1 + asymmetry * side / 2, side = +1 for the first muscle, -1 for the second
References
    Tondu, Lopez (2000), IEEE Control Systems Magazine 20(2), 15-38; Tondu (2012), J. Intelligent
    Material Systems and Structures 23(3), 225-253.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ForceAsymmetry(Effect):
    family = "asymmetry"
    kinds = ("actuator-force",)
    signals = ("side",)
    parameters = (
        Parameter.share("asymmetry", 0.05, -0.4, 0.4, spread=0.07).with_source(
            "specimens differ by 5-10 %, up to 19 % from the chart"
        ),
    )
    symptoms = ("direction",)
    look_alikes = ("length-asymmetry", "angle-sensor-offset")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + 0.5 * p.asymmetry * at.side)
