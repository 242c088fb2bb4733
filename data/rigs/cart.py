"""The smallest whole rig: a cart on a rail, pushed by a measured force.

Copy it to begin your rig.
"""

from pamid import Parameter, Port, Rig, State


class Cart(Rig):
    """My cart on its rail."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "force": Port("motion", "N", signals=("velocity", "position")),
        "sensor": Port("reading", "m"),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (Parameter("mass_kg", 1.0, low=0.1, high=10.0, source="kitchen scale"),)

    def rates(self, x, u, p, port):
        force = port("force", u.force_n, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):
        return {"position_m": port("sensor", x.position)}
