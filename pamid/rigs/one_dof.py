"""A joint, two antagonistic 20 mm muscles (first paper), a fill and a vent valve each.

Equations
    contraction  chi1 = chi0 + r beta/L0, chi2 = chi0 - r beta/L0
    joint        J dw/dt = r (F1 - F2) - b w + external torque
    muscles, valves and air as in `pamid.rigs.antagonists`
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig, chain_of_links
from pamid.rigs import antagonists as pair
from pamid.rigs.antagonists import Muscle, pressure_rate, pull_of, valves_of
from pamid.rigs.muscle import LAWS, StaticForce, law_named
from pamid.rigs.muscle_experiments import EXPERIMENTS, HIGHEST_TORQUE_NM
from pamid.rigs.pneumatics import ATMOSPHERE_PA

BOTH = ("1", "2")
# drawn length; estimate: an arm of 0.35 kg and 0.30 m has three quarters of the nominal inertia
ARM_M = 0.30


def _both(ports: Mapping[str, Port]) -> dict[str, Port]:
    """Ports of a muscle, with a place for each of the two."""
    return {name: replace(port, places=BOTH) for name, port in ports.items()}


class OneDof(Rig):
    """A joint driven by two antagonistic muscles."""

    name = "one-dof"
    inputs = {"command": "", "external_torque_nm": "N m"}
    optional = {"external_torque_nm": 0.0}
    outputs = {
        "angle_deg": "rad",
        "pressure_1_kpa": "Pa",
        "pressure_2_kpa": "Pa",
        "force_1_n": "N",
        "force_2_n": "N",
    }
    ports = {
        "command": Port("command", "", size={"value": 1.0}, general=False),
        **_both(pair.MUSCLE_PORTS),
        **pair.joint_ports(
            "joint", "arm", {"value": 10.0, "velocity": 2.0, "position": 0.7, "load": 1000.0}
        ),
        "angle_sensor": pair.ANGLE_SENSOR,
        **_both(pair.MUSCLE_SENSORS),
    }
    states = (
        State("angle", "rad"),
        State("velocity", "rad/s"),
        State("pressure_1", "Pa"),
        State("pressure_2", "Pa"),
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter.held("inertia", 0.014, 0.001, 1.0, "kg m2").with_source("first paper, Jn"),
        Parameter.held("radius", 0.030, 0.005, 0.2, "m").with_source(
            "estimate: +-40 deg at contraction 0.10"
        ),
        pair.LENGTH,
        *pair.SUPPLY_PARAMETERS,
        *pair.AIR,
        Parameter("viscous", 0.02, 0.0, 0.5, "N m s", spread=0.1).with_source(
            "estimate, bearing and chain"
        ),
        *pair.ATTACHING,
    )
    background = {"muscle": pair.force_map(), "valve": pair.flow_tolerance()}
    loops = (Loop("command", "reference_deg", "angle_deg"),)
    controller = {
        "kp_per_deg": 0.10,
        "kd_s_per_deg": 0.003,
        "derivative_filter_s": 0.006,
        "command_limit": 1.0,
    }
    noise = {
        "angle_deg": 0.05,
        "pressure_1_kpa": 1.0,
        "pressure_2_kpa": 1.0,
        "force_1_n": 3.0,
        "force_2_n": 3.0,
    }
    period_s = 0.003
    excited = {"reference_deg": 40.0, "command": 0.8}
    experiments = EXPERIMENTS
    # with the two rods of the first paper the inertia is 6.4 times as large
    changeable = {"inertia_kg_m2": 0.0896}
    external = {"external_torque_nm": HIGHEST_TORQUE_NM}
    usual = True
    actuators = {"1": ("command", 1.0), "2": ("command", -1.0)}
    variants = tuple(LAWS)
    static_force = StaticForce()

    def __init__(self, law: str = "exponential") -> None:
        # a rig file may put another here, such as `force_law_of` a network
        self.static_force = law_named(law)

    def start(self, p: Any) -> dict[str, float]:
        """Both muscles at p0, the arm at rest in the middle."""
        return {
            "pressure_1": p.initial_pressure + ATMOSPHERE_PA,
            "pressure_2": p.initial_pressure + ATMOSPHERE_PA,
        }

    def muscles(self, x: Any, p: Any) -> tuple[Muscle, Muscle]:
        """Both muscles where the joint has taken them."""

        def at(place: str, side: float, pressure: Expr) -> Muscle:
            arm = side * p.radius / p.length
            return Muscle(place, side, p.contraction_0 + arm * x.angle, arm * x.velocity, pressure)

        return at("1", 1.0, x.pressure_1), at("2", -1.0, x.pressure_2)

    def pulls(self, x: Any, p: Any, port: Any) -> tuple[Expr, Expr]:
        """Forces of both muscles, N."""
        first, second = (pull_of(m, self.static_force, p, port) for m in self.muscles(x, p))
        return first, second

    def opened(self, command: Expr, p: Any) -> Expr:
        """How far a command opens the valves, signed like it: here they follow it at once."""
        return command

    def pressure_rates(self, x: Any, u: Any, p: Any, port: Any) -> tuple[Expr, Expr]:
        """dP/dt of both muscles, Pa/s."""
        muscles = self.muscles(x, p)
        valves = valves_of(muscles, self.opened(port("command", u.command), p), p)
        drawn = valves[0].drawn + valves[1].drawn
        first, second = (
            pressure_rate(m, v, drawn, force, p, port)
            for m, v, force in zip(muscles, valves, self.pulls(x, p, port), strict=True)
        )
        return first, second

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        f1, f2 = self.pulls(x, p, port)
        torque = p.radius * (f1 - f2) - p.viscous * x.velocity + u.external_torque_nm
        torque = port("joint", torque, position=x.angle, velocity=x.velocity, load=f1 + f2)
        torque = port("arm", torque, position=x.angle, velocity=x.velocity, inertia=p.inertia)
        dp1, dp2 = self.pressure_rates(x, u, p, port)
        return {
            "angle": x.velocity,
            "velocity": torque / p.inertia,
            "pressure_1": dp1,
            "pressure_2": dp2,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        dp = self.pressure_rates(x, u, p, port)
        out = {"angle_deg": port("angle_sensor", x.angle, rate=x.velocity)}
        for i, state, rate in (("1", x.pressure_1, dp[0]), ("2", x.pressure_2, dp[1])):
            out[f"pressure_{i}_kpa"] = port(
                "pressure_sensor", state - ATMOSPHERE_PA, place=i, rate=rate
            )
        for i, force in zip(BOTH, self.pulls(x, p, port), strict=True):
            out[f"force_{i}_n"] = port("force_sensor", force, place=i, rate=0.0)
        return out

    def pose(self, y: Mapping[str, Array], p: Any) -> dict[str, Array]:
        """The arm from hub to tip, seen from above; the middle of its range points up."""
        return {"arm": chain_of_links([y["angle_deg"] + 0.5 * np.pi], [ARM_M])}
