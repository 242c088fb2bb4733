"""A block that is heated and cools to its surroundings.

What it is
    A metal block, a hot end, an oven or a battery pack: a heater of known power, a temperature
    sensor, and losses to the room. The room's temperature is recorded, or stays at 20 degC.

Equations
    C dT/dt = power - loss (T - ambient)

Typically missing
    Radiation and convection that grow faster than the difference (`growing-loss` at the block); a
    second mass that warms up behind the first (`second-store` at the block); a sensor that follows
    late or sits at some distance (sensor); a heater that is switched in pulses, saturates or
    depends on its supply (heater).

References
    Incropera, DeWitt, Bergman, Lavine (2007), Fundamentals of Heat and Mass Transfer, Wiley,
    chapter 5: the lumped capacitance method.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

ROOM_K = 293.15


class ThermalBlock(Rig):
    """A heated block that loses heat to the room: power in, temperature out."""

    inputs = {"power_w": "W", "ambient_degc": "K"}
    optional = {"ambient_degc": ROOM_K}
    outputs = {"temperature_degc": "K"}
    ports = {
        "heater": Port("command", "W"),
        "block": Port("rate", "K/s", {"stored": "K", "temperature": "K", "loss": "K/s"}),
        "sensor": Port("reading", "K", {"rate": "K/s"}),
    }
    background = {
        "heater": RoughMap("heater_curve", positive=True, tolerance=0.02),
        "block": RoughMap("loss_curve", "stored", of="loss", positive=True, tolerance=0.02),
    }
    states = (State("temperature", "K", ROOM_K),)
    parameters = (
        Parameter.positive("capacity", 400.0, 1.0, 1e6, "J/K", factor=1.3).with_source(
            "weighed: 0.45 kg of aluminium"
        ),
        Parameter.positive("loss", 0.8, 0.001, 1e3, "W/K", factor=1.5).with_source(
            "estimate: 10 W/(m2 K) over the surface"
        ),
    )
    noise = {"temperature_degc": 0.05}
    period_s = 10.0
    excited = {"power_w": 40.0}
    centre = {"power_w": 50.0}
    hold_s = (200.0, 1200.0)

    def change(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Rate of the block's temperature, K/s."""
        power = port("heater", u.power_w)
        excess = x.temperature - u.ambient_degc
        loss = p.loss * excess / p.capacity
        return port(  # type: ignore[no-any-return]
            "block", power / p.capacity - loss, stored=excess, temperature=x.temperature, loss=loss
        )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"temperature": self.change(x, u, p, port)}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        # what the sensor reads above the room, so that its gain and limits have that size
        above = port("sensor", x.temperature - ROOM_K, rate=self.change(x, u, p, port))
        return {"temperature_degc": ROOM_K + above}
