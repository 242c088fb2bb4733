"""An arm that swings behind its joint.

What it is
    A share of the inertia sits behind something elastic: a slender arm, a coupling, a mount.
    Measured at the joint, this outboard part swings at its natural frequency and pulls back on the
    joint.
What it looks like
    Ringing at a frequency that depends neither on pressure nor on amplitude; an anti-resonance
    followed by a resonance in the frequency response of the angle; more of it with the heavy load.
Looks like it
    Muscle damping set too high or dead time, which ring without an anti-resonance and at a
    frequency that follows the pressure; backlash, whose frequency falls at small amplitude.
Equation
    q'' = -w^2 q - 2 damping w q' - a + g, w = 2 pi frequency; a = T_out/J,
    T_out = (T + share J (w^2 q + 2 damping w q' - g)) / (1 - share); g = 0.
    Where the port offers `behind`, a joint of an arm that carries J - A in addition to its motor A:
    T, J and g, the acceleration of what it carries when let go, are those of the pose turned by
    share q; share is that of J - A, and so share (J - A)/J of J; w^2 and w are multiplied by the
    usual J - A over that in this pose, so that the stiffness is a single number
References
    Spong (1987), J. Dyn. Syst. Meas. Control 109(4), 310-319.
"""

import math
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.outboard import LOAD_SHARE, OutboardEffect
from pamid.model.parameter import Parameter

DAMPING = Parameter.positive("damping", 0.02, 0.003, 0.5, factor=2.5, tries=(0.1,)).with_source(
    "damping ratio of metal arms and couplings: 0.005-0.05"
)


class TwoMass(OutboardEffect):
    """Outboard inertia on a damped spring; `frequency` is its natural frequency with the joint
    held."""

    signals = ("inertia",)
    parameters = (
        LOAD_SHARE,
        Parameter.positive(
            "frequency",
            4.8,
            0.9,
            15.0,
            factor=2.0,
            size="1/timescale",
            softens=True,
            tries=(2.1, 9.0),
        ).with_source("30-1000 N m/rad with a load of 0.08 kg m2: 3-18 Hz"),
        DAMPING,
    )
    symptoms = ("rings", "one-frequency")
    look_alikes = ("backlash", "chain-stretch", "dead-time", "external-vibration")
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        w = (2.0 * math.pi) * p.frequency
        pull = w * w * z.twist + 2.0 * p.damping * w * z.twisting
        torque, twisting = self.outboard(value, at, p.share, z).moved(pull)
        return torque, {"twist": z.twisting, "twisting": twisting}
