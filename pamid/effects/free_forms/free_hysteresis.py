"""Hysteresis of no known law, of a force.

What it is
    A force that depends on where the motion has turned and not on how fast it is: a bank of
    elasto-slip elements that slip after an eightieth of the range up to after four fifths of it,
    each twice as late as the element before, with a separate force.
What it looks like
    Loops of what is missing over the position, the same slow and fast, that differ with the length
    of the way.
Looks like it
    Dry friction, whose loops are rectangles; a spring, which is an element that never slips;
    damping, whose loops grow with the speed.
Equation
    value -= sum_j c_j stop(position, r_j) / r_j, r = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6) half
    the range
References
    Kuhnen (2003), European J. Control 9(4), 407-418; Iwan (1966), A distributed-element model for
    hysteresis, J. Appl. Mech. 33(4), 893-900.
"""

from typing import ClassVar

from pamid.model.free_form import FreeLoop, elements, half_width


class FreeHysteresis(FreeLoop):
    """A bank of elasto-slip elements on the position."""

    family = "hysteresis"
    families: ClassVar[dict[str, str]] = {"actuator-force": "muscle-hysteresis"}
    kinds = ("motion", "actuator-force")
    signals = ("position",)
    parameters = (*elements(0.3, 0.5), half_width("position"))
    look_alikes = ("maxwell-slip-hysteresis", "bouc-wen-hysteresis", "coulomb-friction")
    along = "position"
    shown = "force beyond that of the rig"
    known_by = "a force that remembers where the motion turned"
