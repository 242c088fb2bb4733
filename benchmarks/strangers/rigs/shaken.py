"""A mass on springs, driven by a shaker."""

from pamid import Parameter, Port, Rig, State


class Shaken(Rig):
    """Measured force in, position out."""

    inputs = {"force_n": "N"}
    between = {"force_n": "linear"}
    outputs = {"position_mm": "m"}
    ports = {
        "mass": Port("motion", "N", signals=("velocity", "position")),
        "sensor": Port("reading", "m", signals=("rate",)),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass_kg", 1.0, low=0.3, high=3.0, spread=0.1, source="kitchen scale"),
        Parameter("spring_n_per_mm", 10.0, low=3.0, high=30.0, spread=2.0, source="catalogue"),
        Parameter(
            "damping_n_s_per_m", 15.0, low=1.0, high=200.0, spread=2.0, log=True, source="guess"
        ),
    )

    def rates(self, x, u, p, port):
        force = u.force_n - p.spring_n_per_mm * x.position - p.damping_n_s_per_m * x.velocity
        force = port("mass", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):
        return {"position_mm": port("sensor", x.position, rate=x.velocity)}
