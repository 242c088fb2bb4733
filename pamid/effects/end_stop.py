"""A mechanical end of travel.

What it is
    Beyond a limit of travel, the same on both sides, a stiff buffer pushes back; its damping grows
    with the penetration, so that it takes up load without a jump and never pulls.
What it looks like
    Position clipped although force and pressure keep moving; a residual on one side of large
    motions only; a rebound.
Looks like it
    A force limit, slack of the weaker muscle or a saturated reading: the force (or the pressure)
    tells.
Equation
    d = max(0, |position| - limit); value -= sign(position) stiffness d max(0, 1 + (dd/dt)/speed)
References
    Hunt, Crossley (1975), J. Applied Mechanics 42(2), 440-445.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, maximum, sign
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

TRIED_STOPS = (0.6, 0.8, 0.9, 0.98)  # of the travel


class EndStop(Effect):
    """Buffers at +-limit; `speed` is the approach at which the damping doubles the force."""

    family = "end-stop"
    kinds = ("motion",)
    signals = ("position", "velocity")
    parameters = (
        Parameter.slope("stiffness", "position", 50.0, 0.0, 150.0, spread=50.0).with_source(
            "200-5000 N m/rad on a joint"
        ),
        Parameter("limit", 0.85, 0.2, 2.0, spread=0.3, size="position").with_source(
            "35-60 deg on a joint that turns +-40 deg"
        ),
        Parameter.width("speed", 1.0, 0.5, 20.0, factor=2.0, size="velocity").with_source(
            "estimate: buffers of 0.5-20 N m s/rad"
        ),
    )
    symptoms = ("saturates",)
    look_alikes = ("force-compensator", "cubic-stiffness")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Stops somewhat within the travel: outside it nothing is seen of them, and no slope leads
        back."""
        return [
            {"limit": share * hints.reach["position"]}
            for share in TRIED_STOPS
            if "position" in hints.reach
        ]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        side = sign(at.position)
        depth = maximum(0.0, absolute(at.position) - p.limit)
        return value - side * p.stiffness * depth * maximum(0.0, 1.0 + side * at.velocity / p.speed)
