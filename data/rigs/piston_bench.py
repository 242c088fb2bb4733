"""A pneumatic piston on a bench that moves it and reads the force: the motion is imposed.

Equations
    along = offset - area pressure          what acts on the piston but for the motor
    force = -along                          what the motor's load cell reads

Signs, which is all there is to this rig: `position_mm` counts the way in which the motor pushes the
piston into its cylinder, against the air. What acts on the piston that way is the air, minus area
times pressure, and whatever rubs on it, which an effect takes off along the velocity; that sum goes
through the port. The motor holds against all of it, so that the load cell, counted positive where
the air pushes, shows the opposite. Had `area * pressure` itself been passed, the friction of the
seal would have had to drive the piston, and every fit of it would end at zero.

The recorded position has no rate beside it, and friction that depends on speed asks for one: the
state follows the position within a twentieth of a second, and its rate is offered.

References
    Zillen, a 3D-printed pneumatic actuator (CC0): the recordings that it is written for.
"""

from pamid import Parameter, Port, Rig, State


class PistonBench(Rig):
    """Piston with a seal, moved by a motor at a held pressure; the motor's force is read."""

    inputs = {"position_mm": "m", "pressure_bar": "Pa"}
    between = {"position_mm": "linear", "pressure_bar": "linear"}
    outputs = {"force_n": "N"}
    ports = {
        "piston": Port(
            "motion",
            "N",
            {"position": "m", "velocity": "m/s", "load": "N"},
            # a seal rubs with some newtons beside hundreds of the air
            size={"value": 20.0, "velocity": 0.01},
        ),
        "load_cell": Port("reading", "N"),
    }
    states = (State("followed", "m"),)
    parameters = (
        Parameter("area_cm2", 5.0, low=3.0, high=7.0, spread=0.3, source="bore of 25 mm"),
        Parameter("offset_n", 0.0, low=-20.0, high=20.0, spread=5.0, source="zero of the cell"),
        Parameter("follow_ms", 50.0, low=10.0, high=500.0, fitted=False, source="chosen"),
    )
    noise = {"force_n": 0.05}
    period_s = 0.02

    def start(self, p):
        return {"followed": 0.0}

    def rates(self, x, u, p, port):
        return {"followed": (u.position_mm - x.followed) / p.follow_ms}

    def measure(self, x, u, p, port):
        air = p.area_cm2 * u.pressure_bar
        along = port(
            "piston",
            p.offset_n - air,
            position=u.position_mm,
            velocity=(u.position_mm - x.followed) / p.follow_ms,
            load=air,
        )
        return {"force_n": port("load_cell", -along)}
