"""A pendulum on a driven cart, once with equations, once stepped: the same machine."""

from pathlib import Path
from typing import Any

import numpy as np

from pamid.engine.symbolic.vocabulary import cos, sin
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig

GRAVITY = 9.81
#: what the machine is called and consists of is declared there, once
EXAMPLE = rig_named(str(Path(__file__).resolve().parents[2] / "data/rigs/stepped_pendulum.py"))


class WrittenPendulum(Rig):
    """With equations."""

    inputs, outputs, ports = EXAMPLE.inputs, EXAMPLE.outputs, EXAMPLE.ports
    states, parameters = EXAMPLE.states, EXAMPLE.parameters
    noise, excited, period_s = EXAMPLE.noise, EXAMPLE.excited, EXAMPLE.period_s

    def rates(self, x, u, p, port):
        into = self.drive(x, u, p, port)
        state = x.position, x.velocity, x.angle, x.turning
        names = [s.name for s in self.states]
        found = _slopes(state, (into["rail"], into["hinge"]), p, sin, cos)
        return dict(zip(names, found, strict=True))

    def drive(self, x, u, p, port):
        return {
            "rail": port("rail", u.force_n, position=x.position, velocity=x.velocity),
            "hinge": port("hinge", 0.0, position=x.angle, velocity=x.turning),
        }

    def measure(self, x, u, p, port):
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

    def step(self, x, f, p, h):
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
