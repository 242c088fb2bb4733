"""A tank that a pump fills and a hole empties.

What it is
    A pump feeds a tank, a boiler or a sump, which runs out through a hole, a pipe or a valve in a
    fixed position. The voltage of the pump is sent, the level is measured.

Equations
    A dh/dt = gain voltage - hole sqrt(2 g h)

Typically missing
    A tank that spills over its rim, a leak, losses of a pipe besides those of the orifice (tank); a
    pump that starts above a threshold voltage, saturates or lags (pump), or gives less the higher
    the level (inlet); a gauge with a zero, a gain, steps or waves (gauge).

References
    Astrom, Murray (2008), Feedback Systems, Princeton University Press; Johansson (2000), The
    quadruple-tank process, IEEE Trans. Control Systems Technology 8(3), 456-465.
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


class PumpTank(Rig):
    """A tank with a pump and an outlet: voltage of the pump in, level out."""

    inputs = {"pump_v": "V"}
    outputs = {"level_cm": "m"}
    ports = {
        "pump": Port("command", "V"),
        "inlet": Port("flow", "m3/s", {"level": "m"}),
        "tank": Port("rate", "m/s", {"stored": "m", "inflow": "m/s", "loss": "m/s"}),
        "gauge": Port("reading", "m", {"rate": "m/s"}),
    }
    background = {
        "pump": RoughMap("pump_curve", positive=True, tolerance=0.02),
        "tank": RoughMap("outlet", "stored", of="loss", positive=True, tolerance=0.02),
    }
    states = (State("level", "m", 0.05),)
    parameters = (
        Parameter.positive("gain", 10.0, 0.1, 1e3, "cm3/(s V)", factor=1.3).with_source(
            "bucket and clock: flow of the pump over its voltage"
        ),
        Parameter.positive("area", 50.0, 1.0, 1e6, "cm2", factor=1.1).with_source("ruler, A"),
        Parameter.positive("hole", 0.2, 0.001, 100.0, "cm2", factor=1.4).with_source("drill"),
    )
    noise = {"level_cm": 0.05}
    period_s = 2.0
    excited = {"pump_v": 1.5}
    centre = {"pump_v": 3.0}
    hold_s = (20.0, 120.0)

    def change(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Rate of the level, m/s."""
        inflow = port("inlet", p.gain * port("pump", u.pump_v), level=x.level) / p.area
        above = maximum(x.level, 0.0)
        # Torricelli
        loss = p.hole * (2.0 * GRAVITY) ** 0.5 * above / sqrt(above + EMPTY_M) / p.area
        return port(  # type: ignore[no-any-return]
            "tank", inflow - loss, stored=x.level, inflow=inflow, loss=loss
        )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"level": self.change(x, u, p, port)}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"level_cm": port("gauge", x.level, rate=self.change(x, u, p, port))}
