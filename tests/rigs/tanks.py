"""Two tanks side by side, each filled by its own pump and drained by its own outlet."""

from pamid.engine.symbolic.vocabulary import maximum, sqrt
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

BOTH = ("1", "2")


class Tanks(Rig):
    """Command to level, twice; the gauge counts from the level at the start."""

    inputs = {"command_1": "", "command_2": ""}
    outputs = {"level_1_m": "m", "level_2_m": "m"}
    ports = {
        "pump": Port("command", "", (), BOTH, size={"value": 1.0}),
        "valve": Port("flow", "m3/s", {"side": ""}, BOTH, size={"value": 1e-3}),
        "store": Port("rate", "m/s", {"stored": "m"}, BOTH, size={"value": 0.1, "stored": 0.5}),
        "gauge": Port("reading", "m", {"rate": "m/s"}, BOTH, size={"value": 0.1, "rate": 0.1}),
    }
    states = tuple(State(f"level_{i}", "m", 0.2) for i in BOTH)
    parameters = (
        Parameter("area", 0.01, 0.001, 0.1, "m2", source="ruler"),
        Parameter("full_flow", 1e-3, 1e-4, 1e-2, "m3/s", source="bucket and clock"),
        Parameter("outlet", 4e-4, 1e-5, 1e-2, source="run-out, m3/s at 1 m"),
    )
    period_s = 0.01

    def _rate(self, i, x, u, p, port):
        level = getattr(x, f"level_{i}")
        command = port("pump", getattr(u, f"command_{i}"), place=i)
        flow = port("valve", p.full_flow * command, place=i, side=1.0 if i == "1" else -1.0)
        above = maximum(level, 0.0)
        change = (flow - p.outlet * above / sqrt(above + 0.01)) / p.area
        return port("store", change, place=i, stored=level)

    def rates(self, x, u, p, port):
        return {f"level_{i}": self._rate(i, x, u, p, port) for i in BOTH}

    def measure(self, x, u, p, port):
        rates = {i: self._rate(i, x, u, p, port) for i in BOTH}
        return {
            f"level_{i}_m": port("gauge", getattr(x, f"level_{i}") - 0.2, place=i, rate=rates[i])
            for i in BOTH
        }
