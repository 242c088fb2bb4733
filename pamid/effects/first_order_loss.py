"""A loss in proportion to what is stored.

What it is
    Heat that goes to the surroundings, a charge that runs off through a resistance, a laminar leak:
    the rate of loss is proportional to the distance from where it ends (the ambient).
What it looks like
    Left alone, the stored quantity falls exponentially towards the ambient; a constant inflow holds
    it at a level instead of letting it rise.
Looks like it
    A leak through an orifice (falls with the square root, so faster at the end); an overflow (only
    above a level); a gain error of the inflow, if the level hardly varies.
Equation
    value -= rate * (stored - ambient)
References
    Bergman, Lavine, Incropera, DeWitt (2011), Fundamentals of Heat and Mass Transfer, 7th edition,
    Wiley, chapter 5.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

AMBIENT = Parameter("ambient", 0.0, -1.0, 1.0, spread=0.3, size="stored").with_source(
    "estimate: where the loss ends; zero for a level above the outlet or a gauge pressure"
)


class FirstOrderLoss(Effect):
    family = "leak"
    general_kinds = ("rate",)
    signals = ("stored",)
    parameters = (
        Parameter.slope("rate", "stored", 0.1, 0.0, 5.0, spread=0.5).with_source(
            "estimate: 1 / time constant, a tenth of the rate of the store"
        ),
        AMBIENT,
    )
    symptoms = ("level",)
    look_alikes = ("leak", "overflow", "gain-error")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.rate * (at.stored - p.ambient)
