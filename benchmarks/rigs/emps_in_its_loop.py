"""EMPS in closed loop: the carriage of data/rigs/emps.py behind the controller that it was recorded
with.

Equations
    drive = kv (kp (reference - x) - w) + pulse,   within -10 .. 10 V
    force = 35.15 N/V drive,   dw/dt = (v - w) / lag
    M dv/dt = force - Fv v - offset

w is the velocity as the controller sees it, a difference of the encoder's counts behind a filter.
kp, kv and the limit are published; the lag is that of the recorded drive, which with 1 ms is left
with an error of 8 mV RMS (with none 36 mV). `pulse_v` is the column `pulse_n` of the second
recording: the recorded drive shows that it is in volts (a weight of 1.01) and is added behind the
controller.

References
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on Nonlinear
    System Identification Benchmarks, Eindhoven.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number, clip


def held(name: str, value: float, unit: str) -> Parameter:
    return Parameter(name, value, 0.1 * value, 10.0 * value, unit, fitted=False, source="published")


class EmpsInItsLoop(Rig):
    """A carriage on a motor-driven screw, with its controller."""

    inputs = {"reference_m": "m", "pulse_v": "V"}
    optional = {"pulse_v": 0.0}
    # the controller samples reference and encoder alike: held by itself the reference came late
    between = {"reference_m": "linear"}
    outputs = {"position_m": "m"}
    ports = {
        "force": Port("motion", "N", {"velocity": "m/s", "position": "m"}),
        "encoder": Port("reading", "m", {"rate": "m/s"}),
    }
    states = (State("position", "m"), State("velocity", "m/s"), State("seen", "m/s"))
    parameters = (
        Parameter("mass", 80.0, 20.0, 300.0, "kg", spread=40.0, source="estimate"),
        Parameter("viscous", 150.0, 0.0, 1000.0, "N s/m", spread=150.0, source="estimate"),
        Parameter("offset", 0.0, -30.0, 30.0, "N", spread=10.0, source="estimate"),
        held("kp", 160.18, "1/s"),
        held("kv", 243.45, "V s/m"),
        held("drive_gain", 35.15065, "N/V"),
        held("limit", 10.0, "V"),
        held("lag", 0.001, "s"),
    )
    noise = {"position_m": 5e-7}
    period_s = 0.001

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        wanted = p.kp * (u.reference_m - x.position) - x.seen
        drive = clip(p.kv * wanted + u.pulse_v, -p.limit, p.limit)
        force = p.drive_gain * drive - p.viscous * x.velocity - p.offset
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {
            "position": x.velocity,
            "velocity": force / p.mass,
            "seen": (x.velocity - x.seen) / p.lag,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"position_m": port("encoder", x.position, rate=x.velocity)}
