"""A second store behind the first.

What it is
    The core of a block behind the surface that the sensor touches, the winding of a motor behind
    its housing, air in a hose behind the vessel, water in a branch: part of what flows in goes on
    into a second store, which fills and empties later, through a separate resistance.
What it looks like
    After a step the stored quantity moves fast at first and then goes on slowly; shut off, it falls
    back by a part of what it had risen, though nothing is lost. Slow cycles find the whole
    capacity, fast ones the first store alone.
Looks like it
    A sensor that follows late (the same curve where only a single cycle is seen, but never faster
    than the whole capacity allows); a loss (it does not come back); readings that are stamped
    early, for the fast half alone; of a gas heat that goes to the wall.
Equation
    value = (value - share d / time_constant) / (1 - share), dd/dt = value - d / time_constant, with
    d by what the first store is fuller than the second, share of the capacity in the second
References
    Incropera, DeWitt, Bergman, Lavine (2007), Fundamentals of Heat and Mass Transfer, Wiley,
    chapter 5; Bacher, Madsen (2011), Identifying suitable models for the heat dynamics of
    buildings, Energy and Buildings 43(7), 1511-1522.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter


class SecondStore(Effect):
    """Part of the capacity lies behind a resistance; at first both stores are equally full."""

    family = "second-store"
    general_kinds = ("rate",)
    signals = ("stored",)
    states = (State("ahead"),)
    parameters = (
        Parameter.share("share", 0.2, 0.0, 0.8, spread=0.2, hard=True).with_source(
            "estimate: the core of a block, the winding of a motor: 10-60 % of the capacity"
        ),
        Parameter.time(0.5, 0.03, 5.0, factor=3.0, size="timescale", tries=(0.15, 1.5)).with_source(
            "estimate, in correlation times: what is faster acts as a single store, what is slower "
            "a loss"
        ),
    )
    symptoms = ("drifts", "level")
    look_alikes = ("first-order-lag", "first-order-loss", "heat-transfer", "clock-skew")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        rate = (value - p.share * z.ahead / p.time_constant) / (1.0 - p.share)
        return rate, {"ahead": rate - z.ahead / p.time_constant}
