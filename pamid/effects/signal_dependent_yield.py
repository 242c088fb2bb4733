"""A force that yields at a speed, at a level that follows a signal.

What it is
    A damper with a magnetised or an electrified fluid, a brake with a film: below the yield the
    force grows with speed, above it the level holds, which a current, a voltage, a pressure or a
    load sets. The port offers the signal under `level`, or under its name: current, voltage,
    pressure, temperature, load (the first of these counts; a load has a separate effect).
What it looks like
    Rounded steps of force over speed, higher where the signal is larger; at reversals nothing
    sticks.
Looks like it
    Signal-dependent friction, which turns over a way instead of a speed; yielding friction, at a
    constant level (the signal has to change to tell them apart); saturation of the force sensor.
Equation
    value -= (base + slope |level|) * tanh(velocity / speed)
References
    Kwok, Ha, Nguyen, Li, Samali (2006), A novel hysteretic model for magnetorheological fluid
    dampers, Sensors and Actuators A 132(2), 441-451; Spencer, Dyke, Sain, Carlson (1997),
    Phenomenological model for magnetorheological dampers, J. Eng. Mech. 123(3), 230-238.
"""

from typing import Any

from pamid.effects.signal_dependent_friction import SignalDependentFriction
from pamid.effects.yielding_friction import SPEED
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, tanh
from pamid.model.effect import Effect


class SignalDependentYield(Effect):
    """Friction that sets in with speed, with a constant level and a level in proportion to a
    signal."""

    family = "friction"
    general_kinds = ("motion",)
    signals = ("velocity", "level")
    defining = SignalDependentFriction.defining
    stand_ins = SignalDependentFriction.stand_ins
    parameters = (*SignalDependentFriction.parameters[:2], SPEED)
    symptoms = ("load", "history")
    look_alikes = ("signal-dependent-friction", "yielding-friction", "saturation")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        level = p.base + p.slope * absolute(at.level)
        return value - level * tanh(at.velocity / p.speed)
