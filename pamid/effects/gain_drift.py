"""A gain that drifts with time, or warms up.

What it is
    An amplifier, a motor's magnets, a pump's oil, a strain gauge: from the beginning of a recording
    the gain moves towards another value, fast at first, with a single time constant. Where that is
    long against the recording, the gain drifts in a straight line.
What it looks like
    The same motion is repeated with another amplitude later on; a fit to the first minutes is off
    in the last; the error follows the value, with a factor that changes slowly.
Looks like it
    A gain error (constant: compare the beginning with the end); an offset that drifts; friction
    that falls as the grease warms, which shows at reversals.
Equation
    value *= 1 + change (1 - exp(-time/time_constant))
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill; Ljung,
    Gunnarsson (1990), Adaptation and tracking in system identification: a survey, Automatica 26(1),
    7-21.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, exp, expression
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class GainDrift(Effect):
    """A gain that moves to 1 + `change`; the time counts from the start of each recording."""

    family = "gain-drift"
    general_kinds = ("command", "actuator-force", "reading")
    parameters = (
        Parameter.share("change", 0.1, -0.9, 3.0, spread=0.2).with_source(
            "estimate: magnets and windings 5-30 %, amplifiers and bridges below 1 %"
        ),
        Parameter.time(0.3, 0.01, 3.0, factor=3.0, size="time", tries=(0.05,)).with_source(
            "estimate, in durations of the longest recording: what is faster is dynamics, what is "
            "slower a straight line"
        ),
    )
    symptoms = ("drifts",)
    look_alikes = ("gain-error", "offset")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        passed = expression(at.time) / p.time_constant
        return value * (1.0 + p.change * (1.0 - exp(-passed)))
