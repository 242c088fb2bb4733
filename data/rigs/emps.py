"""EMPS: an electro-mechanical positioning system, a carriage on a screw driven by a DC motor.

Equations
    M dv/dt = force - Fv v - offset

Recordings: `force_n` is the motor's force (drive voltage times its constant), `position_m` the
encoder. The column `pulse_n` of the second recording is not used: a least-squares fit of the
equation of motion gives it the weight 0.03, so whatever the pulses did is in `force_n` already.

Priors come from what one knows before measuring (a carriage of some tens of kilograms plus the
reflected inertia of screw and motor), not from the published estimates.

References
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on Nonlinear
    System Identification Benchmarks, Eindhoven.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number


class Emps(Rig):
    """A carriage on a motor-driven screw: mass, viscous friction, force offset."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "force": Port("motion", "N", {"velocity": "m/s", "position": "m"}),
        "encoder": Port("reading", "m", {"rate": "m/s"}),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter(
            "mass",
            80.0,
            20.0,
            300.0,
            "kg",
            spread=40.0,
            source="estimate: carriage, screw and motor together",
        ),
        Parameter(
            "viscous",
            150.0,
            0.0,
            1000.0,
            "N s/m",
            spread=150.0,
            source="estimate: guides, screw and motor",
        ),
        Parameter(
            "offset", 0.0, -30.0, 30.0, "N", spread=10.0, source="estimate: tilt and amplifier zero"
        ),
    )
    noise = {"position_m": 5e-7}
    period_s = 0.001

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        force = u.force_n - p.viscous * x.velocity - p.offset
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"position_m": port("encoder", x.position, rate=x.velocity)}
