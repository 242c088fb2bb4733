"""Dry friction in a joint or guide.

What it is
    A force of constant size against the motion. At rest it holds: up to its level the contact only
    gives elastically by a small presliding distance, so the mechanism really sticks and does not
    creep.
What it looks like
    The arm stops short of its target on the side it came from; flat tops at reversals; the width of
    the torque loop depends neither on pressure nor on rate.
Looks like it
    Stribeck and LuGre friction (the same family, apart only at creep speed); muscle hysteresis,
    whose width grows with pressure; a valve dead-band, where the pressure stays while the arm
    sticks.
Equation
    value -= level * stop(position, give) / give
References
    Prandtl (1928), ZAMM 8(2); Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

# what gives over more of the stroke than that, before it slips, is called hysteresis
PRESLIDING = Parameter.width(
    "give", 0.001, 0.0001, 0.02, factor=3.0, size="travel", hard=True
).with_source("presliding of a thousandth of the stroke; 0.5-2 mrad on a joint")


class CoulombFriction(Effect):
    """Constant friction that sticks."""

    family = "friction"
    kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.level(0.03, 0.0, 0.5, spread=0.1).with_source(
            "shaft bearings and chain: 0.05-1 N m on a 10 N m joint"
        ),
        PRESLIDING,
    )
    symptoms = ("stops-short", "direction", "reversals")
    look_alikes = (
        "stribeck-friction",
        "lugre-friction",
        "maxwell-slip-hysteresis",
        "valve-dead-band",
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.level * stop(at.position, p.give) * (1.0 / p.give)
