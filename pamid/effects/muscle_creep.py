"""Slow yielding of rubber and braid.

What it is
    Part of the force builds up late: the rubber goes on giving for seconds to minutes after a
    change. A positive share is creep (the force arrives late), a negative share relaxation (the
    force fades after a change).
What it looks like
    After a change the force of a held muscle, or the length of a loaded muscle, drifts on for
    seconds to minutes while the pressure stays; the first cycles after a rest differ from the later
    ones.
    Two equal muscles that pull against each other without a load creep alike: the forces show it,
    the angle hardly.
Looks like it
    A leak (the pressure falls); heat exchange (the pressure moves, for a second); in step tests of
    a few seconds, nothing at all: the other parameters absorb it. Hold for 60-300 s to see it.
Equation
    force += share (lag(force, time_constant) - force)
References
    Findley, Lai, Onaran (1976), Creep and Relaxation of Nonlinear Viscoelastic Materials; data
    sheet of the muscle (relaxation at most 5 %).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, lag
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class MuscleCreep(Effect):
    """A delayed branch of the force (standard linear solid)."""

    family = "muscle-creep"
    kinds = ("actuator-force",)
    parameters = (
        Parameter.share("share", 0.05, -0.15, 0.2, spread=0.05).with_source(
            "2-8 % of the force; data sheet: at most 5 %"
        ),
        Parameter.time(5.0, 0.5, 100.0, factor=5.0, tries=(1.0, 30.0)).with_source(
            "estimate: 1-10 s and 100-1000 s; beyond 100 s a recording of minutes is blind"
        ),
    )
    symptoms = ("drifts",)
    look_alikes = ("leak", "heat-transfer", "maxwell-slip-hysteresis")
    absorbed_by = ("scale",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value + p.share * (lag(value, p.time_constant) - value)
