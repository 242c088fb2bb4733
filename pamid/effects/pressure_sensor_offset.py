"""The pressure sensors read something at atmospheric pressure.

What it is
    A zero error of the pressure sensors: the same number of kilopascals at every pressure.
What it looks like
    The readings at rest, vented, are not zero; angle and forces do not see it.
Looks like it
    A gain error of the sensors (grows with pressure: without a wide range of pressures the two are
    the same); a wrong supply or initial pressure. Five seconds of vented muscles at the start
    settle it.
Equation
    pressure += offset
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill, chapter
    6.
"""

from pamid.effects.offset import Offset
from pamid.model.parameter import Parameter


class PressureSensorOffset(Offset, sensor="Pa"):
    parameters = (
        Parameter(
            "level", 5.0, -40.0, 40.0, "kPa", spread=8.0, null=0.0, label="offset", tries=(-5.0,)
        ).with_source("estimate: 2-10 kPa for 10 bar sensors"),
    )
    symptoms = ("constant-error",)
    look_alikes = ("pressure-sensor-gain",)
