"""A value that comes out other than it goes in, by no known law.

What it is
    An amplifier, a valve, a sensor whose characteristic is a curve: what comes out depends on what
    goes in at the same instant, and on nothing else.
What it looks like
    The same value in, the same value out, fast and slow, up and down, but not in proportion.
Looks like it
    Hysteresis, whose lines up and down part; a gain or an offset alone, which the parameters of
    most rigs take up; a force over the position, which other sensors feel, too.
Equation
    value += offset + sum_k c_k ramp_k(value), between quarters of the range on both sides of its
    middle
References
    Eilers, Marx (1996), Statistical Science 11(2), 89-121; Tao, Kokotovic (1996), Adaptive Control
    of Systems with Actuator and Sensor Nonlinearities, Wiley.
"""

from pamid.model.free_form import QUARTERS, FreeCurve, coefficient, places, rises


class FreeMap(FreeCurve):
    """A characteristic that is a curve."""

    family = "static-map"
    kinds = ("command", "reading", "flow")
    parameters = (coefficient("offset", 0.1, 0.3), *rises(QUARTERS, 0.3, 0.5), *places("value"))
    look_alikes = ("saturation", "dead-zone", "asymmetric-saturation", "gain-error")
    along = "value"
    shown = "change of the value"
    known_by = "a characteristic that is a curve"
    subtracted = False
