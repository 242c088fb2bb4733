"""A value with limits that differ between its two sides.

What it is
    A pump that works one way, a single-acting valve, an amplifier on a single supply, a sensor
    mounted near an end of its range: an upper and a lower limit, each where it is. `share` is the
    part of what lies beyond that is lost (1: hard limits).
What it looks like
    Flat tops and flat bottoms at different heights, or on one side only; inside nothing is
    changed.
Looks like it
    Saturation (the same limit on both sides); rectification (a lower limit at 0); an overflow,
    which limits what is stored and not what is shown.
Equation
    value -= share (max(value - upper, 0) + min(value - lower, 0))
References
    Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities,
    Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, minimum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter


class AsymmetricSaturation(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter("upper", 0.8, -1.5, 1.5, spread=0.5, size="value", tries=(0.4,)).with_source(
            "estimate: seen only if it lies below the largest value"
        ),
        Parameter(
            "lower", -0.6, -1.5, 1.5, spread=0.5, size="value", tries=(-0.4, 0.2)
        ).with_source("estimate: seen only if it lies above the smallest value"),
        Parameter.share("share", 1.0, 0.0, 1.0, spread=0.1).with_source("1: hard limits"),
    )
    symptoms = ("saturates", "direction")
    look_alikes = ("saturation", "rectification", "gain-error", "asymmetric-dead-zone")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A limited reading rests at its extremes."""
        return [{"upper": high, "lower": low, "share": 1.0} for low, high in hints.extremes]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        beyond = maximum(value - p.upper, 0.0) + minimum(value - p.lower, 0.0)
        return value - p.share * beyond
