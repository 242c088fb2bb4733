"""The pressures are read late: a lag in the sensor, its tube or its filter.

What it is
    A pressure sensor behind a thin tube or a low-pass filter: the reading follows the pressure in
    the muscle with a time constant.
What it looks like
    Pressures rise and fall more gently than filling and venting allow, while angle and forces are
    where they should be.
Looks like it
    Tube lag (there the muscle itself fills late, so angle and force are late too); dead time
    (shifted, not rounded); a larger dead volume, which slows the pressure at its true place.
Equation
    time_constant * d(out)/dt = pressure - out,   pressure := out
References
    Beater (2007), Pneumatic Drives: System Design, Modelling and Control, Springer; Doebelin
    (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill, chapter 6.
"""

from pamid.effects.first_order_lag import FirstOrderLag
from pamid.model.parameter import Parameter


class PressureSensorLag(FirstOrderLag, sensor="Pa"):
    parameters = (
        Parameter.time(0.008, 0.0, 0.08, spread=0.015, tries=(0.03,)).with_source(
            "estimate: 2-20 ms with a short sensing tube"
        ),
    )
    symptoms = ("lags",)
    look_alikes = ("tube-lag", "dead-time", "clock-skew")
