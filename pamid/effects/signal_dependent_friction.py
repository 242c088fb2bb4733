"""Dry friction whose level follows a signal: a current, a voltage, a pressure, a load.

What it is
    Something sets how hard the surfaces hold each other: the current of a brake, the voltage at the
    coil of a damper with a magnetised fluid, the pressure behind a seal, the load on a guide. The
    level of friction is a part that is always there and a part in proportion to that signal. The
    port offers the signal under `level`, or under its name: current, voltage,
    pressure, temperature, load (the first of these counts; a load has a separate effect).
What it looks like
    The width of the loop between motion back and forth differs between stretches at another
    current, pressure or load; within a stretch it looks like plain dry friction.
Looks like it
    Coulomb and Dahl friction (constant width: the signal has to change to tell them apart);
    load-dependent friction (nothing is left where the load is gone); hysteresis of a spring.
Equation
    value -= (base + slope |level|) * stop(position, give) / give
References
    Spencer, Dyke, Sain, Carlson (1997), Phenomenological model for magnetorheological dampers,
    J. Eng. Mech. 123(3), 230-238; Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica
    30(7).
"""

from typing import Any, ClassVar

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, stop
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class SignalDependentFriction(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("position", "level")
    defining = ("slope",)
    stand_ins: ClassVar[dict[str, tuple[str, ...]]] = {
        "level": ("current", "voltage", "pressure", "temperature", "load")
    }
    parameters = (
        Parameter.level(0.03, 0.0, 2.0, name="base", spread=0.2).with_source(
            "estimate: guides and seals, 1-15 % of the drive's force"
        ),
        Parameter.slope("slope", "level", 0.1, 0.0, 3.0, spread=0.4).with_source(
            "estimate: brakes, dampers with a magnetised fluid and pressed seals, 5-100 % of the "
            "force at the largest signal"
        ),
        Parameter.width(
            "give", 0.003, 0.0001, 0.3, factor=4.0, size="travel", tries=(0.05,)
        ).with_source("estimate: presliding of a thousandth of the stroke, of fluids a tenth"),
    )
    symptoms = ("load",)
    look_alikes = (
        "load-dependent-friction",
        "coulomb-friction",
        "dahl-friction",
        "bouc-wen-hysteresis",
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        level = p.base + p.slope * absolute(at.level)
        return value - level * stop(at.position, p.give) * (1.0 / p.give)
