"""Play between the drive and what is measured, or between a command and what it moves.

What it is
    A gear, a coupling or a linkage with clearance. The drive moves through the gap first, then it
    takes along what stays where it was left, by friction: the load with the sensor on it,
    or the spool behind a lever.
What it looks like
    After every reversal the reading rests for the width of the gap although the drive moves;
    beyond that it follows at gain 1, behind by half of the gap on either side.
Looks like it
    Dry friction (there the drive stands as well); a dead zone, which lies about zero and not where
    the motion turned; a delay, whose gap grows with the speed; play in which the load swings freely
    (backlash).
Equation
    value = play(value, half_gap)
References
    Nordin, Gutman (2002), Controlling mechanical systems with backlash: a survey, Automatica
    38(10), 1633-1649; Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor
    Nonlinearities, Wiley.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, play
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Play(Effect):
    """A gap, behind which everything stays where it was left."""

    family = "flexible-transmission"
    general_kinds = ("command", "reading")
    excluded_units = ("K", "W", "m/s", "rad/s")  # heat has no gap, and a speed is not a place
    parameters = (
        Parameter(
            "half_gap", 0.02, 0.0, 0.5, spread=0.1, size="value", null=0.0, tries=(0.1,)
        ).with_source("estimate: gears and linkages 0.1-2 deg, screws 5-100 um"),
    )
    symptoms = ("reversals",)
    look_alikes = ("signal-hysteresis", "coulomb-friction", "dead-zone", "dead-time", "backlash")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return play(value, p.half_gap)
