"""Two tanks one above the other, with the pump's curve and outlets between turbulent and laminar.

Equations, levels in volts of the sensor (the upper tank's counted alike)
    q = max(pump - zero, 0);  inflow = fill q (1 + bend q)
    outflow of a tank = drain sqrt(level + head) + loss level
    d upper / dt = inflow - outflow_upper,  d lower / dt = share outflow_upper - outflow_lower

The loss may be of either sign: sqrt and line together stand for an outflow whose exponent is not
one half.

References
    Schoukens, Noel (2017), Three benchmarks addressing open challenges in nonlinear system
    identification, IFAC-PapersOnLine 50(1), 446-451.
    Rogers, Holmes, Cross, Worden (2017), On a grey box modelling framework for nonlinear system
    identification, Special Topics in Structural Dynamics 6, 167-178.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number, maximum, sqrt

EMPTY_V = 0.01  # below it the outflow turns laminar, and its slope stays finite


def root(level: Number) -> Number:
    above = maximum(level, 0.0)
    return above / sqrt(above + EMPTY_V)


def open_factor(name: str, unit: str = "") -> Parameter:
    return Parameter(name, 0.04, 0.001, 1.0, unit, spread=2.0, log=True, source="bucket and watch")


class TanksWithPipes(Rig):
    """Two tanks in a cascade: the pump's voltage in, the lower level out."""

    inputs = {"pump_v": "V"}
    outputs = {"level_v": "V"}
    ports = {
        "pump": Port("command", "V"),
        "upper": Port("rate", "V/s", {"stored": "V", "downstream": "V"}),
        "lower": Port("rate", "V/s", {"stored": "V", "upstream": "V"}),
        "gauge": Port("reading", "V"),
    }
    states = (State("upper", "V", 5.0), State("lower", "V", 5.0))
    parameters = (
        open_factor("fill", "1/s"),
        open_factor("drain_upper"),
        open_factor("into_lower"),
        open_factor("drain_lower"),
        Parameter("zero_v", 0.0, -2.0, 4.0, "V", spread=0.5, source="volts before water comes"),
        Parameter("bend", 0.0, -0.1, 0.1, spread=0.03, source="a pump's curve"),
        Parameter("head_upper_v", 0.0, -2.0, 50.0, "V", spread=5.0, source="outlet below zero"),
        Parameter("head_lower_v", 0.0, -2.0, 50.0, "V", spread=5.0, source="outlet below zero"),
        Parameter("loss_upper", 0.0, -0.02, 0.03, "1/s", spread=0.003, source="outflow's law"),
        Parameter("loss_lower", 0.0, -0.02, 0.03, "1/s", spread=0.003, source="outflow's law"),
    )
    noise = {"level_v": 0.01}
    period_s = 4.0

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        q = maximum(port("pump", u.pump_v) - p.zero_v, 0.0)
        through, loss = root(x.upper + p.head_upper_v), p.loss_upper * x.upper
        upper = p.fill * q * (1.0 + p.bend * q) - p.drain_upper * through - loss
        lower = p.into_lower * (through + loss / p.drain_upper)
        lower = lower - p.drain_lower * root(x.lower + p.head_lower_v) - p.loss_lower * x.lower
        return {
            "upper": port("upper", upper, stored=x.upper, downstream=x.lower),
            "lower": port("lower", lower, stored=x.lower, upstream=x.upper),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"level_v": port("gauge", x.lower)}
