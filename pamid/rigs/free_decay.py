"""A pendulum that is released and left alone: no input.

What it is
    A rod, a leg or a crane's load on a bearing, deflected and let go: the usual test of a bearing's
    friction. Nothing drives it, so a recording determines ratios only; mass and lever are measured
    and held. A mass on a spring looks alike at small angles.

Equations
    dw/dt = - g/L sin(angle - hanging) - decay w, L = J/(m l) the length of the simple pendulum
    torques at the bearing are those of J = m l L

Typically missing
    Dry friction of the bearing: the amplitude falls along a straight line, and the rest is not the
    lowest point (bearing); drag of the air, with the square of the speed (bearing); a cable that
    pulls back; an encoder with coarse steps (encoder).

References
    Feeny, Liang (1996), A decrement method for the simultaneous estimation of Coulomb and viscous
    friction, J. Sound and Vibration 195(1), 149-154.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number, sin
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

GRAVITY = 9.81


class FreeDecay(Rig):
    """A pendulum that is let go: no input, angle out."""

    outputs = {"angle_deg": "rad"}
    ports = {
        "bearing": Port("motion", "N m", {"position": "rad", "velocity": "rad/s"}),
        "encoder": Port("reading", "rad", {"rate": "rad/s"}),
    }
    # no background: weight and lever are exact, and a map along the angle would take up the dry
    # friction of a swing, whose direction follows its angle
    states = (State("angle", "rad", 1.0), State("velocity", "rad/s"))
    parameters = (
        Parameter.held("mass", 0.5, 0.01, 1e3, "kg").with_source("kitchen scale"),
        Parameter.held("lever", 0.25, 0.01, 10.0, "m").with_source("balanced on an edge, l"),
        Parameter.positive("length", 0.3, 0.05, 30.0, "m", factor=1.1).with_source(
            "period by a watch: g (T/2 pi)^2, L"
        ),
        Parameter.positive("decay", 0.05, 1e-5, 20.0, "1/s", factor=3.0).with_source(
            "swings counted until half the amplitude is left"
        ),
        Parameter("hanging_deg", 0.0, -20.0, 20.0, spread=0.5).with_source(
            "estimate: encoder's zero"
        ),
    )
    noise = {"angle_deg": 0.05}
    period_s = 0.01

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        inertia = p.mass * p.lever * p.length
        weight = -p.mass * GRAVITY * p.lever * sin(x.angle - p.hanging_deg)
        torque = weight - inertia * p.decay * x.velocity
        torque = port("bearing", torque, position=x.angle, velocity=x.velocity)
        return {"angle": x.velocity, "velocity": torque / inertia}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"angle_deg": port("encoder", x.angle, rate=x.velocity)}
