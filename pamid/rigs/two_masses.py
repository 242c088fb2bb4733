"""Two masses on a spring.

What it is
    Two carriages on a rail: the first is pushed by a drive and held to the frame by a soft spring,
    the second hangs on it by another spring. Anything in which a load swings behind its drive: a
    machine axis, a robot's elastic joint, a building on a shaker.

Equations
    first    m1 dv1/dt = force - k0 x1 - b1 v1 + k (x2 - x1) + c (v2 - v1)
    second   m2 dv2/dt = - b2 v2 - k (x2 - x1) - c (v2 - v1)

Typically missing
    Dry friction of either guide or of both (carriage_1, carriage_2); a spring that hardens or
    softens (spring); play between the masses (coupling); an end stop; dead time of the drive.

References
    Wie, Bernstein (1992), Benchmark problems for robust control design, J. Guidance, Control, and
    Dynamics 15(5), 1057-1059; Spong (1987), J. Dyn. Syst. Meas. Control 109(4), 310-319.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

GRAVITY = 9.81
CARRIAGE = {"position": "m", "velocity": "m/s", "load": "N"}


class TwoMasses(Rig):
    """Two carriages coupled by a spring: force on the first in, both positions out."""

    inputs = {"force_n": "N"}
    outputs = {"position_1_mm": "m", "position_2_mm": "m"}
    ports = {
        "drive": Port("command", "N"),
        "spring": Port("motion", "N", {"position": "m", "velocity": "m/s"}),
        "coupling": Port("transmission", "N", {"stretch": "m"}),
        "carriage_1": Port("motion", "N", CARRIAGE, kin="carriage"),
        "carriage_2": Port("motion", "N", CARRIAGE, kin="carriage"),
        "ruler_1": Port("reading", "m", {"rate": "m/s"}),
        "ruler_2": Port("reading", "m", {"rate": "m/s"}),
    }
    background = {
        "spring": RoughMap("spring_curve", "position", tolerance=0.02),
        "carriage_1": RoughMap("rail_1", "position", of="load", tolerance=0.02),
        "carriage_2": RoughMap("rail_2", "position", of="load", tolerance=0.02),
    }
    states = (
        State("position_1", "m"),
        State("velocity_1", "m/s"),
        State("position_2", "m"),
        State("velocity_2", "m/s"),
    )
    parameters = (
        Parameter.positive("mass_1", 2.0, 0.01, 1e3, "kg", factor=1.2).with_source("kitchen scale"),
        Parameter.positive("mass_2", 1.5, 0.01, 1e3, "kg", factor=1.2).with_source("kitchen scale"),
        Parameter.positive("stiffness", 800.0, 1.0, 1e6, "N/m", factor=1.3).with_source(
            "data sheet, k"
        ),
        Parameter("frame_stiffness", 200.0, 0.0, 1e5, "N/m", spread=100.0).with_source(
            "data sheet, k0"
        ),
        Parameter("coupling_damping", 2.0, 0.0, 500.0, "N s/m", spread=2.0).with_source(
            "estimate, c"
        ),
        Parameter("viscous_1", 5.0, 0.0, 500.0, "N s/m", spread=5.0).with_source("estimate, b1"),
        Parameter("viscous_2", 3.0, 0.0, 500.0, "N s/m", spread=3.0).with_source("estimate, b2"),
    )
    noise = {"position_1_mm": 0.05, "position_2_mm": 0.05}
    period_s = 0.005
    excited = {"force_n": 15.0}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        stretch, rate = x.position_2 - x.position_1, x.velocity_2 - x.velocity_1
        # on the second mass, along the stretch; the first mass feels the opposite
        pull = -p.stiffness * stretch - p.coupling_damping * rate
        pull = port("spring", pull, position=stretch, velocity=rate)
        pull = port("coupling", pull, stretch=stretch)
        first = port("drive", u.force_n) - p.frame_stiffness * x.position_1
        first = port(
            "carriage_1",
            first - p.viscous_1 * x.velocity_1 - pull,
            position=x.position_1,
            velocity=x.velocity_1,
            load=GRAVITY * p.mass_1,
        )
        second = port(
            "carriage_2",
            pull - p.viscous_2 * x.velocity_2,
            position=x.position_2,
            velocity=x.velocity_2,
            load=GRAVITY * p.mass_2,
        )
        return {
            "position_1": x.velocity_1,
            "velocity_1": first / p.mass_1,
            "position_2": x.velocity_2,
            "velocity_2": second / p.mass_2,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "position_1_mm": port("ruler_1", x.position_1, rate=x.velocity_1),
            "position_2_mm": port("ruler_2", x.position_2, rate=x.velocity_2),
        }
