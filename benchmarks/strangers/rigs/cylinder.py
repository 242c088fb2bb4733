"""A hydraulic cylinder behind a proportional valve, its position read."""

from pamid import Parameter, Port, Rig, State


class Cylinder(Rig):
    """Valve command in, position of the rod out."""

    inputs = {"valve_percent": ""}
    outputs = {"position_mm": "m"}
    ports = {
        "valve": Port("command", ""),
        "flow": Port("rate", "m/s", signals=("stored",)),
        "scale": Port("reading", "m", signals=("rate",)),
    }
    states = (State("opening"), State("position", "m", 0.15))
    parameters = (
        Parameter(
            "speed_m_per_s", 0.4, low=0.05, high=2.0, spread=1.5, log=True, source="stopwatch"
        ),
        Parameter("valve_ms", 20.0, low=2.0, high=200.0, spread=2.0, log=True, source="data sheet"),
        Parameter("zero_percent", 0.0, low=-5.0, high=5.0, spread=1.0, source="adjusted"),
    )

    def rates(self, x, u, p, port):
        command = port("valve", u.valve_percent - p.zero_percent)
        speed = port("flow", p.speed_m_per_s * x.opening, stored=x.position)
        return {"opening": (command - x.opening) / p.valve_ms, "position": speed}

    def measure(self, x, u, p, port):
        return {"position_mm": port("scale", x.position, rate=p.speed_m_per_s * x.opening)}
