"""A loss from a store by no known law.

What it is
    What drains, leaks or cools away, or comes in, in dependence on how full the store is: any curve
    over the level, the pressure or the temperature.
What it looks like
    With nothing going in, the store empties along a curve that is neither an exponential nor that
    of an orifice.
Looks like it
    An inflow that is not in proportion to its command; a gauge that is not straight.
Equation
    value -= offset + sum_k c_k ramp_k(stored), between quarters of the range on both sides of its
    middle
References
    Eilers, Marx (1996), Statistical Science 11(2), 89-121; Doebelin (1998), System Dynamics:
    Modeling, Analysis, Simulation, Design, Marcel Dekker.
"""

from pamid.model.free_form import QUARTERS, FreeCurve, coefficient, places, rises


class FreeLoss(FreeCurve):
    """A function of what is stored."""

    family = "leak"
    kinds = ("rate",)
    signals = ("stored",)
    parameters = (coefficient("offset", 0.3, 0.5), *rises(QUARTERS, 0.5, 0.5), *places("stored"))
    look_alikes = ("leak", "first-order-loss", "orifice-loss", "heat-transfer", "overflow")
    along = "stored"
    shown = "loss beyond that of the rig"
    known_by = "a function of what is stored"
