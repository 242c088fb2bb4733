"""A carriage that a drive pushes along its guide.

What it is
    A linear axis: a carriage on a rail or an air bearing, driven by a linear motor, a screw or a
    toothed belt whose drive receives a force. The ruler reads where it is, and a drive often its
    speed as well.

Equations
    M dv/dt = force - b v - offset, M the mass of everything that moves, rotating parts counted as
    they are felt at the carriage; offset holds a slope and the zero of the amplifier

Typically missing
    Dry friction of guide, seals and screw, with Stribeck's fall of it at low speed (guide);
    friction that differs in both directions; the belt or screw that stretches, and its play
    (transmission); cogging of a linear motor; dead time and a limit of the drive.

References
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on Nonlinear
    System Identification Benchmarks, Eindhoven; Armstrong-Helouvry, Dupont, Canudas de Wit (1994),
    Automatica 30(7).
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig

GRAVITY = 9.81


class LinearAxis(Rig):
    """A driven carriage: force in, position and velocity out."""

    inputs = {"force_n": "N"}
    outputs = {"position_mm": "m", "velocity_mm_per_s": "m/s"}
    ports = {
        "drive": Port("command", "N"),
        "guide": Port("motion", "N", {"position": "m", "velocity": "m/s", "load": "N"}),
        "transmission": Port(
            "transmission", "N", {"position": "m", "velocity": "m/s", "inertia": "kg"}
        ),
        "ruler": Port("reading", "m", {"rate": "m/s"}),
        "tachometer": Port("reading", "m/s"),
    }
    background = {"guide": RoughMap("guide", "position", of="load", tolerance=0.02)}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter.positive("mass", 10.0, 0.01, 1e4, "kg", factor=1.3).with_source(
            "weighed, plus what rotates, divided by the square of its lever"
        ),
        Parameter("viscous", 20.0, 0.0, 1e4, "N s/m", spread=20.0).with_source(
            "estimate: guide and screw"
        ),
        Parameter("offset", 0.0, -100.0, 100.0, "N", spread=2.0).with_source(
            "estimate: slope, amplifier zero"
        ),
    )
    loops = (Loop("force_n", "reference_mm", "position_mm"),)
    controller = {
        "kp_per_mm": 3.0,
        "kd_s_per_mm": 0.15,
        "derivative_filter_s": 0.006,
        "command_limit": 100.0,
    }
    noise = {"position_mm": 0.01, "velocity_mm_per_s": 1.0}
    period_s = 0.002
    excited = {"reference_mm": 100.0, "force_n": 30.0}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        force = port("drive", u.force_n) - p.viscous * x.velocity - p.offset
        force = port(
            "guide", force, position=x.position, velocity=x.velocity, load=GRAVITY * p.mass
        )
        force = port(
            "transmission", force, position=x.position, velocity=x.velocity, inertia=p.mass
        )
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "position_mm": port("ruler", x.position, rate=x.velocity),
            "velocity_mm_per_s": port("tachometer", x.velocity),
        }
