"""A shaft that a servo drive turns: it receives a torque.

What it is
    A torque-controlled servo with a load on its shaft, direct or behind a gearbox or a belt: a
    spindle, a robot's joint with a current loop in the drive, a pulley that pulls a carriage.
    Torques and the inertia are those at the shaft whose angle is read.

Equations
    J dw/dt = torque - b w - offset, J of drive and load as that shaft sees them

Typically missing
    Dry friction of bearings, gears and belt (shaft), the more the larger the torque they pass;
    cogging (shaft, position); a belt or gearbox that gives, and its play (belt); gravity on a load
    off centre; dead time of the bus, a torque that ends at a limit (drive).

References
    Krause, Wasynczuk, Sudhoff (2002), Analysis of Electric Machinery and Drive Systems, Wiley;
    Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7).
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig


class ServoAxis(Rig):
    """A torque-controlled shaft: torque in, angle and velocity out."""

    inputs = {"torque_nm": "N m"}
    outputs = {"angle_deg": "rad", "velocity_deg_per_s": "rad/s"}
    ports = {
        "drive": Port("command", "N m"),
        "shaft": Port("motion", "N m", {"position": "rad", "velocity": "rad/s", "load": "N m"}),
        "belt": Port(
            "transmission", "N m", {"position": "rad", "velocity": "rad/s", "inertia": "kg m2"}
        ),
        "encoder": Port("reading", "rad", {"rate": "rad/s"}),
        "tachometer": Port("reading", "rad/s"),
    }
    background = {"shaft": RoughMap("torque_constant", "position", of="load", tolerance=0.02)}
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter.positive("inertia", 0.02, 1e-6, 100.0, "kg m2", factor=1.3).with_source(
            "drawing of the load, plus the drive's"
        ),
        Parameter("viscous", 0.1, 0.0, 50.0, "N m s", spread=0.1).with_source(
            "estimate: bearings, belt"
        ),
        Parameter("offset", 0.0, -5.0, 5.0, "N m", spread=0.02).with_source(
            "estimate: zero of the drive"
        ),
    )
    loops = (Loop("torque_nm", "reference_deg", "angle_deg"),)
    controller = {
        "kp_per_deg": 0.05,
        "kd_s_per_deg": 0.002,
        "derivative_filter_s": 0.006,
        "command_limit": 2.0,
    }
    noise = {"angle_deg": 0.02, "velocity_deg_per_s": 2.0}
    period_s = 0.002
    excited = {"reference_deg": 60.0, "torque_nm": 0.5}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        driving = port("drive", u.torque_nm)
        torque = driving - p.viscous * x.velocity - p.offset
        torque = port("shaft", torque, position=x.angle, velocity=x.velocity, load=driving)
        torque = port("belt", torque, position=x.angle, velocity=x.velocity, inertia=p.inertia)
        return {"angle": x.velocity, "velocity": torque / p.inertia}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "angle_deg": port("encoder", x.angle, rate=x.velocity),
            "velocity_deg_per_s": port("tachometer", x.velocity),
        }
