"""A tank that a pump fills and a short pipe drains: a rig as a user would write it."""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import maximum, sqrt


class Tank(Rig):
    """Level in an open tank; pump rate is the command."""

    inputs = {"command": ""}
    outputs = {"level_m": "m"}
    ports = {
        "pump": Port("command", ""),
        "balance": Port("rate", "m/s", {"stored": "m"}),
        "gauge": Port("reading", "m"),
    }
    states = (State("level", "m", 0.4),)
    parameters = (
        Parameter("fill", 0.05, 0.01, 0.2, "m/s", spread=0.01, source="pump curve"),
        Parameter("drain", 0.03, 0.005, 0.1, spread=0.006, source="pipe, m^0.5/s"),
    )
    noise = {"level_m": 5e-4}
    period_s = 0.05

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        flow = p.fill * port("pump", u.command) - p.drain * sqrt(maximum(x.level, 1e-4))
        return {"level": port("balance", flow, stored=x.level)}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        return {"level_m": port("gauge", x.level)}
