"""Dead time: what is sent arrives later, unchanged.

What it is
    Computing, bus and driver take a fixed time before the actuator sees the command (or the logger
    the reading). A sample is the least a sampled loop can have; slow buses and valve drivers add
    tens of milliseconds. In a pipe, a belt or a heated block the way to the sensor takes seconds to
    minutes: up to a tenth of the longest recording is tried.
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

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, delay
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

# sampling periods: computing and buses keep pace with the log
LONGEST_BUS_DELAY = 20.0
# of the longest recording: transport takes as long, however fast the log is sampled. A longer
# delay leaves too little of the recording that has been through it
LONGEST_DELAY_SHARE = 0.1
# the squares of evenly spaced numbers: the misfit is narrow where a delay is short against the
# motion, and a long delay is still met to within a fiftieth
SCANNED_DELAYS = (-0.01, 100, 2.0)


class DeadTime(Effect):
    family = "command-timing"
    families = {"reading": "sensor-dynamics"}
    kinds = ("command",)
    general_kinds = ("reading",)
    parameters = (
        Parameter.time(
            4.0,
            0.0,
            LONGEST_BUS_DELAY,
            name="delay",
            spread=6.7,
            size="period",
            at_least=("time", LONGEST_DELAY_SHARE),
            tries=(1.0, 7.3, 11.7),
            scan=SCANNED_DELAYS,
        ).with_source(
            "estimate: from a sample to the 15 of slow buses and drivers; transport through pipes "
            "and blocks up to a tenth of a recording"
        ),
    )
    symptoms = ("lags", "rings")
    look_alikes = ("tube-lag", "angle-sensor-lag")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        # the range ends at 0 where the opposite sign is tried
        return delay(value, p.delay, max(at.upper_bounds["delay"], at.rig_period_s))
