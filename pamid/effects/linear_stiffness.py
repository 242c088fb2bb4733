"""A spring parallel to the mechanism.

What it is
    A hose, a cable loom, a bellows, a return spring: a force in proportion to the distance from
    where it is slack.
What it looks like
    More force is needed the farther the mechanism stands from a place of rest; released, it drifts
    back there; the resonance lies higher than mass and drive explain.
Looks like it
    A constant offset (the same force everywhere: record two positions); gravity on a joint, which
    is a sine of the angle; a smaller mass, which moves the resonance the same way but leaves
    statics alone.
Equation
    value -= stiffness * (position - rest)
References
    Den Hartog (1956), Mechanical Vibrations, 4th edition, McGraw-Hill.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

REST = Parameter("rest", 0.0, -1.0, 1.0, spread=0.3, size="position").with_source(
    "estimate: near the origin of the coordinate"
)


class LinearStiffness(Effect):
    family = "stiffness"
    general_kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.slope("stiffness", "position", 0.1, -1.0, 5.0, spread=0.5).with_source(
            "estimate: hoses and looms 1-20 % of the force over the stroke; negative: an unstable "
            "rest"
        ),
        REST,
    )
    symptoms = ("position",)
    look_alikes = ("cubic-stiffness", "constant-offset", "gravity")
    absorbed_by = ("stiffness",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.stiffness * (at.position - p.rest)
