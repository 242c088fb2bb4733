"""A dead band that is wider on one side of zero than on the other.

What it is
    A spool ground off its middle, a bridge whose two halves switch at different thresholds, a valve
    that needs more to open than to close: on either side of zero the value has to pass a different
    width before anything gets through.
What it looks like
    Small values do nothing, to different amounts up and down; a symmetric drive leads to a mean
    that is not zero.
Looks like it
    A dead zone (equal sides); a dead zone with an offset; dry friction that differs between the
    directions, in which the force still moves.
Equation
    value -= min(max(value, -below), above)
References
    Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities,
    Wiley.
"""

from dataclasses import replace
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, clip
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

ABOVE = Parameter(
    "above", 0.05, 0.0, 0.9, spread=0.15, size="value", null=0.0, tries=(0.2,)
).with_source("estimate: overlapped spools 2-10 % of the command, single-acting valves 30 %")


class AsymmetricDeadZone(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        ABOVE,
        # unequal to begin with: of equal widths it is a dead zone
        replace(ABOVE, name="below", value=0.12),
    )
    symptoms = ("stops-short", "direction")
    look_alikes = ("dead-zone", "offset", "asymmetric-saturation", "quantisation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - clip(value, -p.below, p.above)
