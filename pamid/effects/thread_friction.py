"""Dry friction between the threads of a braided muscle.

What it is
    Crossing threads slide over each other under the pressure of the air: dry friction strictly in
    proportion to pressure, with a short presliding reach.
What it looks like
    Loops of contraction whose width divided by pressure is constant; none at all in a vented
    muscle.
Looks like it
    Joint friction (width independent of pressure): loops at 2 and at 5 bar separate the two.
    Maxwell-slip and other hysteresis of the muscle, which keep some width without pressure and bend
    over a longer reach.
Equation
    force -= level (p/6 bar) stop(contraction, give)/give
References
    Tondu, Lopez (2000), IEEE Control Systems Magazine 20(2), 15-38; Chou, Hannaford (1996), IEEE
    Trans. Robotics and Automation 12(1), 90-102.
"""

from typing import Any

from pamid.effects.maxwell_slip_hysteresis import NOMINAL_PA
from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ThreadFriction(Effect):
    """Friction proportional to pressure; `level` is its force at 6 bar."""

    family = "muscle-hysteresis"
    kinds = ("actuator-force",)
    signals = ("position", "pressure")
    parameters = (
        Parameter.level(0.04, 0.0, 0.25, spread=0.05).with_source(
            "thread friction of 10-60 N at working pressure"
        ),
        Parameter.width("give", 0.006, 0.002, 0.1, factor=3.0).with_source(
            "estimate: presliding of 0.05 % of contraction"
        ),
    )
    symptoms = ("history", "load")
    look_alikes = ("maxwell-slip-hysteresis", "bouc-wen-hysteresis", "coulomb-friction")
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        strength = p.level * maximum(at.pressure, 0.0) * (1.0 / NOMINAL_PA)
        return value - strength * stop(at.position, p.give) / p.give
