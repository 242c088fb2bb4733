"""A first-order lag of a filter, an amplifier or a sensor.

What it is
    The value follows its input with a time constant: an electronic low-pass filter, a heater or
    coil that takes time, a sensor with inertia. On a command it belongs to the actuator, on a
    reading to the sensor.
What it looks like
    Fast motion comes late and smaller, slow motion is untouched; steps arrive as exponentials. As a
    residual it resembles the derivative of the signal.
Looks like it
    Dead time (late, but not smaller; the two part above 1/(2 pi time constant)); clock skew; more
    damping in the mechanism, which other sensors see as well.
Equation
    time_constant * d(out)/dt = value - out,   value := out
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill, chapter
    3.
"""

from typing import Any, ClassVar

from pamid.engine.symbolic.vocabulary import Expr, Number, lag
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class FirstOrderLag(Effect):
    family = "sensor-dynamics"
    families: ClassVar[dict[str, str]] = {"command": "command-timing"}
    general_kinds = ("command", "reading")
    parameters = (
        Parameter.time(0.0167, 0.0, 0.5, spread=0.05, size="timescale", tries=(0.083,)).with_source(
            "estimate: filters, amplifiers and thermal sensors, 2 % of what they follow"
        ),
    )
    symptoms: ClassVar[tuple[str, ...]] = ("lags", "speed")
    look_alikes: ClassVar[tuple[str, ...]] = ("dead-time", "clock-skew")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return lag(value, p.time_constant)
