"""Viscous friction that differs between the directions.

What it is
    A shock absorber with a valve for each stroke, a check valve in a cylinder's line, a brush that
    trails: the resistance grows with speed, at another rate forward than backward.
What it looks like
    Fast motion is slower one way than the other; the mean drifts with the amplitude of a symmetric
    drive; slow motion shows nothing.
Looks like it
    Viscous friction (the same both ways); dry friction that differs between the directions, which
    does not grow with speed; a rectified command, which shows in the command and not in the speed;
    a force reading that is limited on one side, which where the motion is imposed looks the same.
Equation
    value -= forward max(velocity, 0) + backward min(velocity, 0)
References
    Dixon (2007), The Shock Absorber Handbook, 2nd edition, Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, minimum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class DirectionalDamping(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("velocity",)
    parameters = (
        Parameter.slope("forward", "velocity", 0.05, 0.0, 3.0, spread=0.3).with_source(
            "estimate: shock absorbers take 20-100 % of the force at full speed"
        ),
        Parameter.slope("backward", "velocity", 0.15, 0.0, 3.0, spread=0.3).with_source(
            "estimate: shock absorbers resist rebound 2-4 times as much as compression"
        ),
    )
    symptoms = ("direction", "speed")
    look_alikes = (
        "viscous-friction",
        "quadratic-drag",
        "directional-friction",
        "asymmetric-saturation",
    )
    absorbed_by = ("viscous", "damping")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        v = at.velocity
        return value - p.forward * maximum(v, 0.0) - p.backward * minimum(v, 0.0)
