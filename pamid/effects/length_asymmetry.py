"""Two muscles of unequal length.

What it is
    Clamping and chain leave a muscle longer than the other when the joint stands in the middle:
    its contraction is larger by half the difference, that of the other smaller.
What it looks like
    An angle away from the middle at equal pressures, the same at every pressure.
Looks like it
    An offset of the angle sensor, exactly: the two are the same to every experiment without an
    absolute mechanical reference. Unequal strength: there the middle moves with the pressure.
Equation
    force += law(contraction + side * difference / 2, p) - law(contraction, p)
References
    Tondu, Lopez (2000), IEEE Control Systems Magazine 20(2), 15-38; Tondu (2012), J. Intelligent
    Material Systems and Structures 23(3), 225-253.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class LengthAsymmetry(Effect):
    family = "asymmetry"
    kinds = ("actuator-force",)
    signals = ("position", "pressure", "side", "law")
    parameters = (
        Parameter.share("difference", 0.01, -0.05, 0.05, spread=0.01).with_source(
            "estimate: contractions differ by +-1 %"
        ),
    )
    symptoms = ("direction",)
    look_alikes = ("angle-sensor-offset", "force-asymmetry")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        shifted = at.position + 0.5 * p.difference * at.side
        return value + at.law(shifted, at.pressure) - at.law(at.position, at.pressure)
