"""Play between a motor and its joint, with the encoder behind it.

What it is
    The gear of a servo has clearance, and its encoder sits on the output shaft, as in every hobby
    servo: what is read, and what the servo's loop sees, is the joint. The motor's inertia moves
    freely within the gap, where nothing drives the joint.
What it looks like
    A buzz of a few encoder steps about every target; at reversals the joint coasts until the motor
    has crossed the gap, then it is knocked.
Looks like it
    Play with the encoder on the motor (the reading follows the command, the load is late); a dead
    zone of the command; dry friction, which holds where this lets go.
Equation
    as backlash, q = motor + share twist
References
    Nordin, Galic, Gutman (1997), Int. J. Adaptive Control and Signal Processing 11(1), 49-63;
    Nordin, Gutman (2002), Automatica 38(10), 1633-1649.
"""

from typing import Any

from pamid.effects.backlash import Backlash, contact_pull
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.outboard import OutboardEffect
from pamid.model.parameter import Parameter


class LoadSideBacklash(OutboardEffect):
    signals = ("behind", "driven")
    parameters = (
        *Backlash.parameters,
        Parameter("motor_feedback", 0.9, 0.0, 1.0, spread=0.5, tries=(0.1,)).with_source(
            "of what the servo's loop sees: 1 the motor's encoder, 0 the encoder behind the gap"
        ),
    )
    symptoms = ("one-frequency", "reversals")
    look_alikes = ("backlash", "play", "dead-zone", "coulomb-friction")
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        seen = p.motor_feedback * p.share
        value = value + at.driven(seen * z.twist, seen * z.twisting)
        sides = self.outboard(value, at, p.share, z, turned=False)
        motor, twisting = sides.moved(contact_pull(p, z))
        # the position of the port is the motor's and, of the share on the far side, the twist
        joint = motor + p.share * sides.inertia * twisting
        return joint, {"twist": z.twisting, "twisting": twisting}
