"""A safety valve that limits the force of a muscle.

What it is
    Muscles with a built-in force compensator blow off air when the pull exceeds a limit (1200 N at
    20 mm bore). It is a vent that opens with the force, not a clamp: the pressure falls.
What it looks like
    Above the limit the pressure drops although the valve is filling, and the force stays near the
    limit.
Looks like it
    An end stop or a saturated command (the pressure stays up); a leak, which does not wait for a
    force. Within the usual range of the founding rig the limit is never reached.
Equation
    rate -= opening * smooth_step((force - limit) / blend) * outflow
References
    Operating manual of the maker's fluidic muscle with force compensator (fluidic muscle MAS).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect, Hints
from pamid.model.force_limit import LIMIT, OPENING, OPENING_SPAN, blown_off

TRIED = (0.8, 0.9, 0.98)  # of the largest force


class ForceCompensator(Effect):
    """Venting above a force; `opening` is in open vent valves."""

    family = "force-limit"
    kinds = ("rate",)
    signals = ("force", "outflow")
    parameters = (OPENING, LIMIT, OPENING_SPAN)
    symptoms = ("saturates",)
    look_alikes = ("end-stop", "leak")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Limits below the largest force: above it nothing is seen of them, and no slope leads
        back."""
        return [
            {"limit": share * hints.reach["force"]} for share in TRIED if "force" in hints.reach
        ]

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return blown_off(value, at.force, at.outflow, p.opening, p.limit, p.blend)
