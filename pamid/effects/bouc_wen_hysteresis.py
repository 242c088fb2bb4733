"""Hysteresis with a smooth internal variable.

What it is
    A deflection follows the motion, bends over and saturates. Depending on distance and direction
    only, it is independent of the rate; unlike slip elements it forgets where it turned, so minor
    loops do not close.
What it looks like
    Smooth fat loops between force and position, saturating after a few reaches; in a muscle wider
    at high pressure.
Looks like it
    Maxwell-slip and Prandtl-Ishlinskii loops (apart only in minor loops); dry friction, which has
    next to no reach; viscous damping, whose loop widens with the rate.
Equation
    value -= level z; dz/dt = (v - shape |v| z - (1 - shape) v |z|) / reach; in a muscle level times
    (0.2 + 0.8 p/6 bar), at a general port level may be as large as the force itself
References
    Wen (1976), J. Eng. Mech. Div. ASCE 102(2), 249-263; Ikhouane, Rodellar (2007), Systems with
    Hysteresis, Wiley.
"""

from typing import Any, ClassVar

from pamid.effects.maxwell_slip_hysteresis import anywhere, pressed
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter


class BoucWenHysteresis(Effect):
    """Bouc-Wen element of exponent 1; `level` is the force at saturation (6 bar in a muscle)."""

    family = "muscle-hysteresis"
    families = {"motion": "hysteresis"}
    kinds = ("actuator-force",)
    general_kinds = ("motion",)
    signals = ("velocity",)
    states = (State("z"),)
    parameters = (
        Parameter.level(0.05, 0.0, 0.25, spread=0.05).with_source(
            "20-80 N at 6 bar; data sheet: at most 3 % of 1500 N"
        ),
        Parameter.width("reach", 0.06, 0.015, 0.5, factor=2.5, tries=(0.03, 0.2)).with_source(
            "0.2-1 % of contraction"
        ),
        Parameter("shape", 0.7, 0.5, 1.0, spread=0.2).with_source(
            "0.5: unloads with the full stiffness, 1: Dahl"
        ),
    )
    general_parameters = (*anywhere(parameters[1]), parameters[2])
    limits: ClassVar[dict[str, str]] = {"reach": "friction"}  # slips at once
    symptoms = ("history", "reversals")
    look_alikes = (
        "maxwell-slip-hysteresis",
        "prandtl-ishlinskii-hysteresis",
        "coulomb-friction",
        "dahl-friction",
    )
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        v = at.velocity
        bend = p.shape * absolute(v) * z.z + (1.0 - p.shape) * v * absolute(z.z)
        return value - p.level * pressed(at) * z.z, {"z": (v - bend) / p.reach}
