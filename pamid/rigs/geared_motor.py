"""A motor that turns a load through a compliant gear: two inertias.

What it is
    A motor, a gearbox, belt or long shaft that gives, and a load behind it. An encoder sits on the
    motor, on the load, or on both. The amplifier sets a voltage and measures the current. Play
    between motor and load can be separated from friction here: within the gap the load is free, and
    the current shows what the motor turns alone.

Equations
    current  i = (voltage - k wm)/R, the winding's lag left out
    motor    Jm dwm/dt = k i - bm wm - T/N
    load     Jl dwl/dt = T - bl wl + external torque
    gear     T = stiffness (am/N - al) + damping (wm/N - wl), as the load sees it

Typically missing
    Play between motor and load (gear); dry friction of brushes and bearings (motor), of gearbox and
    load (load), the more the larger the torque; cogging (motor, position); a load that hangs off
    centre (load); dead time and dead zone of the amplifier; an encoder that is late.

References
    Nordin, Gutman (2002), Controlling mechanical systems with backlash: a survey, Automatica
    38(10), 1633-1649; Krause, Wasynczuk, Sudhoff (2002), Analysis of Electric Machinery and Drive
    Systems, Wiley.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig

TURNING = {"position": "rad", "velocity": "rad/s", "load": "N m"}


class GearedMotor(Rig):
    """A motor, a compliant gear and a load: voltage in, angles of both and current out."""

    inputs = {"voltage_v": "V", "external_torque_nm": "N m"}
    optional = {"external_torque_nm": 0.0}
    outputs = {"motor_angle_deg": "rad", "load_angle_deg": "rad", "current_a": "A"}
    ports = {
        "amplifier": Port("command", "V", {"counter_voltage": "V", "position": "rad"}),
        "motor": Port("motion", "N m", {**TURNING, "current": "A"}),
        "gear": Port("transmission", "N m", {"stretch": "rad"}),
        "load": Port("motion", "N m", TURNING),
        "motor_encoder": Port("reading", "rad", {"rate": "rad/s"}),
        "load_encoder": Port("reading", "rad", {"rate": "rad/s"}),
        "ammeter": Port("reading", "A"),
    }
    # a single constant along the turn: it makes the torque, and the voltage against the amplifier's
    background = {
        "motor": RoughMap("torque_constant", "position", of="load", tolerance=0.02),
        "amplifier": RoughMap("voltage_constant", "position", of="counter_voltage", tolerance=0.02),
    }
    states = (
        State("motor_angle", "rad"),
        State("motor_velocity", "rad/s"),
        State("load_angle", "rad"),
        State("load_velocity", "rad/s"),
    )
    parameters = (
        Parameter.positive("resistance", 1.0, 0.05, 50.0, "Ohm", factor=1.3).with_source(
            "data sheet, cold"
        ),
        Parameter.positive("constant", 0.05, 0.002, 1.0, "N m/A", factor=1.1).with_source(
            "data sheet, k"
        ),
        Parameter.held("ratio", 20.0, 0.1, 1e4).with_source("counted teeth, N"),
        Parameter.positive("rotor", 4e-5, 1e-8, 1.0, "kg m2", factor=1.3).with_source(
            "data sheet, Jm"
        ),
        Parameter.positive("inertia", 0.02, 1e-6, 100.0, "kg m2", factor=1.5).with_source(
            "drawing, Jl"
        ),
        Parameter.positive("stiffness", 300.0, 0.1, 1e6, "N m/rad", factor=2.0).with_source(
            "estimate: a weight on a lever, motor held"
        ),
        Parameter("gear_damping", 0.5, 0.0, 50.0, "N m s/rad", spread=0.5).with_source("estimate"),
        Parameter("motor_viscous", 5e-5, 0.0, 0.01, "N m s/rad", spread=5e-5).with_source(
            "estimate: bearings"
        ),
        Parameter("load_viscous", 0.05, 0.0, 5.0, "N m s/rad", spread=0.05).with_source(
            "estimate: grease"
        ),
    )
    loops = (Loop("voltage_v", "reference_deg", "load_angle_deg"),)
    controller = {
        "kp_per_deg": 0.3,
        "kd_s_per_deg": 0.01,
        "derivative_filter_s": 0.006,
        "command_limit": 24.0,
    }
    noise = {"motor_angle_deg": 0.1, "load_angle_deg": 0.02, "current_a": 0.02}
    period_s = 0.002
    excited = {"reference_deg": 60.0, "voltage_v": 12.0}

    def current(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Current of the motor, A."""
        counter = p.constant * x.motor_velocity
        voltage = port("amplifier", u.voltage_v, counter_voltage=counter, position=x.motor_angle)
        return (voltage - counter) / p.resistance  # type: ignore[no-any-return]

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        twist = x.motor_angle / p.ratio - x.load_angle
        twisting = x.motor_velocity / p.ratio - x.load_velocity
        passed = port("gear", p.stiffness * twist + p.gear_damping * twisting, stretch=twist)
        current = self.current(x, u, p, port)
        driving = p.constant * current
        motor = port(
            "motor",
            driving - p.motor_viscous * x.motor_velocity - passed / p.ratio,
            position=x.motor_angle,
            velocity=x.motor_velocity,
            load=driving,
            current=current,
        )
        load = port(
            "load",
            passed - p.load_viscous * x.load_velocity + u.external_torque_nm,
            position=x.load_angle,
            velocity=x.load_velocity,
            load=passed,
        )
        return {
            "motor_angle": x.motor_velocity,
            "motor_velocity": motor / p.rotor,
            "load_angle": x.load_velocity,
            "load_velocity": load / p.inertia,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "motor_angle_deg": port("motor_encoder", x.motor_angle, rate=x.motor_velocity),
            "load_angle_deg": port("load_encoder", x.load_angle, rate=x.load_velocity),
            "current_a": port("ammeter", self.current(x, u, p, port)),
        }
