"""Overflow of a store into the next.

What it is
    Two tanks, stacked: beyond a level the upper tank spills, and a share of that falls into the
    lower tank, the rest outside. Two ports take part: that of the store that spills
    offers `downstream`, what is stored in the other; that of the store that receives offers
    `upstream`. Both lose and gain by the same law. The share also holds the ratio of their areas.
What it looks like
    The upper level hardly rises beyond a height, and just then the lower level rises faster than
    what flows through between them.
Looks like it
    An overflow that is lost (the lower store does not receive it); a saturated sensor above; a
    wider pipe between the two.
Equation
    spilt(s) = gain max(s - level, 0); above: value -= spilt(stored); below: value += share
    spilt(upstream)
References
    Schoukens, Mattson, Wigren, Noel (2016), Cascaded tanks benchmark combining soft and hard
    nonlinearities, Workshop on Nonlinear System Identification Benchmarks, Brussels.
"""

from typing import Any

from pamid.effects.overflow import Overflow, tried_levels
from pamid.engine.symbolic.vocabulary import Expr, Number, maximum
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter


class OverflowIntoStore(Effect):
    """A loss above a level in a store, and a share of it gained by another."""

    family = "overflow"
    general_kinds = ("rate",)
    roles = (("stored", "downstream"), ("upstream",))
    parameters = (
        *Overflow.parameters,
        Parameter("share", 0.7, 0.0, 3.0, spread=0.5).with_source(
            "estimate: a part misses the other store; times the ratio of the areas"
        ),
    )
    symptoms = ("saturates", "level")
    look_alikes = ("overflow", "orifice-loss", "saturation")

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Levels within what the store that spills reaches."""
        return tried_levels(hints)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        def spilt(stored: Expr) -> Expr:
            return p.gain * maximum(stored - p.level, 0.0)

        if at.offers("downstream"):
            value = value - spilt(at.stored)
        if at.offers("upstream"):
            value = value + p.share * spilt(at.upstream)
        return value
