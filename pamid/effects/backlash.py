"""Play between the joint and what it carries.

What it is
    Behind the joint the load sits in a keyway, a gear or a coupling with play: inside the gap
    nothing is transmitted, outside it a damped spring takes over, which pushes but never sticks. A
    chain under the pull of two muscles has no play; this is outboard of the wheel.
What it looks like
    Knocks of force and acceleration when the motion reverses; a resonance whose frequency falls at
    small amplitude; a joint that moves lightly for the width of the gap.
Looks like it
    An outboard mass without play (frequency independent of amplitude); dry friction (sticks instead
    of running free).
Equation
    as two-mass, with the pull w^2 d + 2 damping w q' only where the spring is loaded, d = q beyond
    +-half gap
References
    Nordin, Galic, Gutman (1997), Int. J. Adaptive Control and Signal Processing 11(1), 49-63;
    Nordin, Gutman (2002), Automatica 38(10), 1633-1649.
"""

import math
from typing import Any

from pamid.engine.symbolic.vocabulary import (
    Expr,
    Number,
    absolute,
    maximum,
    minimum,
    smooth_step,
    where,
)
from pamid.model.outboard import LOAD_SHARE, OutboardEffect
from pamid.model.parameter import Parameter

# a ratio z lets a body rebound with exp(-pi z / sqrt(1 - z^2)) of its speed
CONTACT_DAMPING = Parameter.positive(
    "damping", 0.15, 0.01, 2.0, factor=3.0, tries=(0.5,)
).with_source("rebound of 0.5-0.8 between steel teeth: 0.07-0.22; grease and bushings: up to 1")
TAKE_UP = 0.25  # of the half gap, over which the damping sets in


class Backlash(OutboardEffect):
    """Outboard inertia behind a gap."""

    signals = ("inertia",)
    parameters = (
        LOAD_SHARE,
        Parameter.width("half_gap", 0.006, 0.0005, 0.05, factor=3.0, tries=(0.02,)).with_source(
            "gaps of 0.1-2 deg, typically 0.5 deg"
        ),
        Parameter.positive(
            "frequency", 7.2, 1.2, 15.0, factor=2.0, size="1/timescale", softens=True, tries=(3.0,)
        ).with_source("in contact: 300 N m/rad with 0.01-0.08 kg m2"),
        CONTACT_DAMPING,
    )
    symptoms = ("reversals", "rings")
    look_alikes = ("two-mass", "coulomb-friction")
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        torque, twisting = self.outboard(value, at, p.share, z).moved(contact_pull(p, z))
        return torque, {"twist": z.twisting, "twisting": twisting}


def contact_pull(p: Any, z: Any) -> Expr:
    """Acceleration with which the two sides of a gap pull at each other by their twist (rad/s2)."""
    w = (2.0 * math.pi) * p.frequency
    beyond = z.twist - maximum(-p.half_gap, minimum(z.twist, p.half_gap))
    loaded = smooth_step(absolute(beyond) / (TAKE_UP * p.half_gap))
    spring = w * w * beyond + 2.0 * p.damping * w * loaded * z.twisting
    pull = where(beyond > 0.0, maximum(spring, 0.0), minimum(spring, 0.0))
    return where(absolute(beyond) > 0.0, pull, 0.0)
