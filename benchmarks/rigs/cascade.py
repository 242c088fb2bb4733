"""Two tanks, one above the other: a pump fills the upper one, which drains into the lower one."""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import maximum, sqrt


class Cascade(Rig):
    """Levels of two tanks; pump rate is the command. The ports offer what spills goes through."""

    inputs = {"command": ""}
    outputs = {"upper_m": "m", "lower_m": "m"}
    ports = {
        "upper": Port("rate", "m/s", {"stored": "m", "downstream": "m"}),
        "lower": Port("rate", "m/s", {"stored": "m", "upstream": "m"}),
    }
    states = (State("upper", "m", 0.4), State("lower", "m", 0.4))
    parameters = (
        Parameter("fill", 0.05, 0.01, 0.2, "m/s", spread=0.01, source="pump curve"),
        Parameter("through", 0.03, 0.005, 0.1, spread=0.006, source="pipe, m^0.5/s"),
        Parameter("drain", 0.03, 0.005, 0.1, spread=0.006, source="pipe, m^0.5/s"),
    )
    noise = {"upper_m": 5e-4, "lower_m": 5e-4}
    period_s = 0.05

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        through = p.through * sqrt(maximum(x.upper, 1e-4))
        drain = p.drain * sqrt(maximum(x.lower, 1e-4))
        return {
            "upper": port(
                "upper", p.fill * u.command - through, stored=x.upper, downstream=x.lower
            ),
            "lower": port("lower", through - drain, stored=x.lower, upstream=x.upper),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        return {"upper_m": x.upper, "lower_m": x.lower}
