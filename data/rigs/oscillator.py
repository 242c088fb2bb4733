"""An oscillator with one degree of freedom: mass, spring and damper behind a force, all in volts.

Equations
    x'' = w^2 (gain drive - x) - 2 d w x',    w = 2 pi natural

Written for an electronic one that is sampled: the drive between its samples is not held but runs on
to the next (`between`). `pamid check` tries both and says which fits.

References
    Wigren, Schoukens (2013), Three free data sets for development and benchmarking in nonlinear
    system identification, European Control Conference, 2933-2938.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number

TURN = 6.283185307179586


class Oscillator(Rig):
    """Mass, spring and damper behind a force."""

    inputs = {"drive_v": "V"}
    between = {"drive_v": "linear"}
    outputs = {"response_v": "V"}
    ports = {
        "spring": Port("motion", "V", {"position": "V", "velocity": "V/s"}),
        "sensor": Port("reading", "V", {"rate": "V/s"}),
    }
    states = (State("position", "V"), State("velocity", "V/s"))
    parameters = (
        Parameter("natural", 65.0, 30.0, 130.0, "Hz", spread=15.0, source="a sweep by hand"),
        Parameter("damping", 0.05, 0.001, 0.5, spread=2.0, log=True, source="the same"),
        Parameter("gain", 1.0, 0.1, 10.0, spread=2.0, log=True, source="the same"),
    )
    noise = {"response_v": 0.0003}
    period_s = 2**14 / 1e7

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        w = TURN * p.natural
        force = p.gain * u.drive_v - x.position
        force = port("spring", force, position=x.position, velocity=x.velocity)
        return {
            "position": x.velocity,
            "velocity": w * w * force - 2.0 * p.damping * w * x.velocity,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"response_v": port("sensor", x.position, rate=x.velocity)}
