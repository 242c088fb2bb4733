"""The check of sensitivities where errors of the state grow: it allows for that, and for no wrong
derivative."""

from dataclasses import replace
from typing import Any

from pamid.engine.symbolic.vocabulary import Number, clip, sin, sqrt
from pamid.intake.checks import conformance
from pamid.intake.checks.conformance import SAME_SLOPE, finite_everywhere, sensitivity_error
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class Toppling(Rig):
    """Two undamped rods that stand upright, joined by a spring, with a corner in a torque: they
    topple over, again and again."""

    inputs = {"torque": ""}
    outputs = {"angle": ""}
    ports = {"hinge": Port("motion", "", ("velocity",))}
    states = (State("a", "", 0.5), State("b", "", -0.2), State("a_rate"), State("b_rate"))
    parameters = (
        Parameter("steepness", 900.0, 100.0, 2000.0, spread=0.1, source="length"),
        Parameter("loss", 1.0, 0.1, 3.0, spread=0.1, source="bench"),
    )
    period_s = 0.01

    def rates(self, x, u, p, port):
        torque = port("hinge", u.torque, velocity=x.a_rate)
        loss, pull = clip(100.0 * x.b_rate, -p.loss, p.loss), 300.0 * sin(x.a - x.b)
        return {
            "a": x.a_rate,
            "b": x.b_rate,
            "a_rate": p.steepness * sin(x.a) + torque - pull,
            "b_rate": 0.7 * p.steepness * sin(x.b) + pull - loss,
        }

    def measure(self, x, u, p, port):
        return {"angle": x.a}


def test_growing_errors_are_no_wrong_derivatives():
    assert finite_everywhere(Toppling(), draws=2) == []
    assert sensitivity_error(Toppling()) < SAME_SLOPE


class Undefined(Toppling):
    """One without a solution at most values of a held parameter."""

    parameters = (
        *Toppling.parameters,
        Parameter("share", 0.0, 0.0, 100.0, spread=1.0, source="", fitted=False),
    )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        rates = super().rates(x, u, p, port)
        return rates | {"a_rate": rates["a_rate"] + sqrt(1.0 - p.share)}


class UndefinedFitted(Undefined):
    parameters = (*Undefined.parameters[:-1], replace(Undefined.parameters[-1], fitted=True))


def test_held_parameters_are_checked_at_their_values_only():
    assert finite_everywhere(Undefined(), draws=3) == []
    assert finite_everywhere(UndefinedFitted(), draws=3) != []


def test_a_wrong_derivative_is_found_where_errors_grow(monkeypatch):
    right = conformance._start_slopes

    def wrong(trial, p):
        """As if the start depended on the second parameter."""
        slopes = right(trial, p)
        slopes[0, 1] += 0.01
        return slopes

    monkeypatch.setattr(conformance, "_start_slopes", wrong)
    assert sensitivity_error(Toppling()) > 10.0 * SAME_SLOPE
