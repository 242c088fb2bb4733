"""A valve that does not open at small commands.

What it is
    Overlapping spools and stiction keep a proportional valve shut until the command exceeds a
    threshold; the rest of the range is stretched so that full command still opens it fully.
What it looks like
    The pressure stays flat for small commands of either sign; the loop stops short of its target by
    up to dead band / gain, or hunts across it.
Looks like it
    Switching delays of an on-off valve (the same family: there the flow jumps in at the threshold);
    dry friction, in which the pressure moves while the arm sticks.
Equation
    value = sign(value) max(0, |value| - dead_band) / (1 - dead_band)
References
    Richer, Hurmuzlu (2000), J. Dyn. Syst. Meas. Control 122(3), 416-425; Beater (2007), Pneumatic
    Drives, Springer.
"""

from typing import Any

from pamid.effects.dead_zone import DeadZone
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, maximum, sign
from pamid.model.parameter import Parameter


class ValveDeadBand(DeadZone):
    """Dead band of a valve whose full command, 1, stays full; elsewhere it is a dead zone."""

    family = "valve-dead-band"
    kinds = ("command",)
    general_kinds = ()  # type: ignore[assignment]
    parameters = (
        Parameter.share("dead_band", 0.05, 0.0, 0.3, spread=0.05).with_source(
            "estimate: 2-10 % of full command, up to 30 % for coarse spools"
        ),
    )
    symptoms = ("stops-short", "reversals")
    look_alikes = ("valve-switching", "pwm-quantisation", "coulomb-friction")  # type: ignore[assignment]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return sign(value) * maximum(0.0, absolute(value) - p.dead_band) / (1.0 - p.dead_band)
