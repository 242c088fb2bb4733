"""A motor that turns a wheel by a coupling; both angles are read."""

from pamid import Parameter, Port, Rig, State


class Link(Rig):
    """Motor torque in, angles of motor and wheel out."""

    inputs = {"torque_n_m": "N m"}
    outputs = {"motor_deg": "rad", "wheel_deg": "rad"}
    ports = {
        "motor": Port("motion", "N m", signals=("position", "velocity")),
        "coupling": Port("transmission", "N m", signals=("position", "stretch")),
        "wheel": Port("motion", "N m", signals=("position", "velocity")),
        "motor_encoder": Port("reading", "rad", signals=("rate",)),
        "wheel_encoder": Port("reading", "rad", signals=("rate",)),
    }
    states = (
        State("motor", "rad"),
        State("motor_rate", "rad/s"),
        State("wheel", "rad"),
        State("wheel_rate", "rad/s"),
    )
    parameters = (
        Parameter("motor_kg_m2", 0.005, low=0.001, high=0.03, spread=0.0012, source="sheet"),
        Parameter("wheel_kg_m2", 0.013, low=0.003, high=0.05, spread=0.002, source="drawing"),
        Parameter(
            "spring_n_m_per_rad", 20.0, low=4.0, high=100.0, spread=1.4, log=True, source="sheet"
        ),
        Parameter(
            "coupling_n_m_s_per_rad", 0.03, low=1e-3, high=1.0, spread=2.0, log=True, source="guess"
        ),
        Parameter(
            "motor_n_m_s_per_rad", 0.03, low=1e-3, high=0.3, spread=2.0, log=True, source="guess"
        ),
        Parameter(
            "wheel_n_m_s_per_rad", 0.007, low=1e-3, high=0.3, spread=2.0, log=True, source="guess"
        ),
    )

    def rates(self, x, u, p, port):
        twist, rate = x.motor - x.wheel, x.motor_rate - x.wheel_rate
        shaft = p.spring_n_m_per_rad * twist + p.coupling_n_m_s_per_rad * rate
        shaft = port("coupling", shaft, position=x.wheel, stretch=twist)
        motor = u.torque_n_m - shaft - p.motor_n_m_s_per_rad * x.motor_rate
        wheel = shaft - p.wheel_n_m_s_per_rad * x.wheel_rate
        motor = port("motor", motor, position=x.motor, velocity=x.motor_rate)
        wheel = port("wheel", wheel, position=x.wheel, velocity=x.wheel_rate)
        return {
            "motor": x.motor_rate,
            "motor_rate": motor / p.motor_kg_m2,
            "wheel": x.wheel_rate,
            "wheel_rate": wheel / p.wheel_kg_m2,
        }

    def measure(self, x, u, p, port):
        return {
            "motor_deg": port("motor_encoder", x.motor, rate=x.motor_rate),
            "wheel_deg": port("wheel_encoder", x.wheel, rate=x.wheel_rate),
        }
