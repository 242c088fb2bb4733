"""A pendulum on a driven cart, once with equations, once stepped: the same machine."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.model.step_rig import StepRig
from pamid.symbolic.vocabulary import Number, cos, sin

GRAVITY = 9.81


class WrittenPendulum(Rig):
    """With equations."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m", "angle_rad": "rad"}
    ports = {
        "rail": Port("motion", "N", ("position", "velocity")),
        "hinge": Port("motion", "N m", ("position", "velocity"), size={"value": 0.5}),
        "ruler": Port("reading", "m"),
        "encoder": Port("reading", "rad"),
    }
    states = (
        State("position", "m"),
        State("velocity", "m/s"),
        State("angle", "rad"),
        State("turning", "rad/s"),
    )
    parameters = (
        Parameter("cart_kg", 1.0, 0.3, 3.0, source="scale"),
        Parameter("bob_kg", 0.2, 0.05, 0.8, source="scale"),
        Parameter("rod_m", 0.4, 0.2, 0.8, source="ruler"),
        Parameter("rail_n_s_per_m", 2.0, 0.2, 20.0, source="guess"),
        Parameter("hinge_n_m_s", 0.01, 0.001, 0.1, source="guess"),
    )
    noise = {"position_m": 2e-4, "angle_rad": 1e-3}
    excited = {"force_n": 6.0}
    period_s = 0.01

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        into = self.drive(x, u, p, port)
        state = x.position, x.velocity, x.angle, x.turning
        names = [s.name for s in self.states]
        found = _slopes(state, (into["rail"], into["hinge"]), p, sin, cos)
        return dict(zip(names, found, strict=True))

    def drive(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "rail": port("rail", u.force_n, position=x.position, velocity=x.velocity),
            "hinge": port("hinge", 0.0, position=x.angle, velocity=x.turning),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "position_m": port("ruler", x.position),
            "angle_rad": port("encoder", x.angle),
        }


class SteppedTwin(StepRig):
    """The same, stepped by the classical Runge-Kutta method."""

    inputs, outputs, ports = WrittenPendulum.inputs, WrittenPendulum.outputs, WrittenPendulum.ports
    states, parameters = WrittenPendulum.states, WrittenPendulum.parameters
    noise, excited = WrittenPendulum.noise, WrittenPendulum.excited
    period_s = WrittenPendulum.period_s
    drive, measure = WrittenPendulum.drive, WrittenPendulum.measure  # type: ignore[assignment]

    def step(self, x: Any, f: Any, p: Any, h: float) -> list[float]:
        state = np.array([x.position, x.velocity, x.angle, x.turning])
        force = f.rail, f.hinge
        k1 = _rates(state, force, p)
        k2 = _rates(state + h / 2 * k1, force, p)
        k3 = _rates(state + h / 2 * k2, force, p)
        k4 = _rates(state + h * k3, force, p)
        return list(state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


def _rates(state: Any, force: Any, p: Any) -> Any:
    return np.array(_slopes(state, force, p, np.sin, np.cos))


def _slopes(state: Any, force: Any, p: Any, sin: Any, cos: Any) -> tuple[Any, ...]:
    """Rates of the four states, hanging down at an angle of 0."""
    _, velocity, angle, turning = state
    moment = p.bob_kg * p.rod_m
    rail = force[0] - p.rail_n_s_per_m * velocity + moment * turning * turning * sin(angle)
    hinge = force[1] - p.hinge_n_m_s * turning - moment * GRAVITY * sin(angle)
    both, inertia, link = p.cart_kg + p.bob_kg, moment * p.rod_m, moment * cos(angle)
    free = both * inertia - link * link
    return (
        velocity,
        (inertia * rail - link * hinge) / free,
        turning,
        (both * hinge - link * rail) / free,
    )
