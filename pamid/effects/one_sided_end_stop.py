"""An end of travel on one side, or at another distance on either.

What it is
    A buffer at one end of a slide, a hatch that falls on its frame, a lever with a stop screw on
    one side only: beyond `upper`, or below `lower`, it pushes back as an end stop does.
What it looks like
    Position clipped on one side, with a rebound, while the other side is swung through as in the
    model; the mean of a vibration moves away from the stop.
Looks like it
    An end stop at the same distance on both sides, where only one is reached; a spring that
    hardens; an asymmetric saturation of the reading, behind which the machine goes on.
Equation
    d = max(0, position - upper), value -= stiffness d max(0, 1 + (dd/dt)/speed); likewise below
    `lower`, the other way
References
    Hunt, Crossley (1975), J. Applied Mechanics 42(2), 440-445.
"""

from typing import Any

from pamid.effects.end_stop import TRIED_STOPS, EndStop
from pamid.engine.symbolic.vocabulary import Expr, Number, maximum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

OUT_OF_REACH = 2.0  # of the position's size: where no stop is met


class OneSidedEndStop(Effect):
    """Buffers beyond `upper` and below `lower`, each of which may be out of reach."""

    family = "end-stop"
    general_kinds = ("motion",)
    signals = ("position", "velocity")
    parameters = (
        next(q for q in EndStop.parameters if q.name == "stiffness"),
        Parameter(
            "upper", 0.85, -1.0, OUT_OF_REACH, spread=0.5, size="position", hard=True
        ).with_source("estimate: within the travel; twice the travel: none on this side"),
        Parameter(
            "lower", -OUT_OF_REACH, -OUT_OF_REACH, 1.0, spread=0.5, size="position", hard=True
        ).with_source("estimate: within the travel; twice the travel: none on this side"),
        next(q for q in EndStop.parameters if q.name == "speed"),
    )
    symptoms = ("saturates", "direction")
    look_alikes = ("end-stop", "cubic-stiffness", "asymmetric-saturation")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A stop on either side, somewhat within the travel, and none on the other."""
        if "position" not in hints.reach:
            return []
        reach = hints.reach["position"]
        return [
            {side: way * share * reach, other: -way * OUT_OF_REACH * reach}
            for side, other, way in (("upper", "lower", 1.0), ("lower", "upper", -1.0))
            for share in TRIED_STOPS
        ]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        above, below = (
            maximum(0.0, way * (at.position - limit))
            * maximum(0.0, 1.0 + way * at.velocity / p.speed)
            for way, limit in ((1.0, p.upper), (-1.0, p.lower))
        )
        return value - p.stiffness * (above - below)
