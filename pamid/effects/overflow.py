"""A loss that begins above a level.

What it is
    A tank that spills over its rim, a relief valve that lifts, a battery that gasses: what is
    stored beyond a level is lost, the faster the more there is of it.
What it looks like
    The stored quantity hardly rises above a level whatever flows in; below it the model is right.
Looks like it
    A saturated sensor (the reading stops, the store does not: what flows out goes on rising); a
    leak or first-order loss, which acts at every level; saturation of the inflow.
Equation
    value -= gain * max(stored - level, 0)
References
    Schoukens, Mattson, Wigren, Noel (2016), Cascaded tanks benchmark combining soft and hard
    nonlinearities, Workshop on Nonlinear System Identification Benchmarks, Brussels.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

TRIED_LEVELS = (0.95, 0.8)  # of the largest level that the recordings reach


def tried_levels(hints: Hints) -> list[dict[str, float]]:
    """Rims within what the store reaches; none where the reach is unknown."""
    if "stored" not in hints.reach:
        return []
    return [{"level": share * hints.reach["stored"]} for share in TRIED_LEVELS]


class Overflow(Effect):
    family = "overflow"
    general_kinds = ("rate",)
    signals = ("stored",)
    parameters = (
        Parameter.slope("gain", "stored", 5.0, 0.0, 50.0, spread=10.0).with_source(
            "estimate: several times the rate of the store, or the rim would not hold the level"
        ),
        Parameter("level", 0.8, 0.1, 1.2, spread=0.3, size="stored", tries=(0.6,)).with_source(
            "estimate: seen only if it lies below the largest level"
        ),
    )
    symptoms = ("saturates", "level")
    look_alikes = ("first-order-loss", "leak", "saturation", "overflow-into-store")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Levels within what the store reaches: above it nothing spills, and no slope leads
        back."""
        return tried_levels(hints)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.gain * maximum(at.stored - p.level, 0.0)
