"""A stage on a linear motor, held by a soft spring."""

from pamid import Parameter, Port, Rig, State


class LinearStage(Rig):
    """Coil current in, position out."""

    inputs = {"coil_a": "A"}
    outputs = {"position_um": "m"}
    ports = {
        "coil": Port("actuator-force", "N", signals=("position", "velocity")),
        "stage": Port("motion", "N", signals=("position", "velocity")),
        "encoder": Port("reading", "m", signals=("rate",)),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass_kg", 0.75, low=0.3, high=2.0, spread=0.1, source="scale"),
        Parameter("force_n_per_a", 10.0, low=4.0, high=25.0, spread=1.5, source="data sheet"),
        Parameter("drag_n_s_per_m", 6.0, low=0.1, high=50.0, spread=1.5, log=True, source="guess"),
        Parameter("spring_n_per_m", 40.0, low=5.0, high=200.0, spread=8.0, source="pulled by hand"),
    )

    def rates(self, x, u, p, port):
        push = p.force_n_per_a * u.coil_a
        push = port("coil", push, position=x.position, velocity=x.velocity)
        force = push - p.drag_n_s_per_m * x.velocity - p.spring_n_per_m * x.position
        force = port("stage", force, position=x.position, velocity=x.velocity)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):
        return {"position_um": port("encoder", x.position, rate=x.velocity)}
