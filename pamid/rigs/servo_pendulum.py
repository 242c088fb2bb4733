"""A pendulum on the shaft of a servo.

What it is
    A geared servo, as in a robot's leg, that carries a rod with a known mass: the usual bench on
    which a servo's friction is identified, for the weight loads the gear in every position.

Equations
    J dw/dt = gain voltage - damping w - m g l sin(angle), J = m l^2 + rotor, the angle counted from
    hanging; damping holds the back EMF as well

Typically missing
    Dry friction, the more the larger the load on the teeth (gear: `load` is the mean of the torques
    on both of their sides); Stribeck's fall of it at low speed; play and a soft horn (horn); dead
    time of the bus, a voltage that ends at the supply or starts at a dead zone (driver).

References
    Duclusaud, Passault, Padois, Ly (2024), Extended friction models for the physics simulation of
    servo actuators, arXiv 2410.08650; Armstrong-Helouvry, Dupont, Canudas de Wit (1994),
    Automatica 30(7).
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number, sin
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig

GRAVITY = 9.81


class ServoPendulum(Rig):
    """A pendulum on a geared servo: voltage in, angle out."""

    inputs = {"voltage_v": "V"}
    outputs = {"angle_deg": "rad"}
    ports = {
        "driver": Port("command", "V", {"position": "rad"}),
        "gear": Port("motion", "N m", {"position": "rad", "velocity": "rad/s", "load": "N m"}),
        "horn": Port(
            "transmission", "N m", {"position": "rad", "velocity": "rad/s", "inertia": "kg m2"}
        ),
        "encoder": Port("reading", "rad", {"rate": "rad/s"}),
    }
    background = {"driver": RoughMap("torque_constant", "position", tolerance=0.02)}
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter.held("mass", 0.3, 0.0, 50.0, "kg").with_source("kitchen scale"),
        Parameter.held("length", 0.15, 0.01, 2.0, "m").with_source("tape measure, axis to mass"),
        Parameter.positive("gain", 0.117, 0.005, 5.0, "N m/V", factor=1.3).with_source(
            "data sheet: stall torque over voltage"
        ),
        Parameter.positive("damping", 0.22, 0.001, 10.0, "N m s", factor=1.5).with_source(
            "data sheet: stall torque over speed without load"
        ),
        Parameter.positive("rotor", 0.005, 1e-5, 1.0, "kg m2", factor=2.0).with_source(
            "estimate: ratio squared times the rotor's inertia"
        ),
    )
    loops = (Loop("voltage_v", "reference_deg", "angle_deg"),)
    controller = {
        "kp_per_deg": 0.4,
        "kd_s_per_deg": 0.005,
        "derivative_filter_s": 0.01,
        "command_limit": 12.0,
    }
    noise = {"angle_deg": 0.05}
    period_s = 0.005
    excited = {"reference_deg": 60.0, "voltage_v": 6.0}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        drive = p.gain * port("driver", u.voltage_v, position=x.angle)
        weight = -p.mass * GRAVITY * p.length * sin(x.angle)
        inertia = p.mass * p.length * p.length + p.rotor
        torque = drive + weight - p.damping * x.velocity
        torque = port(
            "gear", torque, position=x.angle, velocity=x.velocity, load=0.5 * (drive - weight)
        )
        torque = port("horn", torque, position=x.angle, velocity=x.velocity, inertia=inertia)
        return {"angle": x.velocity, "velocity": torque / inertia}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"angle_deg": port("encoder", x.angle, rate=x.velocity)}
