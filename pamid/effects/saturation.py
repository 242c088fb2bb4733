"""A value that cannot go beyond a limit.

What it is
    A drive at its current limit, a valve fully open, a sensor at the end of its range. Beyond the
    limit only a part of the change gets through, usually none; `share` is the part that is lost (1:
    a hard limit).
What it looks like
    Flat tops at the same height on both sides; small signals are untouched, large ones are trimmed,
    and whatever follows is slower than in the model.
Looks like it
    A smaller gain (trims small signals as well); quadratic drag (trims fast motion only); an end
    stop, where the position is limited and not the force.
Equation
    value -= share * (max(value - limit, 0) + min(value + limit, 0))
References
    Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities,
    Wiley; Gelb, Vander Velde (1968), Multiple-Input Describing Functions and Nonlinear System
    Design, McGraw-Hill.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, minimum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter


class Saturation(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter("limit", 0.8, 0.05, 1.5, spread=0.3, size="value", tries=(0.5,)).with_source(
            "estimate: seen only if it lies below the largest value"
        ),
        Parameter.share("share", 1.0, 0.0, 1.0, spread=0.5).with_source("1: a hard limit"),
    )
    symptoms = ("saturates",)
    look_alikes = ("gain-error", "dead-zone", "quadratic-drag", "end-stop")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A limited reading rests at its extremes."""
        ends = {abs(end) for both in hints.extremes for end in both}
        return [{"limit": end, "share": 1.0} for end in sorted(ends)]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        beyond = maximum(value - p.limit, 0.0) + minimum(value + p.limit, 0.0)
        return value - p.share * beyond
