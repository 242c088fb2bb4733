"""A gain that differs from the data sheet.

What it is
    A wrong calibration factor: of an amplifier, a valve, a sensor; a wrong number of encoder lines
    or gear teeth.
What it looks like
    The error is a fixed share of the value, with the same sign on both sides and at every
    frequency.
Looks like it
    Any parameter of the rig that scales the same quantity (mass, area, motor constant): then it is
    a parameter and no missing effect; an offset, if the recording covers only one side of zero.
Equation
    value *= 1 + gain
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill; JCGM
    200:2012, International Vocabulary of Metrology.
"""

from typing import Any, ClassVar

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class GainError(Effect):
    family = "sensor-gain"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter.share("gain", 0.03, -0.3, 0.3, spread=0.05, tries=(-0.03,)).with_source(
            "estimate: uncalibrated sensors and amplifiers 1-5 %"
        ),
    )
    symptoms: ClassVar[tuple[str, ...]] = ("constant-error",)
    look_alikes: ClassVar[tuple[str, ...]] = ("offset", "saturation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + p.gain)
