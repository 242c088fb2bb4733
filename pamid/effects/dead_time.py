"""Dead time: what is sent arrives later, unchanged.

What it is
    Computing, bus and driver take a fixed time before the actuator sees the command (or the logger
    the reading). One sample is the least a sampled loop can have; slow buses and valve drivers add
    tens of milliseconds.
What it looks like
    Pressure and angle both come late by the same time at every frequency: pure phase, no loss of
    amplitude. The residual is proportional to the rate of the signal. A loop with little damping
    starts to ring.
Looks like it
    A tube lag, which also rounds the corners; a lag of the angle sensor, which leaves the pressures
    on time; muscle damping taken too high. A step of the command with pressures logged at 1 kHz
    separates them.
Equation
    value = delay(value, delay_s)
References
    Normey-Rico, Camacho (2007), Control of Dead-time Processes, Springer.
"""

from __future__ import annotations

from typing import Any

from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.symbolic.vocabulary import Expr, Number, delay

# sampling periods: of computing and buses, which keep pace with the log; a fit that ends there is
# widened, so that how fast a log is sampled does not decide how long a delay may be
LONGEST_DELAY = 20.0
WIDENED = 16.0  # times that: the past is kept as far as a fit that ends there may widen its range


class DeadTime(Effect):
    """A transport delay."""

    family = "command-timing"
    families = {"reading": "sensor-dynamics"}
    kinds = ("command",)
    general_kinds = ("reading",)
    parameters = (
        Parameter(
            "delay",
            4.0,
            low=0.0,
            high=LONGEST_DELAY,
            spread=6.7,
            size="period",
            null=0.0,
            tries=(1.0, 7.3, 11.7),
            source="estimate: one sample to the 15 of slow buses and drivers",
        ),
    )
    look_alikes = ("tube-lag", "angle-sensor-lag")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return delay(value, p.delay, WIDENED * LONGEST_DELAY * at.rig_period_s)
