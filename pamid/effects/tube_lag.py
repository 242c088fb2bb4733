"""A tube between valve and actuator.

What it is
    Tube and fittings store and throttle air, so the flow into the muscle follows the flow through
    the valve with a lag: 3 ms per metre of sound travel and 5-30 ms of filling for a metre of 4 mm
    tube.
What it looks like
    Corners of the pressure are rounded after every opening and closing; a gauge at the valve shows
    the step before the muscle does.
Looks like it
    Dead time, which shifts without rounding; a lag of the pressure gauge, which leaves the angle on
    time; a smaller conductance, which slows the whole rise and not only its beginning.
Equation
    flow = lag(flow, time_constant)
References
    Richer, Hurmuzlu (2000), J. Dyn. Syst. Meas. Control 122(3), 416-425; Beater (2007), Pneumatic
    Drives, Springer.
"""

from typing import Any

from pamid.effects.first_order_lag import FirstOrderLag
from pamid.engine.symbolic.vocabulary import Expr, Number, lag
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class TubeLag(Effect):
    family = "tube-lag"
    kinds = ("flow",)
    home_signals = ("supply",)
    parameters = (
        Parameter.time(0.015, 0.0, 0.06, spread=0.015, tries=(0.005, 0.035)).with_source(
            "estimate: two volumes and a resistance, 5-30 ms"
        ),
    )
    # a pipe between stores of another kind is as slow as these let it be seen
    general_parameters = FirstOrderLag.parameters
    symptoms = ("lags",)
    look_alikes = ("dead-time", "pressure-sensor-lag")
    absorbed_by = ("conductance_in", "conductance_out")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return lag(value, p.time_constant)
