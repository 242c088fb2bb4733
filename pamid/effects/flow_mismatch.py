"""Valves of the two muscles that do not flow alike.

What it is
    Nominally equal valves differ in conductance; fittings and silencers add to it. Half of the
    mismatch is given to the first muscle and taken from the second.
What it looks like
    The joint turns faster one way than the other at equal commands; fill and vent times of the two
    muscles differ by the same factor.
Looks like it
    Unequal muscles (asymmetry of force or length), which show at rest too; a fill and a vent
    conductance that differ, which is the same in both muscles.
Equation
    flow *= 1 + mismatch * side / 2, side = +1 for the first muscle, -1 for the second
References
    ISO 6358-1:2013; Beater (2007), Pneumatic Drives, Springer.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class FlowMismatch(Effect):
    family = "flow-mismatch"
    kinds = ("flow",)
    signals = ("side",)
    parameters = (
        Parameter.share("mismatch", 0.12, -0.6, 0.6, spread=0.15).with_source(
            "estimate: conductances of like valves within +-20 %"
        ),
    )
    symptoms = ("direction",)
    look_alikes = ("force-asymmetry", "length-asymmetry")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + 0.5 * p.mismatch * at.side)
