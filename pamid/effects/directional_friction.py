"""Dry friction that differs between the directions.

What it is
    A lip seal that wipes one way, a worm gear, a chain that climbs its wheel, a single-sided
    piston rod: it takes more force to slide one way than the other.
What it looks like
    The mechanism stops short on both sides, by unequal amounts; the two branches of the loop are
    not symmetric about the model's.
Looks like it
    Coulomb friction with a constant offset (the same while the mechanism slides, apart where it
    rests: the offset goes on pushing); damping that differs between the directions, which grows
    with speed; gravity; a force reading that is limited on one side, where the motion is imposed.
Equation
    value -= (forward max(s, 0) + backward min(s, 0)), s = stop(position, give) / give
References
    Armstrong-Helouvry (1991), Control of Machines with Friction, Kluwer; Duclusaud,
    Passault, Padois, Ly (2025), Extended friction models for the physics simulation of servo
    actuators, IEEE Int. Conf. Robotics and Automation.
"""

from dataclasses import replace
from typing import Any

from pamid.effects.coulomb_friction import PRESLIDING
from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, minimum, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

FORWARD = Parameter.level(0.03, 0.0, 1.0, name="forward", spread=0.1, tries=(0.1,)).with_source(
    "estimate: guides, gears and seals, 1-20 % of the drive's force"
)


class DirectionalFriction(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("position",)
    parameters = (
        FORWARD,
        # unequal to begin with: of equal levels it is Coulomb friction
        replace(FORWARD, name="backward", value=0.08, label="backward_{value}"),
        PRESLIDING,
    )
    symptoms = ("direction", "stops-short")
    look_alikes = (
        "coulomb-friction",
        "constant-offset",
        "directional-damping",
        "asymmetric-saturation",
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        bent = stop(at.position, p.give) * (1.0 / p.give)
        return value - p.forward * maximum(bent, 0.0) - p.backward * minimum(bent, 0.0)
