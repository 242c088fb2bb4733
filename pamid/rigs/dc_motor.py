"""A DC motor that turns a load through a gearbox.

What it is
    A brushed motor (or a brushless motor with built-in commutation), a rigid gearbox, and a load on
    its output shaft: a drive axis, a conveyor, a robot's joint. The amplifier sets a voltage and
    measures the current, the encoder sits on the output shaft. A gear that gives, with inertias on
    both sides of it, is `geared-motor`.

Equations
    current   i = (voltage - k N w)/R, the winding's lag left out
    shaft     J dw/dt = N k i - b w + external torque, J and b of motor and load as the output sees
              them

Typically missing
    Dry friction of gears and brushes, and friction that grows with the load on the teeth
    (shaft); a load that swings behind the encoder, with play or without (gear); torque ripple and
    cogging (shaft, position); dead time and dead zone of the amplifier; an encoder that is late or
    off centre.

References
    Krause, Wasynczuk, Sudhoff (2002), Analysis of Electric Machinery and Drive Systems, Wiley;
    Dohring, Lee, Newman (1993), A load-dependent transmission friction model, IEEE Int. Conf.
    Robotics and Automation.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig


class DcMotor(Rig):
    """A DC motor with gearbox and load: voltage in, angle of the load and current out."""

    inputs = {"voltage_v": "V", "external_torque_nm": "N m"}
    optional = {"external_torque_nm": 0.0}
    outputs = {"angle_deg": "rad", "current_a": "A"}
    ports = {
        "amplifier": Port("command", "V", {"counter_voltage": "V", "position": "rad"}),
        "shaft": Port(
            "motion", "N m", {"position": "rad", "velocity": "rad/s", "load": "N m", "current": "A"}
        ),
        "gear": Port(
            "transmission", "N m", {"position": "rad", "velocity": "rad/s", "inertia": "kg m2"}
        ),
        "encoder": Port("reading", "rad", {"rate": "rad/s"}),
        "ammeter": Port("reading", "A"),
    }
    # a single constant along the turn: it makes the torque, and the voltage against the amplifier's
    background = {
        "shaft": RoughMap("torque_constant", "position", of="load", tolerance=0.02),
        "amplifier": RoughMap("voltage_constant", "position", of="counter_voltage", tolerance=0.02),
    }
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter.positive("resistance", 1.0, 0.05, 50.0, "Ohm", factor=1.3).with_source(
            "data sheet, cold"
        ),
        Parameter.positive("constant", 0.05, 0.002, 1.0, "N m/A", factor=1.1).with_source(
            "data sheet, k"
        ),
        Parameter.held("ratio", 20.0, 0.1, 1e4).with_source("counted teeth, N"),
        Parameter.positive("inertia", 0.03, 1e-5, 10.0, "kg m2", factor=1.5).with_source(
            "drawing of the load, plus ratio squared times the rotor's"
        ),
        Parameter("viscous", 0.05, 0.0, 5.0, "N m s", spread=0.05).with_source(
            "estimate: bearings and grease"
        ),
    )
    loops = (Loop("voltage_v", "reference_deg", "angle_deg"),)
    controller = {
        "kp_per_deg": 0.4,
        "kd_s_per_deg": 0.01,
        "derivative_filter_s": 0.006,
        "command_limit": 24.0,
    }
    noise = {"angle_deg": 0.02, "current_a": 0.02}
    period_s = 0.002
    excited = {"reference_deg": 60.0, "voltage_v": 12.0}

    def currents(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Current of the motor, A."""
        counter = p.constant * p.ratio * x.velocity
        voltage = port("amplifier", u.voltage_v, counter_voltage=counter, position=x.angle)
        return (voltage - counter) / p.resistance  # type: ignore[no-any-return]

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        current = self.currents(x, u, p, port)
        driving = p.ratio * p.constant * current
        torque = driving - p.viscous * x.velocity + u.external_torque_nm
        torque = port(
            "shaft", torque, position=x.angle, velocity=x.velocity, load=driving, current=current
        )
        torque = port("gear", torque, position=x.angle, velocity=x.velocity, inertia=p.inertia)
        return {"angle": x.velocity, "velocity": torque / p.inertia}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "angle_deg": port("encoder", x.angle, rate=x.velocity),
            "current_a": port("ammeter", self.currents(x, u, p, port)),
        }
