"""A cart with viscous drag, pushed by a force through a drive."""

from pamid import Parameter, Port, Rig, State


class DraggedCart(Rig):
    """A cart with viscous drag, pushed by a force."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "drive": Port("command", "N"),
        "force": Port("motion", "N", signals=("velocity", "position")),
        "sensor": Port("reading", "m"),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass_kg", 1.0, low=0.1, high=10.0, source="kitchen scale", spread=0.2),
        Parameter(
            "drag_n_s_per_m", 2.0, low=0.05, high=50.0, log=True, spread=2.0, source="estimate"
        ),
    )
    noise = {"position_m": 5e-4}

    def rates(self, x, u, p, port):
        force = port("drive", u.force_n) - p.drag_n_s_per_m * x.velocity
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):
        return {"position_m": port("sensor", x.position)}
