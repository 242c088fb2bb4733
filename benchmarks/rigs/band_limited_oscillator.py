"""The oscillator of data/rigs/oscillator.py whose drive is band-limited between its samples.

Equations
    x'' = w^2 (gain (drive + bend drive2 + curl drive4) - x) - 2 d w x',    w = 2 pi natural

drive2 and drive4 are the second and fourth differences of the sampled drive: straight lines between
the samples lose what bend and curl give back (-1/12 and 1/90 for slow signals).

References
    Wigren, Schoukens (2013), Three free data sets for development and benchmarking in nonlinear
    system identification, European Control Conference, 2933-2938.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number

TURN = 6.283185307179586


class BandLimitedOscillator(Rig):
    """Mass, spring and damper behind a force."""

    inputs = {"drive_v": "V", "bend_v": "V", "curl_v": "V"}
    between = {"drive_v": "linear", "bend_v": "linear", "curl_v": "linear"}
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
        Parameter("bend", -0.083, -1.0, 1.0, spread=0.1, source="-1/12 for slow signals"),
        Parameter("curl", 0.01, -1.0, 1.0, spread=0.1, source="1/90 for slow signals"),
    )
    noise = {"response_v": 0.0003}
    period_s = 2**14 / 1e7

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        w = TURN * p.natural
        force = p.gain * (u.drive_v + p.bend * u.bend_v + p.curl * u.curl_v) - x.position
        force = port("spring", force, position=x.position, velocity=x.velocity)
        return {
            "position": x.velocity,
            "velocity": w * w * force - 2.0 * p.damping * w * x.velocity,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"response_v": port("sensor", x.position, rate=x.velocity)}
