"""Dry friction that grows with the load on the guide, bearing or gear.

What it is
    Friction after Amontons: its level is a coefficient times the force that presses the surfaces
    together. In a gear or a bearing that force is the load that the drive carries, so friction is
    small when idle and large under load.
What it looks like
    The width of the loop between motion back and forth grows with the load; tests with another
    payload or another co-contraction disagree with a friction level fitted to the first.
Looks like it
    Coulomb friction (constant width: vary the load to tell them apart); muscle hysteresis, whose
    width grows with pressure and so with the load of an antagonistic joint.
Equation
    value -= coefficient * |load| * stop(position, give) / give
References
    Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7); Dohring, Lee, Newman
    (1993), A load-dependent transmission friction model: theory and experiments, IEEE Int. Conf.
    Robotics and Automation.
"""

from typing import Any

from pamid.effects.coulomb_friction import PRESLIDING
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class LoadDependentFriction(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("position", "load")
    parameters = (
        Parameter.slope("coefficient", "load", 0.05, 0.0, 1.0, spread=0.15).with_source(
            "estimate: sliding pairs 0.05-0.3, rolling pairs 0.001-0.01 of the normal force"
        ),
        PRESLIDING,
    )
    symptoms = ("load",)
    look_alikes = ("coulomb-friction", "maxwell-slip-hysteresis")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.coefficient * absolute(at.load) * stop(at.position, p.give) * (
            1.0 / p.give
        )
