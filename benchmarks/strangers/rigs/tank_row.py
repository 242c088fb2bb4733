"""Two water tanks, one emptying into the other, both levels read."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import maximum, sqrt


def root(level):
    above = maximum(level, 0.0)
    return above / sqrt(above + 1e-4)


class TankRow(Rig):
    """Pump, upper tank, lower tank."""

    inputs = {"pump_v": "V"}
    outputs = {"upper_cm": "m", "lower_cm": "m"}
    ports = {
        "pump": Port("command", "V"),
        "upper": Port("rate", "m/s", signals=("stored", "downstream")),
        "lower": Port("rate", "m/s", signals=("stored", "upstream")),
        "upper_gauge": Port("reading", "m"),
        "lower_gauge": Port("reading", "m"),
    }
    states = (State("upper", "m", 0.1), State("lower", "m", 0.1))
    parameters = (
        Parameter("fill", 0.00095, low=1e-4, high=0.01, spread=1.4, log=True, source="bucket"),
        Parameter("upper_hole", 0.0085, low=1e-3, high=0.1, spread=1.4, log=True, source="watch"),
        Parameter("lower_hole", 0.0115, low=1e-3, high=0.1, spread=1.4, log=True, source="watch"),
    )

    def rates(self, x, u, p, port):
        pumped = p.fill * port("pump", u.pump_v)
        through = p.upper_hole * root(x.upper)
        upper = port("upper", pumped - through, stored=x.upper, downstream=x.lower)
        lower = through - p.lower_hole * root(x.lower)
        return {"upper": upper, "lower": port("lower", lower, stored=x.lower, upstream=x.upper)}

    def measure(self, x, u, p, port):
        return {
            "upper_cm": port("upper_gauge", x.upper),
            "lower_cm": port("lower_gauge", x.lower),
        }
