"""A pendulum that a motor turns: functions of `pamid.equations` in a rig file.

Python's `math.sin` and `numpy.sin` take numbers. An equation is written once, with symbols, so its
functions come from `pamid.equations`: sin, cos, sqrt, exp, maximum, where and others.
"""

from pamid import Parameter, Port, Rig, State
from pamid.equations import sin


class Pendulum(Rig):
    """A rod on a motor: torque in, angle out, counted from hanging."""

    inputs = {"torque_nm": "N m"}
    outputs = {"angle_deg": "rad"}
    ports = {
        "hinge": Port("motion", "N m", signals=("position", "velocity")),
        "encoder": Port("reading", "rad"),
    }
    states = (State("angle", "rad"), State("speed", "rad/s"))
    parameters = (
        Parameter("mass_kg", 0.5, low=0.1, high=2.0, fitted=False, source="kitchen scale"),
        Parameter("length_m", 0.3, low=0.1, high=1.0, spread=0.02, source="tape measure"),
        Parameter("drag_n_m_s_per_rad", 0.02, low=0.0, high=1.0, spread=0.02, source="guess"),
    )
    noise = {"angle_deg": 0.05}
    excited = {"torque_nm": 0.5}

    def rates(self, x, u, p, port):
        weight = p.mass_kg * 9.81 * p.length_m * sin(x.angle)
        torque = u.torque_nm - weight - p.drag_n_m_s_per_rad * x.speed
        torque = port("hinge", torque, position=x.angle, velocity=x.speed)
        return {"angle": x.speed, "speed": torque / (p.mass_kg * p.length_m * p.length_m)}

    def measure(self, x, u, p, port):
        return {"angle_deg": port("encoder", x.angle)}
