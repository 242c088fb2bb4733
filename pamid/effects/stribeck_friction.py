"""Dry friction that falls with speed.

What it is
    Breaking away takes more force than sliding: the level falls from `breakaway` times the sliding
    level at rest to the sliding level itself within a characteristic speed. At rest it sticks like
    plain dry friction.
What it looks like
    Jerky motion at a slow reference (below a few degrees per second), stick-slip; a hunting limit
    cycle with integral action; at working speed the same as plain dry friction.
Looks like it
    Coulomb and LuGre friction (same family, apart only at creep speed and in presliding).
Equation
    value -= level (1 + (breakaway - 1) exp(-(velocity/speed)^2)) stop(position, give)/give
References
    Bo, Pavelescu (1982), Wear 82(3), 277-289; Armstrong-Helouvry, Dupont, Canudas de Wit (1994),
    Automatica 30(7).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, exp, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

#: parameters of `falling_level`
FALLING = (
    Parameter("breakaway", 1.5, 1.0, 2.5, spread=0.4).with_source(
        "1.1-2 times the sliding friction"
    ),
    Parameter.width(
        "speed", 0.025, 0.005, 0.2, factor=2.5, size="velocity", tries=(0.1,)
    ).with_source("0.01-0.2 rad/s on a joint that reaches 2 rad/s"),
)


def falling_level(at: Any, p: Any) -> Expr:
    """Friction at this speed, in sliding levels: `breakaway` at rest, 1 when fast."""
    ratio = at.velocity / p.speed
    return 1.0 + (p.breakaway - 1.0) * exp(-(ratio * ratio))


class StribeckFriction(Effect):
    """Sticking friction with a falling characteristic; `level` is the sliding friction."""

    family = "friction"
    kinds = ("motion",)
    signals = ("position", "velocity")
    parameters = (
        Parameter.level(0.03, 0.0, 0.4, spread=0.1).with_source(
            "shaft bearings and chain: 0.05-1 N m on a 10 N m joint"
        ),
        *FALLING,
        Parameter.width(
            "give", 0.0015, 0.0007, 0.02, factor=3.0, size="travel", hard=True
        ).with_source("presliding of 0.5-2 mrad"),
    )
    symptoms = ("stops-short", "speed")
    look_alikes = ("coulomb-friction", "lugre-friction", "maxwell-slip-hysteresis")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.level * falling_level(at, p) * stop(at.position, p.give) / p.give
