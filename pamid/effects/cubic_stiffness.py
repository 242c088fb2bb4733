"""A spring that hardens or softens with the stroke.

What it is
    The part of a spring that grows with the cube of the distance from rest: membranes, clamped
    plates, rubber, a spring run near its block length. Positive hardens, negative softens.
What it looks like
    The frequency of free swings rises (or falls) with their amplitude; a sine drive shows its third
    harmonic; the resonance peak leans over, and jumps.
Looks like it
    A linear spring (frequency does not depend on amplitude); backlash, whose frequency rises with
    amplitude as well, most of all at small ones; an end stop, which acts only beyond a place.
Equation
    value -= hardening * (position - rest) * min((position - rest)**2, reach**2)
References
    Kovacic, Brennan (2011), The Duffing Equation: Nonlinear Oscillators and their Behaviour, Wiley.
"""

from typing import Any

from pamid.effects.linear_stiffness import REST
from pamid.engine.symbolic.vocabulary import Expr, Number, minimum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class CubicStiffness(Effect):
    family = "stiffness"
    general_kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.slope(
            "hardening", "position/position/position", 0.1, -0.25, 5.0, spread=0.5, tries=(-0.1,)
        ).with_source("estimate: 1-50 % of the force at full stroke"),
        REST,
        Parameter.held("reach", 2.0, 1.0, 2.0, size="position").with_source(
            "twice the stroke: farther out the spring goes on as a straight line, so that a spring "
            "that softens does not run away faster than exponentially"
        ),
    )
    symptoms = ("position",)
    look_alikes = ("linear-stiffness", "end-stop", "backlash")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        bent = at.position - p.rest
        return value - p.hardening * bent * minimum(bent * bent, p.reach * p.reach)
