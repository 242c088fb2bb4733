"""A damper on a test bench: the motion is imposed, the reaction is read.

What it is
    A hydraulic, gas or magneto-rheological damper in a testing machine, which moves its rod and
    reads the force it takes. A damper with a built-in coil or valve has its current recorded,
    too; without that column it is taken as unfed.

Equations
    on the rod   F = -(damping velocity + stiffness position + preload), what the damper does to it
    load cell    -F, what the machine does to it
    No states: what moves is imposed. The velocity is the position's, from sample to sample.

    The sign is that of `cylinder-bench`: through the port goes what acts on the moving rod, the
    load cell turns it after the port. Position and force count the same way.

Typically missing
    Dry friction or hysteresis of seals and fluid (rod), whose level follows the current where the
    fluid is magnetised; unlike damping in and out; damping that grows with the square of speed or
    yields; play in the eyes; a load cell with a lag.

References
    Spencer, Dyke, Sain, Carlson (1997), Phenomenological model for magnetorheological dampers, J.
    Eng. Mechanics 123(3), 230-238.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number, rate_of
from pamid.model.background import RoughMap
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class DamperBench(Rig):
    """A damper whose motion is imposed: position (and current of its coil) in, reaction out."""

    inputs = {"position_mm": "m", "current_a": "A"}
    optional = {"current_a": 0.0}
    outputs = {"force_n": "N"}
    ports = {
        "rod": Port(
            "motion", "N", {"position": "m", "velocity": "m/s", "load": "N", "current": "A"}
        ),
        "load_cell": Port("reading", "N"),
    }
    background = {
        "rod": (
            RoughMap("stroke", "position", of="load", tolerance=0.02),
            RoughMap("valving", "velocity", of="load", tolerance=0.02),
        )
    }
    parameters = (
        Parameter.positive("damping", 2000.0, 1.0, 1e6, "N s/m", factor=2.0).with_source(
            "data sheet: force at a single speed"
        ),
        Parameter("stiffness", 1000.0, 0.0, 1e6, "N/m", spread=2000.0).with_source(
            "estimate: gas and rubber"
        ),
        Parameter("preload", 0.0, -2000.0, 2000.0, "N", spread=100.0).with_source(
            "read off: force at rest"
        ),
    )
    noise = {"force_n": 2.0}
    period_s = 0.005
    excited = {"position_mm": 10.0, "current_a": 0.5}
    centre = {"current_a": 0.5}
    hold_s = (0.05, 0.4)
    ramped = ("position_mm",)

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        position = u.position_mm
        velocity = rate_of(position)
        reaction = p.damping * velocity + p.stiffness * position + p.preload
        force = port(
            "rod",
            -reaction,
            position=position,
            velocity=velocity,
            load=reaction,
            current=u.current_a,
        )
        return {"force_n": port("load_cell", -force)}
