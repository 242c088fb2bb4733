"""The pressure sensors read a fixed share too much or too little.

What it is
    A scale error of the pressure sensors or of their amplifier.
What it looks like
    The error of the readings is proportional to the gauge pressure; angle and forces do not see it.
Looks like it
    An offset of the sensors (needs a wide range of pressures to tell apart); a force scale or
    supply pressure that is off by the same share, as long as no force is measured.
Equation
    pressure *= 1 + gain
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill, chapter
    6.
"""

from pamid.effects.gain_error import GainError
from pamid.model.parameter import Parameter


class PressureSensorGain(GainError, sensor="Pa"):
    parameters = (
        Parameter.share("gain", 0.03, -0.15, 0.15, spread=0.03, tries=(-0.03,)).with_source(
            "estimate: 1-3 % uncalibrated"
        ),
    )
    symptoms = ("constant-error",)
    look_alikes = ("pressure-sensor-offset",)
