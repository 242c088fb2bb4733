"""A sensor that is blind to the sign.

What it is
    A pulse counter without a direction, a single-phase tachometer behind a bridge, a flow meter or
    an ammeter that shows amounts: the negative side is folded up. `fold` is how much of it (1: all,
    0.5: the negative side is missing, -1: everything is shown negative).
What it looks like
    The reading bounces off zero whenever the true value passes through it; twice the frequency of a
    symmetric drive, and a mean that grows with the amplitude.
Looks like it
    Rectification of one side (fold 0.5); a gain error on a signal of constant sign, where nothing
    is to be seen; a wrong sign of the column, which shows no bounce.
Equation
    value = (1 - |fold|) value + fold |value|
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill; Wigren,
    Schoukens (2017), Coupled electric drives data set and reference models, Uppsala University
    technical report 2017-024.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class FullWaveRectification(Effect):
    """The negative side is folded onto the positive side."""

    family = "saturation"
    general_kinds = ("reading",)
    parameters = (
        Parameter.share("fold", 1.0, -1.0, 1.0, spread=0.5, tries=(-1.0,)).with_source(
            "1: an ideal full-wave rectifier"
        ),
    )
    symptoms = ("direction",)
    look_alikes = ("rectification", "asymmetric-saturation", "saturation", "offset", "gain-error")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - absolute(p.fold) * value + p.fold * absolute(value)
