"""A fluidic muscle on a bench: held at a length, fed a pressure, its force read by a load cell.

Equations
    pull = k nominal p/6 bar ((1 - k contraction)^2 - (1 - stroke)^2) / (1 - (1 - stroke)^2),
           k = length/(length + ends)
    d force/dt = (max(pull, least) - force) / lag

The ideal braid law, a cylinder of inextensible threads and no bladder: pi/4 D^2 p (3 (1 -
contraction)^2/tan(a)^2 - 1/sin(a)^2) with bore D and braid angle a, written with the two figures a
data sheet gives instead: the force at rest length and 6 bar, and the stroke at which the braid
stands at 54.7 deg and pulls no more, cos(a) sqrt(3) (1 - stroke) = 1. What the bladder takes is
left for the diagnosis to find.

`contraction` is the shortening over the length at rest, held on a bench and so allowed to be
constant; without the column the muscle stands at rest length. `length` is that length, `least` the
smallest force the load cell shows (0 for a chart, which leaves a slack muscle out); a recording
says its own in [known].

References
    Chou, Hannaford (1996), IEEE Trans. Robotics and Automation 12(1), 90-102; Tondu, Lopez (2000),
    IEEE Control Systems Magazine 20(2), 15-38.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, SmoothGain, State
from pamid.equations import Expr, Number, maximum

NOMINAL_PA = 6e5


class MuscleBench(Rig):
    """Isometric muscle bench: pressure and length in, force out, after the ideal braid law."""

    inputs = {"pressure_kpa": "Pa", "contraction": ""}
    optional = {"contraction": 0.0}
    outputs = {"force_n": "N"}
    ports = {
        "muscle": Port(
            "actuator-force",
            "N",
            {"position": "", "pressure": "Pa", "law": ""},
            called={"position": "contraction"},
        ),
        "load_cell": Port("reading", "N"),
    }
    states = (State("force", "N"),)
    parameters = (
        Parameter(
            "nominal",
            1000.0,
            50.0,
            8000.0,
            "N",
            spread=1.6,
            log=True,
            source="data sheets at 6 bar: 630 N for a bore of 10 mm, 1500 N for 20 mm",
        ),
        Parameter(
            "stroke",
            0.25,
            0.05,
            0.42,
            spread=0.05,
            source="data sheets: at most 25 %; 42 % is a braid along the axis",
        ),
        Parameter(
            "ends",
            20.0,
            0.0,
            200.0,
            "mm",
            spread=20.0,
            source="estimate: one or two bores at each fitting",
        ),
        Parameter("length", 0.25, 0.01, 10.0, "m", fitted=False, source="tape measure, at rest"),
        Parameter(
            "lag",
            5.0,
            1.0,
            50.0,
            "ms",
            fitted=False,
            source="estimate: load cell with its amplifier",
        ),
        Parameter(
            "least",
            0.0,
            -1e3,
            1e3,
            "N",
            fitted=False,
            source="read off: force shown by a slack muscle",
        ),
    )
    background = {"muscle": SmoothGain("force_map", ("position", 0.0, 0.25), tolerance=0.03)}
    noise = {"force_n": 0.8}
    period_s = 0.01

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        share = p.length / (p.length + p.ends)
        neutral = (1.0 - p.stroke) * (1.0 - p.stroke)

        def law(contraction: Expr, pressure: Expr) -> Expr:
            long = 1.0 - contraction
            return (
                share
                * p.nominal
                * pressure
                * (long * long - neutral)
                / (NOMINAL_PA * (1.0 - neutral))
            )

        contraction = share * u.contraction
        pull = port(
            "muscle",
            law(contraction, u.pressure_kpa),
            position=contraction,
            pressure=u.pressure_kpa,
            law=law,
        )
        return {"force": (maximum(pull, p.least) - x.force) / p.lag}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"force_n": port("load_cell", x.force)}
