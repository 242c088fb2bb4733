"""Dry friction with an elastic start, after Dahl.

What it is
    Surfaces touch through asperities that bend before they slide. The force builds up over a short
    distance towards its level and never passes it; there is no breakaway peak.
What it looks like
    After every reversal the force changes gradually over the reach instead of jumping; small
    motions about a point behave like a spring with loss, with rounded loops that drift a little.
Looks like it
    Coulomb friction (the same with a sharp corner: the two part only where the reach is large
    against the motion); LuGre and Stribeck friction, which add a peak at low speed; hysteresis of a
    spring or muscle, spread over a far larger distance.
Equation
    value -= level * z / reach,   dz/dt = velocity - |velocity| z / reach
References
    Dahl (1968), A solid friction model, Aerospace Corporation, TOR-0158(3107-18)-1; Dahl (1976),
    Solid friction damping of mechanical vibrations, AIAA Journal 14(12).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, bristle
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class DahlFriction(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.level(0.03, 0.0, 0.5, spread=0.1).with_source(
            "estimate: guides and bearings, 1-15 % of the drive's force"
        ),
        # what bends over later is called hysteresis: Bouc-Wen of shape 1 is the same equation
        Parameter.width(
            "reach", 0.01, 0.0003, 0.05, factor=4.0, size="travel", hard=True
        ).with_source("estimate: ball bearings 10-100 um, seals up to a millimetre"),
    )
    symptoms = ("reversals", "history")
    look_alikes = ("coulomb-friction", "stribeck-friction", "lugre-friction", "bouc-wen-hysteresis")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.level * bristle(at.position, p.reach) * (1.0 / p.reach)
