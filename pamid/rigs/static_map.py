"""An actuator on a test stand as a map without memory: command in, force out.

What it is
    A thruster, a voice coil, a proportional magnet or a pump: a command is sent, its effect is
    read, and the machine has settled by the next sample. `pamid new-rig --like static-map` puts
    columns of other quantities in the places of these two.

Equations
    force = gain command + offset
    No states: a sample does not depend on the sample before it.

Typically missing
    A dead zone, a saturation, unequal sides, hysteresis between up and down (actuator); a lag or a
    dead time longer than a sample (actuator); a sensor with a limited range, a drift or steps
    (sensor).

References
    Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities,
    Wiley; Fossen (2011), Handbook of Marine Craft Hydrodynamics and Motion Control, Wiley.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.background import RoughMap
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class StaticMap(Rig):
    """An actuator on a test stand: command in, force out."""

    inputs = {"command_v": "V"}
    outputs = {"force_n": "N"}
    ports = {"actuator": Port("command", "V"), "sensor": Port("reading", "N")}
    background = {"actuator": RoughMap("actuator_map", tolerance=0.02)}
    parameters = (
        Parameter.positive("gain", 5.0, 0.001, 1e5, "N/V", factor=1.5).with_source(
            "data sheet: rated values"
        ),
        Parameter("offset", 0.0, -100.0, 100.0, "N", spread=1.0).with_source("estimate: zero"),
    )
    noise = {"force_n": 0.2}
    period_s = 0.02
    excited = {"command_v": 8.0}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        force = p.gain * port("actuator", u.command_v) + p.offset
        return {"force_n": port("sensor", force)}
