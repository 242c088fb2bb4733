"""Two tanks, one above the other: the upper one drains and spills into the lower one."""

from pamid.engine.symbolic.vocabulary import maximum, sqrt
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class Cascade(Rig):
    """Pump to both levels, with the ports that what spills goes through."""

    inputs = {"pump": ""}
    outputs = {"upper_m": "m", "lower_m": "m"}
    ports = {
        "lower": Port(
            "rate", "m/s", {"stored": "m", "upstream": "m"}, size={"value": 0.2, "stored": 0.5}
        ),
        "upper": Port(
            "rate", "m/s", {"stored": "m", "downstream": "m"}, size={"value": 0.2, "stored": 0.5}
        ),
    }
    states = (State("upper", "m", 0.3), State("lower", "m", 0.2))
    parameters = (
        Parameter("fill", 0.3, 0.1, 1.0, "m/s", source="bucket and clock"),
        Parameter("upper_drain", 0.15, 0.05, 0.5, source="run-out, m/s at 1 m"),
        Parameter("lower_drain", 0.1, 0.05, 0.5, source="run-out, m/s at 1 m"),
    )
    period_s = 0.01

    def rates(self, x, u, p, port):
        def root(level):
            above = maximum(level, 0.0)
            return above / sqrt(above + 0.01)

        through = p.upper_drain * root(x.upper)
        upper = port(
            "upper", p.fill * maximum(u.pump, 0.0) - through, stored=x.upper, downstream=x.lower
        )
        lower = port(
            "lower", through - p.lower_drain * root(x.lower), stored=x.lower, upstream=x.upper
        )
        return {"upper": upper, "lower": lower}

    def measure(self, x, u, p, port):
        return {"upper_m": x.upper, "lower_m": x.lower}
