"""Friction that grows in proportion to speed.

What it is
    The drag of an oil or grease film, of a seal, of eddy currents: a force against the motion,
    proportional to its velocity. It takes energy at any speed and holds nothing at rest.
What it looks like
    Oscillations die out by the same factor in every swing, whatever their size; at constant speed
    the missing force lies on a straight line through zero; a slow creep meets no resistance.
Looks like it
    Dry friction (constant, and it sticks: swings die out by the same amount each); quadratic drag
    (curves upwards with speed); the back-EMF of a voltage-driven motor, which no motion can tell
    from it; a lag in the sensor, which also turns the phase but takes no energy.
Equation
    value -= damping * velocity
References
    Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7); Olsson, Astrom, Canudas de
    Wit, Gafvert, Lischinsky (1998), European Journal of Control 4(3).
"""

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class ViscousFriction(Effect):
    family = "friction"
    general_kinds = ("motion",)
    signals = ("velocity",)
    parameters = (
        Parameter.slope("damping", "velocity", 0.05, 0.0, 2.0, spread=0.2).with_source(
            "estimate: greased guides and geared drives lose 2-20 % of their force at full speed"
        ),
    )
    symptoms = ("speed",)
    look_alikes = ("quadratic-drag", "coulomb-friction", "stribeck-friction")
    absorbed_by = ("viscous", "damping")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.damping * at.velocity
