"""A pneumatic cylinder on a force bench: the motion is imposed, the force is read.

What it is
    A drive moves the piston rod, the pressure is held or regulated, and a load cell between drive
    and rod reads what the drive has to push with. Position and force count as positive into the
    cylinder, against the air.

Equations
    on the rod   F = -(area pressure + preload), what the cylinder does to the rod
    load cell    -F, what the drive does to it
    No states: what moves is imposed. The velocity is the position's, from sample to sample.

    The sign: through the port goes what acts ON the moving part, so that friction opposes its
    velocity there as on any other rig; the load cell turns the sign, after the port. A bench that
    counts its force or its position the other way turns that column.

Typically missing
    Dry friction of the seals, the more the higher the pressure (piston, load or pressure); an
    elastic seal that gives before it slides (Dahl); a load cell with a gain or zero error; a
    pressure that is read late or far from the piston (gauge).

References
    Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7); Beater (2007), Pneumatic
    Drives, Springer.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number, rate_of
from pamid.model.background import RoughMap
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class CylinderBench(Rig):
    """A pneumatic cylinder whose motion is imposed: position and gauge pressure in, force out."""

    inputs = {"position_mm": "m", "pressure_bar": "Pa"}
    outputs = {"force_n": "N"}
    ports = {
        "gauge": Port("reading", "Pa"),
        "piston": Port(
            "motion", "N", {"position": "m", "velocity": "m/s", "pressure": "Pa", "load": "N"}
        ),
        "load_cell": Port("reading", "N"),
    }
    background = {
        "piston": (
            RoughMap("bore", "position", of="load", tolerance=0.02),
            RoughMap("seal_area", "pressure", of="load", positive=True, tolerance=0.02),
        )
    }
    parameters = (
        Parameter.positive("area", 5.0, 0.1, 500.0, "cm2", factor=1.2).with_source(
            "data sheet: bore of 25 mm"
        ),
        Parameter("preload", 0.0, -200.0, 200.0, "N", spread=20.0).with_source(
            "estimate: weight of the rod"
        ),
    )
    noise = {"force_n": 0.5}
    period_s = 0.02
    excited = {"position_mm": 20.0, "pressure_bar": 2.0}
    centre = {"pressure_bar": 4.0}
    ramped = ("position_mm",)

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        position = u.position_mm
        velocity = rate_of(position)
        pressure = port("gauge", u.pressure_bar)
        push = p.area * pressure
        force = port(
            "piston",
            -(push + p.preload),
            position=position,
            velocity=velocity,
            pressure=pressure,
            load=push,
        )
        return {"force_n": port("load_cell", -force)}
