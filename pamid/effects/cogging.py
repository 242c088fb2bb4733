"""A force that repeats with the position: cogging, ripple, eccentricity.

What it is
    Magnets that snap from tooth to tooth, a commutator, a screw or pulley that is not round, a gear
    with a bad tooth: the force has a fixed pattern along the way, with a period in metres or
    radians. Amplitude and phase are held by a sine and a cosine of it.
What it looks like
    Ripple whose frequency rises with the speed; at creep the mechanism hops from rest to
    rest; seen over the position, everything falls onto a line.
Looks like it
    A vibration from outside (its frequency stays when the speed changes); gravity on an arm, with
    the period of a full turn; a cubic spring where less than half a period is travelled.
Equation
    value += sine sin(2 pi position/period) + cosine cos(2 pi position/period)
References
    Hendershot, Miller (2010), Design of Brushless Permanent-Magnet Machines, Motor Design
    Books; Zhu, Howe (2000), Influence of design parameters on cogging torque in permanent
    magnet machines, IEEE Trans. Energy Conversion 15(4), 407-412.
"""

import math
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, cos, sin
from pamid.model.effect import Effect, Hints
from pamid.model.parameter import Parameter

TRIED_LINES = 3
# periods tried: an eighth of a period more in the largest position each time, up to fifty in it
SCANNED_PERIODS = (0.125, 400)


class Cogging(Effect):
    """A force with a period along the position; its phase counts from position 0."""

    family = "cogging"
    general_kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter.level(0.05, -1.0, 1.0, name="sine", spread=0.1).with_source(
            "estimate: motors 1-10 % of their rated force, linear motors up to 30 %"
        ),
        Parameter.level(0.0, -1.0, 1.0, name="cosine", spread=0.1).with_source(
            "estimate: motors 1-10 % of their rated force, linear motors up to 30 %"
        ),
        # two periods within the travel: a longer period is a spring's curve, not a pattern
        Parameter.width(
            "period", 0.3, 0.001, 1.0, factor=4.0, hard=True, scan=SCANNED_PERIODS
        ).with_source(
            "estimate: pole pitches, screw leads and teeth, a thousandth of the stroke and more; "
            "the lines of the gap's spectrum over the position are tried first"
        ),
    )
    symptoms = ("one-frequency",)
    look_alikes = ("external-vibration", "gravity", "cubic-stiffness")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        turn = (2.0 * math.pi) * at.position / p.period
        return value + p.sine * sin(turn) + p.cosine * cos(turn)

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """A start per line of the gap's spectrum over the position: a period off by more than a
        part in the periods travelled never finds its way."""
        return [{"period": period} for period in hints.periods[:TRIED_LINES]]
