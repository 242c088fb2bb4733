"""Air that heats and cools.

What it is
    Fast filling compresses the air faster than it can give off heat: the pressure first overshoots
    its isothermal value (up to 1.4 times the rate), then creeps back as the wall takes the heat,
    within 0.3-2 s. Venting mirrors it.
What it looks like
    After a valve shuts, the pressure goes back by 2-10 % of the preceding change, opposite to its
    sign, and stays.
Looks like it
    A polytropic exponent above 1 (the fast half of the same thing, without the way back); a leak,
    which always falls; creep of the muscle, in which the angle moves and the pressure hardly.
Equation
    rate += de/dt, de/dt = gain * rate - e / time_constant; e the excess pressure
References
    Carneiro, Gomes de Almeida (2006), Proc. IMechE Part I 220, 301-314.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter


class HeatTransfer(Effect):
    """Excess pressure from heating, lost to the wall."""

    family = "heat-transfer"
    kinds = ("rate",)
    signals = ("stored",)
    unit = "Pa/s"
    states = (State("excess", "Pa"),)
    parameters = (
        Parameter.share("gain", 0.2, 0.0, 0.4, spread=0.15).with_source(
            "0: isothermal, 0.4: adiabatic at first"
        ),
        Parameter.time(0.6, 0.1, 3.0, factor=2.5, tries=(0.2, 1.5)).with_source(
            "derived: 30-100 W/(m2 K) on a 20 mm muscle give 0.35-1.2 s"
        ),
    )
    symptoms = ("level", "drifts")
    look_alikes = ("leak", "muscle-creep")
    absorbed_by = ("polytropic",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        change = p.gain * value - z.excess / p.time_constant
        return value + change, {"excess": change}
