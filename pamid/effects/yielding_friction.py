"""Friction that sets in smoothly with speed.

What it is
    A force against the motion that is in proportion to speed while it is slow and stays at a
    constant level above a certain speed: a fluid or a grease that yields, a magnetised fluid, a
    film that carries the more the faster it is sheared, the rubbing of many small contacts.
What it looks like
    Over speed the missing force is a step with rounded shoulders; at reversals nothing sticks, and
    the force passes through zero together with the speed.
Looks like it
    Coulomb friction, which turns over a way instead of a speed; saturation of the force sensor,
    which trims the spring as well as the damper; drag that falls behind at high speed.
Equation
    value -= level * tanh(velocity / speed)
References
    Andersson, Soederberg, Bjoerklund (2007), Friction models for sliding dry, boundary and mixed
    lubricated contacts, Tribology International 40(4), 580-587; Kwok, Ha, Nguyen, Li, Samali
    (2006), A novel hysteretic model for magnetorheological fluid dampers, Sensors and Actuators A
    132(2), 441-451.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, tanh
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

SPEED = Parameter.width(
    "speed", 0.1, 0.005, 1.0, factor=3.0, size="velocity", tries=(0.4,)
).with_source(
    "estimate: a hundredth of the top speed for grease, some tenths for fluids that yield"
)


class YieldingFriction(Effect):
    """A level of friction that is reached at some speed."""

    family = "friction"
    general_kinds = ("motion",)
    signals = ("velocity",)
    parameters = (
        Parameter.level(0.05, 0.0, 3.0, spread=0.3).with_source(
            "estimate: bearings 2-10 % of the drive's force, a yielding damper all of it"
        ),
        SPEED,
    )
    symptoms = ("reversals", "history")
    look_alikes = ("coulomb-friction", "stribeck-friction", "saturation", "signal-dependent-yield")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.level * tanh(at.velocity / p.speed)
