"""The zero of the angle sensor is not where both muscles are equally long.

What it is
    The encoder was zeroed with the arm a little askew: every angle is read too large or too small
    by the same amount.
What it looks like
    The joint rests off zero at equal pressures, and the two directions need different pressures, by
    the same angle at every pressure.
Looks like it
    A difference in length of the two muscles: with the angle as the only mechanical reference the
    two are exactly the same thing, up to the contraction at zero. A difference in force scale moves
    with the co-contraction pressure.
Equation
    angle += offset
References
    Hosovsky, Pitel, Zidek (2015), Enhanced dynamic model of pneumatic muscle actuator with Elman
    neural network, Abstract and Applied Analysis, 906126 (the rig); Doebelin (2004), Measurement
    Systems, 5th edition, McGraw-Hill.
"""

from pamid.effects.offset import Offset
from pamid.model.parameter import Parameter


class AngleSensorOffset(Offset, sensor="rad"):
    family = "asymmetry"
    parameters = (
        Parameter(
            "level", 1.0, -6.0, 6.0, "deg", spread=1.0, null=0.0, label="offset", tries=(-1.0,)
        ).with_source("estimate: an arm squared by eye, 0.1-2 deg"),
    )
    symptoms = ("constant-error",)
    look_alikes = ("length-asymmetry", "force-asymmetry", "gravity")
