"""A value of which one side is cut off.

What it is
    A diode, a check valve, an amplifier or pump that works one way only: the negative side does not
    get through. `share` is the part of it that is lost (1: all of it).
What it looks like
    Half of every swing is missing; the mean moves with the amplitude; even harmonics of a sine
    drive appear.
Looks like it
    An offset (does not grow with the amplitude); saturation (acts on both sides); friction or
    damping that differs between the directions, which shows in the speed and not in the command.
Equation
    value -= share * min(value, 0)
References
    Gelb, Vander Velde (1968), Multiple-Input Describing Functions and Nonlinear System Design,
    McGraw-Hill; Schoukens, Ljung (2019), Nonlinear System Identification: A User-Oriented Road Map,
    IEEE Control Systems 39(6).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, minimum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Rectification(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter.share("share", 1.0, 0.0, 1.0, spread=0.5, tries=(0.3,)).with_source(
            "1: an ideal diode"
        ),
    )
    symptoms = ("saturates", "direction")
    look_alikes = ("full-wave-rectification", "saturation", "offset", "gain-error")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.share * minimum(value, 0.0)
