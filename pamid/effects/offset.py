"""A zero that is off.

What it is
    A sensor that reads something at nothing, an amplifier that drives a little at command zero.
What it looks like
    The same error at every value and every speed. On a reading the model fits after a shift of the
    axis; on a command the mechanism moves at command zero.
Looks like it
    A gain error, if the recording covers one side of zero only; a constant force on the mechanism;
    an initial state that was not at rest.
Equation
    value += level
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill; JCGM
    200:2012, International Vocabulary of Metrology.
"""

from typing import Any, ClassVar

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Offset(Effect):
    family = "sensor-offset"
    families: ClassVar[dict[str, str]] = {"command": "offset"}
    general_kinds = ("command", "reading")
    parameters = (
        Parameter(
            "level", 0.02, -0.5, 0.5, spread=0.1, size="value", null=0.0, tries=(-0.02,)
        ).with_source("estimate: zero errors of 0.5-5 % of the range"),
    )
    symptoms: ClassVar[tuple[str, ...]] = ("constant-error",)
    look_alikes: ClassVar[tuple[str, ...]] = ("gain-error", "constant-offset")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value + p.level
