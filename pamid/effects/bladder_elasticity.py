"""Force taken by the stretched bladder of a muscle.

What it is
    A muscle that shortens grows wide, and the rubber in it has to be stretched before the braid
    pulls. The force lost to it depends on the contraction, not on the pressure; it rises steeply
    first and levels off, as rubber does. A part is lost at rest already, where the bladder is
    pressed against the braid.
What it looks like
    Force over pressure is a straight line that starts late: the pressure at which the muscle begins
    to pull grows with the contraction, the slope stays the braid's. The farther it has contracted,
    the sooner it goes slack.
Looks like it
    A threshold pressure, the same at every length; another braid angle or force scale, which turn
    the lines instead of shifting them; an offset of the load cell, which a slack muscle shows as
    well. Force maps at three lengths tell.
Equation
    force -= level (at_rest + 1 - exp(-contraction/reach)); below rest length the straight line on
    from there
References
    Chou, Hannaford (1996), IEEE Trans. Robotics and Automation 12(1), 90-102; Davis, Tsagarakis,
    Canderle, Caldwell (2003), Int. J. Robotics Research 22(3-4), 213-227; Martens, Boblan (2017),
    Actuators 6(4), 33.
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, exp, maximum, minimum
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class BladderElasticity(Effect):
    family = "stiffness"
    kinds = ()
    general_kinds = ("actuator-force",)
    signals = ("position", "pressure")
    parameters = (
        Parameter.level(0.2, 0.0, 1.0, spread=0.2).with_source(
            "measured maps of 10 and 20 mm muscles: 130-220 N of 400-1800 N"
        ),
        Parameter.width("reach", 0.2, 0.03, 2.0, factor=2.0, tries=(0.5,)).with_source(
            "the same maps: 1-6 % of contraction"
        ),
        Parameter("at_rest", 0.2, 0.0, 1.0, spread=0.3).with_source(
            "the same maps: first force at 35-65 kPa, a tenth to a half of the level"
        ),
    )
    symptoms = ("load",)
    look_alikes = ("threshold-pressure", "offset")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        bent = at.position / p.reach
        return value - p.level * (p.at_rest + 1.0 - exp(-maximum(bent, 0.0)) + minimum(bent, 0.0))
