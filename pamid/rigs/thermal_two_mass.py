"""A heater element that heats a body, which cools to its surroundings.

What it is
    A furnace and its load, a cartridge in a hot end, a soldering iron, a cell in its housing: the
    element warms up first and passes its heat on. Either temperature is recorded, or both.
    The room's is recorded, or stays at 20 degC.

Equations
    element  C1 dT1/dt = power - conductance (T1 - T2)
    body     C2 dT2/dt = conductance (T1 - T2) - loss (T2 - ambient)

Typically missing
    Radiation and convection that grow faster than the difference (`growing-loss` at element or
    body); heat that the element loses past the body (element); a third mass; a sensor that follows
    late; a heater that is switched in pulses, saturates or depends on its supply (heater).

References
    Bacher, Madsen (2011), Identifying suitable models for the heat dynamics of buildings, Energy
    and Buildings 43(7), 1511-1522; Incropera, DeWitt, Bergman, Lavine (2007), Fundamentals of Heat
    and Mass Transfer, Wiley, chapter 5.
"""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.background import RoughMap
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig

ROOM_K = 293.15
STORE = {"stored": "K", "temperature": "K", "loss": "K/s"}


class ThermalTwoMass(Rig):
    """A heater element in a body that cools to the room: power in, both temperatures out."""

    inputs = {"power_w": "W", "ambient_degc": "K"}
    optional = {"ambient_degc": ROOM_K}
    outputs = {"element_temperature_degc": "K", "body_temperature_degc": "K"}
    ports = {
        "heater": Port("command", "W"),
        "element": Port("rate", "K/s", STORE),
        "body": Port("rate", "K/s", STORE),
        "element_sensor": Port("reading", "K", {"rate": "K/s"}),
        "body_sensor": Port("reading", "K", {"rate": "K/s"}),
    }
    background = {
        "heater": RoughMap("heater_curve", positive=True, tolerance=0.02),
        "body": RoughMap("loss_curve", "stored", of="loss", positive=True, tolerance=0.02),
    }
    states = (State("element", "K", ROOM_K), State("body", "K", ROOM_K))
    parameters = (
        Parameter.positive("element_capacity", 40.0, 0.01, 1e5, "J/K", factor=1.5).with_source(
            "weighed, C1"
        ),
        Parameter.positive("body_capacity", 400.0, 1.0, 1e6, "J/K", factor=1.3).with_source(
            "weighed, C2"
        ),
        Parameter.positive("conductance", 2.0, 0.001, 1e4, "W/K", factor=2.0).with_source(
            "estimate: contact"
        ),
        Parameter.positive("loss", 0.8, 0.001, 1e3, "W/K", factor=1.5).with_source(
            "estimate: 10 W/(m2 K) over the surface"
        ),
    )
    noise = {"element_temperature_degc": 0.1, "body_temperature_degc": 0.05}
    period_s = 5.0
    excited = {"power_w": 40.0}
    centre = {"power_w": 50.0}
    hold_s = (100.0, 1000.0)

    def element_change(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Rate of the element's temperature, K/s."""
        passed_on = p.conductance * (x.element - x.body)
        return port(  # type: ignore[no-any-return]
            "element",
            (port("heater", u.power_w) - passed_on) / p.element_capacity,
            stored=x.element - u.ambient_degc,
            temperature=x.element,
            loss=passed_on / p.element_capacity,
        )

    def body_change(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """Rate of the body's temperature, K/s."""
        excess = x.body - u.ambient_degc
        loss = p.loss * excess / p.body_capacity
        return port(  # type: ignore[no-any-return]
            "body",
            p.conductance * (x.element - x.body) / p.body_capacity - loss,
            stored=excess,
            temperature=x.body,
            loss=loss,
        )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "element": self.element_change(x, u, p, port),
            "body": self.body_change(x, u, p, port),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        # what a sensor reads above the room, so that its gain and limits have that size
        return {
            "element_temperature_degc": ROOM_K
            + port("element_sensor", x.element - ROOM_K, rate=self.element_change(x, u, p, port)),
            "body_temperature_degc": ROOM_K
            + port("body_sensor", x.body - ROOM_K, rate=self.body_change(x, u, p, port)),
        }
