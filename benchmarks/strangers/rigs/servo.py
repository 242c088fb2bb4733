"""A geared servo that lifts a pendulum."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import absolute, sin


class Servo(Rig):
    """Motor voltage in, angle of the pendulum out (0 hangs)."""

    inputs = {"motor_v": "V"}
    outputs = {"angle_deg": "rad"}
    ports = {
        "motor": Port("actuator-force", "N m", signals=("position", "velocity")),
        "joint": Port("motion", "N m", signals=("position", "velocity", "load")),
        "encoder": Port("reading", "rad", signals=("rate",)),
    }
    states = (State("angle", "rad"), State("speed", "rad/s"))
    parameters = (
        Parameter("torque_n_m_per_v", 0.40, low=0.1, high=1.0, spread=0.06, source="data sheet"),
        Parameter("back_n_m_s_per_rad", 0.26, low=0.05, high=1.5, spread=0.08, source="data sheet"),
        Parameter("weight_n_m", 1.85, low=1.0, high=3.0, spread=0.1, source="scale and ruler"),
        Parameter("inertia_kg_m2", 0.04, low=0.01, high=0.2, spread=0.012, source="estimate"),
    )

    def rates(self, x, u, p, port):
        torque = p.torque_n_m_per_v * u.motor_v - p.back_n_m_s_per_rad * x.speed
        torque = port("motor", torque, position=x.angle, velocity=x.speed)
        left = torque - p.weight_n_m * sin(x.angle)
        left = port("joint", left, position=x.angle, velocity=x.speed, load=absolute(torque))
        return {"angle": x.speed, "speed": left / p.inertia_kg_m2}

    def measure(self, x, u, p, port):
        return {"angle_deg": port("encoder", x.angle, rate=x.speed)}
