"""Two tanks one above the other: a pump fills the upper one, which runs out into the lower one.

Equations, levels in volts of the sensor (the upper tank's counted alike)
    d upper / dt = fill (pump - offset) - drain_upper sqrt(upper)
    d lower / dt = into_lower sqrt(upper) - drain_lower sqrt(lower)

Written as somebody would who knows the two tanks and nothing of the benchmark: the priors are
within a factor of two of what a bucket and a watch tell, a pump lifts nothing below some volts, and
the start of the upper tank is open.

References
    Schoukens, Noel (2017), Three benchmarks addressing open challenges in nonlinear system
    identification, IFAC-PapersOnLine 50(1), 446-451.
"""

from __future__ import annotations

from typing import Any

from pamid import Parameter, Port, Rig, State
from pamid.equations import Number, maximum, sqrt

EMPTY_V = 0.01  # below it the outflow turns laminar, and its slope stays finite


def root(level: Number) -> Number:
    above = maximum(level, 0.0)
    return above / sqrt(above + EMPTY_V)


class Tanks(Rig):
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
        Parameter("fill", 0.03, 0.001, 1.0, "1/s", spread=2.0, log=True, source="bucket and watch"),
        Parameter("drain_upper", 0.04, 0.001, 1.0, spread=2.0, log=True, source="the same"),
        Parameter("into_lower", 0.04, 0.001, 1.0, spread=2.0, log=True, source="the same"),
        Parameter("drain_lower", 0.04, 0.001, 1.0, spread=2.0, log=True, source="the same"),
        Parameter("offset_v", 0.0, -3.0, 3.0, "V", spread=1.0, source="pumps have a threshold"),
    )
    noise = {"level_v": 0.01}
    period_s = 4.0

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        pump = port("pump", u.pump_v - p.offset_v)
        through = root(x.upper)
        upper = p.fill * pump - p.drain_upper * through
        lower = p.into_lower * through - p.drain_lower * root(x.lower)
        return {
            "upper": port("upper", upper, stored=x.upper, downstream=x.lower),
            "lower": port("lower", lower, stored=x.lower, upstream=x.upper),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"level_v": port("gauge", x.lower)}
