"""A pendulum with a propeller at its end."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import sin


class Propeller(Rig):
    """Duty of the propeller in (-1 .. 1), angle of the pendulum out."""

    inputs = {"duty": ""}
    outputs = {"angle_deg": "rad"}
    ports = {
        "duty": Port("command", ""),
        "pivot": Port("motion", "N m", signals=("position", "velocity")),
        "encoder": Port("reading", "rad", signals=("rate",)),
    }
    states = (State("angle", "rad"), State("speed", "rad/s"), State("blown"))
    parameters = (
        Parameter("thrust_n_m", 0.5, low=0.1, high=2.0, spread=0.1, source="bench"),
        Parameter("weight_n_m", 0.9, low=0.3, high=2.0, spread=0.08, source="scale and ruler"),
        Parameter("inertia_kg_m2", 0.02, low=0.005, high=0.1, spread=0.004, source="drawing"),
        Parameter(
            "bearing_n_m_s_per_rad", 0.006, low=1e-4, high=0.1, spread=2.0, log=True, source="guess"
        ),
        Parameter("spin_up_ms", 80.0, low=10.0, high=500.0, spread=1.5, log=True, source="guess"),
    )

    def rates(self, x, u, p, port):
        torque = p.thrust_n_m * x.blown - p.weight_n_m * sin(x.angle)
        torque = torque - p.bearing_n_m_s_per_rad * x.speed
        torque = port("pivot", torque, position=x.angle, velocity=x.speed)
        return {
            "angle": x.speed,
            "speed": torque / p.inertia_kg_m2,
            "blown": (port("duty", u.duty) - x.blown) / p.spin_up_ms,
        }

    def measure(self, x, u, p, port):
        return {"angle_deg": port("encoder", x.angle, rate=x.speed)}
