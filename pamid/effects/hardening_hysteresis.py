"""Hysteresis that stiffens the further it is loaded.

What it is
    A wire rope, a stack of leaves or a rubber mount whose parts lock while they are loaded further
    and let go where the motion turns: the Bouc-Wen equation on that side of its parameters on which
    the loop does not saturate (gamma + delta < 0, gamma - delta >= 0).
What it looks like
    Loops of force over position that open towards their ends, stiffest just behind a reversal; on
    the way out the force grows more than in proportion.
Looks like it
    A cubic spring, which stiffens alike and loses nothing; hysteresis that saturates, next to a
    spring that stiffens.
Equation
    value -= level z; dz/dt = (v - |v| z + v |z|) / reach + v |z| / stiffens_over
References
    Wen (1976), J. Eng. Mech. Div. ASCE 102(2), 249-263; Ikhouane, Rodellar (2007), Systems with
    Hysteresis, Wiley, section 2.3 (which signs of gamma and delta leave it bounded); Noel,
    Schoukens (2016), Hysteretic benchmark with a dynamic nonlinearity (gamma + delta < 0).
"""

from typing import Any, ClassVar

from pamid.effects.maxwell_slip_hysteresis import MaxwellSlipHysteresis
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter


class HardeningHysteresis(Effect):
    """Bouc-Wen element that does not saturate: of stiffness `level / reach` at rest, e times as
    stiff once it was loaded over `stiffens_over`."""

    family = "hysteresis"
    general_kinds = ("motion",)
    signals = ("velocity",)
    states = (State("z"),)
    parameters = (
        MaxwellSlipHysteresis.general_parameters[0],
        Parameter.width(
            "reach", 1.0, 0.05, 5.0, factor=2.5, size="travel", tries=(0.25,)
        ).with_source("estimate: about the stroke, since it does not bend over on the way"),
        Parameter.width("stiffens_over", 1.0, 0.3, 10.0, factor=2.0, size="travel").with_source(
            "estimate: e times as stiff at the end of the stroke; longer: a straight line"
        ),
    )
    limits: ClassVar[dict[str, str]] = {"reach": "friction"}  # slips at once
    symptoms = ("history",)
    look_alikes = ("bouc-wen-hysteresis", "maxwell-slip-hysteresis", "cubic-stiffness")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        v = at.velocity
        onward = v * absolute(z.z)
        turning = (v - absolute(v) * z.z + onward) / p.reach
        return value - p.level * z.z, {"z": turning + onward / p.stiffens_over}
