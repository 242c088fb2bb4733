"""The angle is read late: a lag in the encoder's electronics or filter.

What it is
    A low-pass filter between the encoder and the recorded angle, or an angle computed as a moving
    average.
What it looks like
    The angle comes late against pressures and forces, by the same time at every slow frequency;
    peaks of fast swings are trimmed, holds are untouched.
Looks like it
    Dead time of the valves (pressures come late as well); tube lag; clock skew (all readings late
    together). A quick release with the valves shut sees the sensor's lag only.
Equation
    time_constant * d(out)/dt = angle - out,   angle := out
References
    Doebelin (2004), Measurement Systems: Application and Design, 5th edition, McGraw-Hill, chapter
    3.
"""

from pamid.effects.first_order_lag import FirstOrderLag
from pamid.model.parameter import Parameter


class AngleSensorLag(FirstOrderLag, sensor="rad"):
    parameters = (
        Parameter.time(0.005, 0.0, 0.06, spread=0.01, tries=(0.02,)).with_source(
            "estimate: 1-20 ms"
        ),
    )
    symptoms = ("lags",)
    look_alikes = ("dead-time", "tube-lag", "clock-skew")
