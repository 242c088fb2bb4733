"""Two tanks, stacked.

What it is
    A pump fills the upper tank, which runs out through a hole into the lower tank, and that into
    the basin. The level of the lower tank is measured, that of the upper tank where there is a
    sensor.

Equations
    upper    A1 dh1/dt = gain voltage - hole1 sqrt(2 g h1)
    lower    A2 dh2/dt = hole1 sqrt(2 g h1) - hole2 sqrt(2 g h2)

Typically missing
    A tank that spills over its rim, the upper tank partly into the lower (upper, lower); losses of
    pipe and hole besides those of the orifice, a leak (upper, lower); a pump that starts above a
    threshold voltage, saturates or lags (pump); a level sensor with a zero, a gain or waves.

References
    Schoukens, Mattson, Wigren, Noel (2016), Cascaded tanks benchmark combining soft and hard
    nonlinearities, Workshop on Nonlinear System Identification Benchmarks, Brussels.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, maximum, sqrt
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

GRAVITY = 9.81
EMPTY_M = 1e-4  # below it the outflow turns laminar, and its slope stays finite


def outflow(hole: Expr, level: Expr) -> Expr:
    """Torricelli's flow through a hole at this level, m3/s."""
    above = maximum(level, 0.0)
    return hole * (2.0 * GRAVITY) ** 0.5 * above / sqrt(above + EMPTY_M)


class CascadedTanks(Rig):
    """Two tanks in a cascade: voltage of the pump in, levels out."""

    inputs = {"pump_v": "V"}
    outputs = {"level_cm": "m", "upper_level_cm": "m"}
    ports = {
        "pump": Port("command", "V"),
        "inlet": Port("flow", "m3/s", {"level": "m"}),
        "pipe": Port("flow", "m3/s", {"level": "m"}),
        "upper": Port("rate", "m/s", {"stored": "m", "inflow": "m/s", "downstream": "m"}),
        "lower": Port("rate", "m/s", {"stored": "m", "inflow": "m/s", "upstream": "m"}),
        "gauge": Port("reading", "m", {"rate": "m/s"}),
        "upper_gauge": Port("reading", "m", {"rate": "m/s"}),
    }
    background = {
        "pump": RoughMap("pump_curve", positive=True, tolerance=0.02),
        "pipe": RoughMap("upper_outlet", "level", positive=True, tolerance=0.02),
        "lower": RoughMap("lower_outlet", "stored", of="inflow", positive=True, tolerance=0.02),
    }
    states = (State("upper", "m", 0.05), State("lower", "m", 0.05))
    parameters = (
        Parameter.positive("gain", 10.0, 0.1, 1e3, "cm3/(s V)", factor=1.3).with_source(
            "bucket and clock: flow of the pump over its voltage"
        ),
        Parameter.positive("upper_area", 50.0, 1.0, 1e4, "cm2", factor=1.1).with_source(
            "ruler, A1"
        ),
        Parameter.positive("lower_area", 50.0, 1.0, 1e4, "cm2", factor=1.1).with_source(
            "ruler, A2"
        ),
        Parameter.positive("upper_hole", 0.2, 0.001, 50.0, "cm2", factor=1.4).with_source(
            "drill, hole1"
        ),
        Parameter.positive("lower_hole", 0.2, 0.001, 50.0, "cm2", factor=1.4).with_source(
            "drill, hole2"
        ),
    )
    noise = {"level_cm": 0.05, "upper_level_cm": 0.05}
    period_s = 2.0
    excited = {"pump_v": 1.5}
    centre = {"pump_v": 3.0}
    hold_s = (20.0, 120.0)

    def pipe_flow(self, x: Any, p: Any, port: Any) -> Expr:
        """Flow from the upper tank to the lower tank, m3/s."""
        return port("pipe", outflow(p.upper_hole, x.upper), level=x.upper)  # type: ignore[no-any-return]

    def upper_change(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Rate of the upper level, m/s."""
        filling = port("inlet", p.gain * port("pump", u.pump_v), level=x.upper)
        return port(  # type: ignore[no-any-return]
            "upper",
            (filling - self.pipe_flow(x, p, port)) / p.upper_area,
            stored=x.upper,
            inflow=filling / p.upper_area,
            downstream=x.lower,
        )

    def lower_change(self, x: Any, p: Any, port: Any) -> Expr:
        """Rate of the lower level, m/s."""
        filling = self.pipe_flow(x, p, port)
        return port(  # type: ignore[no-any-return]
            "lower",
            (filling - outflow(p.lower_hole, x.lower)) / p.lower_area,
            stored=x.lower,
            inflow=filling / p.lower_area,
            upstream=x.upper,
        )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"upper": self.upper_change(x, u, p, port), "lower": self.lower_change(x, p, port)}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "level_cm": port("gauge", x.lower, rate=self.lower_change(x, p, port)),
            "upper_level_cm": port("upper_gauge", x.upper, rate=self.upper_change(x, u, p, port)),
        }
