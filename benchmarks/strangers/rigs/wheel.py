"""A dc motor that turns a wheel; speed and current are read."""

from pamid import Parameter, Port, Rig, State


class Wheel(Rig):
    """Supply voltage in, speed and current out."""

    inputs = {"supply_v": "V"}
    outputs = {"speed_rpm": "rad/s", "current_a": "A"}
    ports = {
        "supply": Port("command", "V"),
        "shaft": Port("motion", "N m", signals=("position", "velocity")),
        "tacho": Port("reading", "rad/s"),
        "shunt": Port("reading", "A"),
    }
    states = (State("angle", "rad"), State("speed", "rad/s"), State("current", "A"))
    parameters = (
        Parameter("resistance_ohm", 1.6, low=0.5, high=5.0, spread=0.3, source="ohmmeter"),
        Parameter(
            "inductance_h", 1.4e-3, low=1e-4, high=1e-2, spread=1.5, log=True, source="sheet"
        ),
        Parameter("constant_n_m_per_a", 0.046, low=0.01, high=0.2, spread=0.006, source="sheet"),
        Parameter(
            "inertia_kg_m2", 1.2e-4, low=2e-5, high=1e-3, spread=1.4, log=True, source="sheet"
        ),
        Parameter(
            "drag_n_m_s_per_rad", 8e-5, low=1e-6, high=1e-3, spread=2.0, log=True, source="guess"
        ),
    )

    def rates(self, x, u, p, port):
        supply = port("supply", u.supply_v)
        torque = p.constant_n_m_per_a * x.current - p.drag_n_m_s_per_rad * x.speed
        torque = port("shaft", torque, position=x.angle, velocity=x.speed)
        back = p.constant_n_m_per_a * x.speed
        return {
            "angle": x.speed,
            "speed": torque / p.inertia_kg_m2,
            "current": (supply - p.resistance_ohm * x.current - back) / p.inductance_h,
        }

    def measure(self, x, u, p, port):
        return {"speed_rpm": port("tacho", x.speed), "current_a": port("shunt", x.current)}
