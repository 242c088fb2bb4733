"""A loss that grows faster than what is stored.

What it is
    Natural convection (with the power 1.25 of the difference of temperatures), boiling (3), what a
    hot body radiates (up to 4), evaporation, a seal that opens with the pressure. `loss` is the
    rate at the typical store. A power below 1 is a loss through an orifice.
What it looks like
    The fuller the store, the steeper it falls; near empty it behaves as if nothing were lost. A
    model with a loss in proportion is too high at the top, or too low in between, never right in
    both.
Looks like it
    An overflow, which begins at a level with a kink; a loss in proportion, where the store hardly
    varies; a sensor that saturates softly, which bends the reading, but not what follows it.
Equation
    value -= loss d |d|^(power - 1), d = stored / reference
References
    Incropera, DeWitt, Bergman, Lavine (2007), Fundamentals of Heat and Mass Transfer, Wiley,
    chapters 9, 10 and 12.
"""

from typing import Any

from pamid.effects.orifice_loss import LOSS, REFERENCE
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, exp, log
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

EMPTY = 1e-6  # of the reference: below it nothing is lost


class GrowingLoss(Effect):
    """A loss with a power of the store above 1."""

    family = "leak"
    general_kinds = ("rate",)
    signals = ("stored",)
    parameters = (
        LOSS,
        Parameter.positive("power", 2.0, 1.1, 5.0, factor=1.5, tries=(1.25, 4.0)).with_source(
            "natural convection 1.25, radiation 4, boiling 3"
        ),
        REFERENCE,
    )
    symptoms = ("level",)
    look_alikes = ("overflow", "first-order-loss", "orifice-loss", "saturation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        filled = at.stored / p.reference
        size = absolute(filled) + EMPTY
        return value - p.loss * filled * exp((p.power - 1.0) * log(size))
