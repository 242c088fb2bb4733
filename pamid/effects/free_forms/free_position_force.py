"""A force that depends on the position by no known law.

What it is
    A spring without a formula, a cam, a magnet that pulls towards a place, a weight
    on a lever, a cable that drags along: a fixed force at each place, whatever went before.
What it looks like
    What is missing, seen over the position, falls onto a line, the same up and down.
Looks like it
    Friction or hysteresis, whose lines up and down part; a sensor that is not straight, which other
    sensors do not follow.
Equation
    value -= offset + sum_k c_k ramp_k(position), between quarters of the range on both sides of its
    middle
References
    Eilers, Marx (1996), Statistical Science 11(2), 89-121; Kovacic, Brennan (2011), The Duffing
    Equation: Nonlinear Oscillators and their Behaviour, Wiley.
"""

from typing import ClassVar

from pamid.model.free_form import QUARTERS, FreeCurve, coefficient, places, rises


class FreePositionForce(FreeCurve):
    """A function of the position, or of the stretch of what transmits."""

    family = "stiffness"
    families: ClassVar[dict[str, str]] = {"transmission": "flexible-transmission"}
    kinds = ("motion", "actuator-force", "transmission")
    signals = ("position",)
    stand_ins: ClassVar[dict[str, tuple[str, ...]]] = {"position": ("stretch",)}
    parameters = (coefficient("offset", 0.3, 0.5), *rises(QUARTERS, 0.5, 0.5), *places("position"))
    look_alikes = ("linear-stiffness", "cubic-stiffness", "gravity", "end-stop", "cogging")
    along = "position"
    shown = "force beyond that of the rig"
    known_by = "a function of the position"
