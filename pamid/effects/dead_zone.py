"""A value that has no effect until it leaves a band about zero.

What it is
    A spool valve whose lands overlap, an amplifier that does not react to small commands, a loose
    coupling ahead of a sensor. Inside the band nothing gets through, outside it the rest.
What it looks like
    Small commands do nothing; every reversal is followed by a pause; a controller settles with an
    error or hunts slowly about the target.
Looks like it
    Dry friction (there the actuator's force still moves while the mechanism sticks); backlash,
    which depends on where the motion came from; quantisation, which repeats the flat at every
    level; a valve that switches late, whose gap lies about zero, too.
Equation
    value -= min(max(value, -half_width), half_width)
References
    Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities,
    Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, clip
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class DeadZone(Effect):
    family = "saturation"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter("half_width", 0.05, 0.0, 0.5, spread=0.15, size="value", null=0.0).with_source(
            "estimate: overlapped spools 2-10 % of the command"
        ),
    )
    symptoms = ("stops-short", "reversals")
    look_alikes = (
        "coulomb-friction",
        "backlash",
        "valve-dead-band",
        "valve-switching",
        "quantisation",
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - clip(value, -p.half_width, p.half_width)
