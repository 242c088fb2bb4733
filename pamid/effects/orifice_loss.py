"""A loss through an orifice: with the square root of what is stored.

What it is
    A hole, a cracked fitting, an open outlet: turbulent flow, in proportion to the square root of
    the pressure or level across it. Near the end, below a hundredth of the typical store, it turns
    laminar. `loss` is the rate at the typical store.
What it looks like
    Left alone, the store empties along a parabola and in finite time; the loss at half full is
    still 70 % of that at full.
Looks like it
    A first-order loss (an exponential, which slows down in proportion: apart where the store falls
    far); a leak given as a share of another outflow; an overflow, which stops at a level; a gain
    error of the inflow, if the store hardly varies.
Equation
    value -= loss d / sqrt(|d| + 0.01), d = (stored - ambient) / reference
References
    ISO 5167-1:2022; Torricelli (1644), De motu gravium naturaliter descendentium; Beater (2007),
    Pneumatic Drives, Springer.
"""

from typing import Any

from pamid.effects.first_order_loss import AMBIENT
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, sqrt
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

LOSS = Parameter("loss", 0.1, 0.0, 5.0, spread=0.5, size="value", null=0.0).with_source(
    "estimate: a tenth of the rate of the store"
)
REFERENCE = Parameter.held("reference", 1.0, 0.1, 10.0, size="stored").with_source(
    "typical stored quantity; only sets the scale of the orifice law"
)


class OrificeLoss(Effect):
    """A turbulent loss to where nothing is stored, or to an ambient."""

    family = "leak"
    general_kinds = ("rate",)
    signals = ("stored",)
    parameters = (LOSS, AMBIENT, REFERENCE)
    symptoms = ("level",)
    look_alikes = ("first-order-loss", "leak", "overflow", "gain-error")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        filled = (at.stored - p.ambient) / p.reference
        return value - p.loss * filled / sqrt(absolute(filled) + 0.01)
