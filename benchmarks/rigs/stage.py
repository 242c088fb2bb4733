"""A sprung stage on a rail, pushed by a voice coil: a rig as a user would write it."""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State


class Stage(Rig):
    """Mass on a spring, driven by a current in [-1, 1]."""

    inputs = {"command": ""}
    outputs = {"position_m": "m"}
    ports = {
        "coil": Port("command", ""),
        "force": Port("motion", "N", {"velocity": "m/s", "position": "m", "load": "N"}),
        "encoder": Port("reading", "m", {"rate": "m/s"}),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 2.0, 0.5, 8.0, "kg", spread=0.4, source="scale"),
        Parameter("spring", 80.0, 10.0, 400.0, "N/m", spread=20.0, source="data sheet"),
        Parameter(
            "push", 10.0, 2.0, 40.0, "N", fitted=False, source="maker: force at full current"
        ),
    )
    noise = {"position_m": 2e-5}
    period_s = 0.002

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        drive = p.push * port("coil", u.command)
        load = 9.81 * p.mass + 0.5 * drive  # the coil also presses the carriage onto its rail
        force = port(
            "force",
            drive - p.spring * x.position,
            velocity=x.velocity,
            position=x.position,
            load=load,
        )
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        return {"position_m": port("encoder", x.position, rate=x.velocity)}
