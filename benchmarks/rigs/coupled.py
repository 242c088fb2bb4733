"""Motor and load on a coupling, with a brake that a current closes; both positions are measured."""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State


class Coupled(Rig):
    """Command of the motor to the angles of motor and load."""

    inputs = {"command": "", "brake_a": "A"}
    outputs = {"motor_rad": "rad", "load_rad": "rad"}
    ports = {
        "motor": Port("motion", "N m", {"position": "rad", "velocity": "rad/s", "current": "A"}),
        "coupling": Port("transmission", "N m", {"stretch": "rad"}),
    }
    states = (
        State("motor", "rad"),
        State("motor_speed", "rad/s"),
        State("load", "rad"),
        State("load_speed", "rad/s"),
    )
    parameters = (
        Parameter("inertia", 2e-3, 5e-4, 1e-2, "kg m2", spread=5e-4, source="data sheet"),
        Parameter("load_inertia", 3e-3, 5e-4, 2e-2, "kg m2", spread=1e-3, source="drawing"),
        Parameter("stiffness", 4.0, 0.5, 40.0, "N m/rad", spread=1.5, source="data sheet"),
        Parameter("loss", 0.01, 0.0, 0.2, "N m s/rad", spread=0.01, source="estimate"),
        Parameter("viscous", 0.02, 0.0, 0.2, "N m s/rad", spread=0.01, source="run-out"),
        Parameter("centring", 0.3, 0.05, 3.0, "N m/rad", spread=0.1, source="spring's data sheet"),
        Parameter("torque", 0.5, 0.1, 2.0, "N m", fitted=False, source="data sheet"),
    )
    noise = {"motor_rad": 5e-4, "load_rad": 5e-4}
    period_s = 0.002

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        stretch = x.motor - x.load
        shaft = p.stiffness * stretch + p.loss * (x.motor_speed - x.load_speed)
        shaft = port("coupling", shaft, stretch=stretch)
        drive = p.torque * u.command - p.centring * x.motor - p.viscous * x.motor_speed
        drive = port("motor", drive, position=x.motor, velocity=x.motor_speed, current=u.brake_a)
        return {
            "motor": x.motor_speed,
            "motor_speed": (drive - shaft) / p.inertia,
            "load": x.load_speed,
            "load_speed": shaft / p.load_inertia,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        return {"motor_rad": x.motor, "load_rad": x.load}
