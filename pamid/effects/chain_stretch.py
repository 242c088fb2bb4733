"""A chain or belt that stretches under the pull of the muscle.

What it is
    Chain, cord or belt in series with the muscle give under load: the muscle is shorter than the
    angle implies and pulls less. Solved with a single secant step for the pull at which muscle and
    chain agree. The muscle's damping then sits behind a spring: the pull comes late.
What it looks like
    A joint softer than the muscles alone would make it, by 2-10 %, the more so at high pressure
    where they are stiff.
Looks like it
    A softer muscle or a smaller force scale: nearly the same in statics; the dependence on pressure
    separates them, given force sensors. Slack is not modelled: two pulling muscles keep the chain
    taut.
Equation
    F = law at contraction + compliance F; with F0 the pull unstretched and F1 the pull at the
    stretch of F0: F = F0 - F0 (F0 - F1)/(2 F0 - F1), lagged by compliance x drag x F/F0 (drag: the
    muscle's damping force per contraction rate, where the rig tells it)
References
    Spong (1987), J. Dyn. Syst. Meas. Control 109(4), 310-319; Tondu (2012), J. Intelligent Material
    Systems and Structures 23(3), 225-253.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, lag, maximum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ChainStretch(Effect):
    """Series compliance, in contraction per force."""

    family = "flexible-transmission"
    kinds = ("transmission",)
    signals = ("position", "pressure", "law")
    parameters = (
        Parameter("compliance", 2.0, 0.0, 12.0, "percent/kN", spread=2.0, null=0.0).with_source(
            "chains and belts of 1e5-1e6 N/m on a 250 mm muscle: 0.4-4 %/kN"
        ),
    )
    symptoms = ("load",)
    look_alikes = ("two-mass", "force-asymmetry")
    absorbed_by = ("scale", "contraction_0")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        pull = maximum(value, 0.0)
        lost = at.law(at.position, at.pressure) - at.law(
            at.position + p.compliance * pull, at.pressure
        )
        share = pull / maximum(pull + lost, 1.0)
        settled = value - share * lost
        return lag(settled, p.compliance * at.drag * share) if at.offers("drag") else settled
