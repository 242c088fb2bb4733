"""Hysteresis of parallel elasto-slip elements.

What it is
    Four springs in parallel, each slipping at a different stretch, hold back every motion; the
    memory is non-local, so minor loops close. In a muscle threads rub on threads and on rubber, and
    the friction grows with the pressure that presses the braid together; at a general port it is a
    bundle of wires, a leaf spring, a wound seal, a rubber mount.
What it looks like
    Static loops of force over position that do not depend on the rate (0.01-1 Hz); their width
    grows, up to a few reaches, with the stroke, in a muscle also with the pressure.
Looks like it
    Dry friction in the joint (width independent of pressure); muscle damping (grows with the rate);
    Bouc-Wen and Prandtl-Ishlinskii forms of the same loops; thread friction, which has a single
    short reach.
Equation
    value -= A sum_i w_i stop(position, d_i)/d_i; w = .4 .3 .2 .1, d = (0.1, 0.4, 1, 2.5) reach;
    A = level, in a muscle level (0.2 + 0.8 p/6 bar)
References
    Vo-Minh, Tjahjowidodo, Ramon, Van Brussel (2011), IEEE/ASME Trans. Mechatronics 16(1), 177-186;
    Iwan (1966), A distributed-element model for hysteresis, J. Appl. Mech. 33(4), 893-900.
"""

from dataclasses import replace
from typing import Any, ClassVar

from pamid.engine.symbolic.vocabulary import Expr, Number, expression, maximum, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter

NOMINAL_PA = 6e5
ELEMENTS = ((0.4, 0.1), (0.3, 0.4), (0.2, 1.0), (0.1, 2.5))  # (weight, stretch in reaches)


def pressed(at: Any) -> Expr:
    """Share of a muscle's friction at 6 bar at this pressure; 1 where the port is not an actuator
    or offers no pressure."""
    if at.kind != "actuator-force" or not at.offers("pressure"):
        return expression(1.0)
    return 0.2 + (0.8 / NOMINAL_PA) * maximum(at.pressure, 0.0)


def anywhere(reach: Parameter) -> tuple[Parameter, Parameter]:
    """The level of a loop at a general port, which may well exceed half of the force, and its reach
    (bounds without a muscle's figures)."""
    level = Parameter.level(0.15, 0.0, 3.0, spread=0.4).with_source(
        "estimate: wire-rope and rubber mounts 10-50 % of their force, dampers all of it"
    )
    return level, replace(
        reach,
        low=0.02,
        high=1.0,
        tries=(0.2,),
        source="estimate: some hundredths of the stroke to all of it; what bends over sooner "
        "is dry friction",
    )


class MaxwellSlipHysteresis(Effect):
    """Four elasto-slip elements, stiffer under pressure in a muscle; `level` is the friction force,
    there at 6 bar."""

    family = "muscle-hysteresis"
    families: ClassVar[dict[str, str]] = {"motion": "hysteresis"}
    kinds = ("actuator-force",)
    general_kinds: ClassVar[tuple[str, ...]] = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.level(0.05, 0.0, 0.25, spread=0.05).with_source(
            "20-80 N at 6 bar; data sheet: at most 3 % of 1500 N"
        ),
        Parameter.width("reach", 0.05, 0.008, 0.4, factor=2.5, tries=(0.02, 0.15)).with_source(
            "estimate: 0.4 % of contraction"
        ),
    )
    general_parameters = anywhere(parameters[1])
    limits: ClassVar[dict[str, str]] = {"reach": "friction"}  # slips at once
    symptoms = ("history",)
    look_alikes = (
        "bouc-wen-hysteresis",
        "prandtl-ishlinskii-hysteresis",
        "thread-friction",
        "coulomb-friction",
    )
    absorbed_by = ("damping",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        held: Number = 0.0
        for weight, stretch in ELEMENTS:
            width = stretch * p.reach
            held = held + weight * stop(at.position, width) / width
        return value - p.level * pressed(at) * held
