"""A water tank with a pump and an outlet valve."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import maximum, sqrt


class OneTank(Rig):
    """Level of a tank: pumped in, let out by a valve."""

    inputs = {"pump_v": "V", "valve": ""}
    outputs = {"level_cm": "m"}
    ports = {
        "pump": Port("command", "V"),
        "tank": Port("rate", "m/s", signals=("stored",)),
        "gauge": Port("reading", "m"),
    }
    states = (State("level", "m", 0.1),)
    parameters = (
        Parameter("fill", 0.0025, low=0.0005, high=0.01, spread=1.3, log=True, source="bucket"),
        Parameter("outlet", 0.028, low=0.005, high=0.2, spread=1.4, log=True, source="watch"),
    )

    def rates(self, x, u, p, port):
        pump = port("pump", u.pump_v)
        level = maximum(x.level, 0.0)
        rate = p.fill * pump - p.outlet * u.valve * level / sqrt(level + 1e-4)
        return {"level": port("tank", rate, stored=x.level)}

    def measure(self, x, u, p, port):
        return {"level_cm": port("gauge", x.level)}
