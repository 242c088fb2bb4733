"""Pressure spent on the membrane before the muscle pulls.

What it is
    The membrane must be pressed against the braid first: up to a threshold the pressure does no
    work. The chart of the maker contains an average threshold; this is the difference of the
    specimen.
What it looks like
    No change of force at low pressure, then the usual slope; the emptier muscle goes slack early.
Looks like it
    A pressure gauge with an offset (it shows at atmosphere too); a force scale (it has no dead
    region); a dead-band of the valve, where the pressure itself stays.
Equation
    force += law(contraction, p - clip(p, 0, threshold)) - law(contraction, p)
References
    Davis, Tsagarakis, Canderle, Caldwell (2003), Int. J. Robotics Research 22(3-4), 213-227;
    Martens, Boblan (2017), Actuators 6(4), 33.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, clip
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ThresholdPressure(Effect):
    """The first part of the pressure is lost."""

    family = "threshold-pressure"
    kinds = ("actuator-force",)
    signals = ("position", "pressure", "law")
    parameters = (
        Parameter("threshold", 20.0, 0.0, 100.0, "kPa", spread=20.0, null=0.0).with_source(
            "0.2-0.6 bar without load; specimens differ by 0.1-0.3 bar from the chart"
        ),
    )
    symptoms = ("stops-short", "load")
    look_alikes = ("pressure-sensor-offset", "force-asymmetry")
    absorbed_by = ("scale", "contraction_0")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        left = at.pressure - clip(at.pressure, 0.0, p.threshold)
        return value + at.law(at.position, left) - at.law(at.position, at.pressure)
