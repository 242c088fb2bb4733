"""A signal that remembers where it came from.

What it is
    A piezo stage, a magnetic core, a load cell whose bonds creep and slip, a humidity or pressure
    sensor: the value lags behind every turn of what it should follow by a share of the travel, at
    any speed. Four plays in parallel, of a tenth to two and a half times the reach.
What it looks like
    A loop between what goes in and what comes out, of the same width slow and fast; the value after
    a long way up differs from that after a long way down; small loops close.
Looks like it
    A lag (its loop closes at low speed); play, which is a loop of full width and no rounding;
    hysteresis of a force on the mechanism, which moves with the other sensors.
Equation
    value -= share sum_i w_i stop(value, d_i); w = .4 .3 .2 .1, d = (0.1, 0.4, 1, 2.5) reach
References
    Kuhnen (2003), Modeling, identification and compensation of complex hysteretic nonlinearities: a
    modified Prandtl-Ishlinskii approach, European Journal of Control 9(4), 407-418; Brokate,
    Sprekels (1996), Hysteresis and Phase Transitions, Springer.
"""

from typing import Any

from pamid.effects.maxwell_slip_hysteresis import ELEMENTS
from pamid.engine.symbolic.vocabulary import Expr, Number, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class SignalHysteresis(Effect):
    """A bundle of plays; `share` is how much of a short turn is swallowed."""

    family = "hysteresis"
    general_kinds = ("command", "reading")
    parameters = (
        Parameter.share("share", 0.05, 0.0, 0.15, spread=0.05).with_source(
            "estimate: piezo stages 10-15 %, cheap sensors 0.5-5 % of the travel; what swallows "
            "more of a turn is play"
        ),
        Parameter.width(
            "reach", 0.2, 0.02, 2.0, factor=3.0, size="value", tries=(0.05,)
        ).with_source("estimate: the travel after which the value follows fully again"),
    )
    symptoms = ("history", "direction")
    look_alikes = ("play", "first-order-lag", "dead-zone")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        held: Number = 0.0
        for weight, stretch in ELEMENTS:
            held = held + weight * stop(value, stretch * p.reach)
        return value - p.share * held
