"""The readings carry the time of another clock.

What it is
    Commands and readings were stamped by two clocks: the second started later (`start`), or runs
    faster (`skew_ppm`, parts per million). All readings are then late, or early, by start + skew *
    time.
What it looks like
    Every channel, slow or fast, is shifted by the same time; the residual resembles the derivative
    of the signal. With a skew the shift grows along the recording, so that its end fits worse than
    its start.
Looks like it
    Dead time of the actuator, which readings late by a constant equal exactly: that part is left to
    it, and only a shift that grows, or readings that come early, are put down to a clock; a lag of
    a single sensor, which spares the rest.
Equation
    reading(t) := reading(t - late),   late = start + skew * t
    early readings: reading - late * rate, the rate from sample to sample where the rig offers none
References
    IEEE 1588-2019, Precision Clock Synchronization Protocol; Mills (1991), Internet time
    synchronization: the network time protocol, IEEE Transactions on Communications 39(10).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, delay, maximum, rate_of, where
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

LONGEST_LATE = 80.0  # sampling periods


class ClockSkew(Effect):
    """All readings late by a start and a drift."""

    family = "sensor-timing"
    kinds = ("reading",)
    everywhere = True
    parameters = (
        # only early readings: all readings late by a constant are a dead time, to the last digit
        # hard: what comes earlier by more than that is no matter of stamps: a reading that is led
        # by its slope over longer is that of a machine which answers faster than its model
        Parameter(
            "start", -2.0, -10.0, 0.0, spread=3.3, size="period", null=0.0, hard=True, tries=(0.0,)
        ).with_source("estimate: logs aligned by hand are off by 1-10 samples"),
        Parameter.share("skew_ppm", 50.0, -500.0, 500.0, spread=100.0).with_source(
            "estimate: quartz clocks differ by 10-200 parts per million"
        ),
    )
    symptoms = ("lags", "drifts")
    look_alikes = ("dead-time", "angle-sensor-lag", "first-order-lag")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        late = p.start + p.skew_ppm * 1e-6 * at.time
        after = delay(value, maximum(late, 0.0), LONGEST_LATE * at.rig_period_s)
        # the past is remembered, the future is not: a reading that is early is led by its
        # slope, that of the rig or that from the sample before
        slope = at.rate if at.offers("rate") else rate_of(value)
        early = value - slope * late
        return where(late >= 0.0, after, early)
