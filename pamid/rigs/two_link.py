"""Planar arm of two links, two antagonistic 20 mm muscles at each joint (second paper), a fill and
a vent valve each.

Angle 1 is counted from hanging straight down, angle 2 from link 1. Muscle 21 is the first of
joint 2.

Equations
    arm          M(q) q'' + V(q, q') + G(q) = torques
                 M11 = A1 + A2 + 2 l1 B2 cos q2, M12 = A2 + l1 B2 cos q2, M22 = A2
                 V = l1 B2 sin q2 [-(2 q1' q2' + q2'^2), q1'^2]
                 G = g [B1 sin q1 + B2 sin(q1 + q2), B2 sin(q1 + q2)]
                 A1 = I1 + m1 c1^2 + (m2 + mp) l1^2, A2 = I2 + m2 c2^2 + mp l2^2
                 B1 = m1 c1 + (m2 + mp) l1, B2 = m2 c2 + mp l2
                 payload mp at the tip, g = 9.81 sin(plane)
    joint        torque_j = r_j (F_j1 - F_j2) - b_j q_j' + external torque, and r_w (F_21 - F_22) at
                 joint 1
    contraction  chi_11 = chi0 + r_1 q1/L0, chi_21 = chi0 + (r_2 q2 + r_w q1)/L0, the second muscles
                 mirrored
    muscles, valves and air as in `pamid.rigs.antagonists`; `two-link:LAW-compensated` has the
    muscles' built-in force compensators, which blow off air above 1200 N

Contractions are measured where the chains leave the wheels: those of the muscles, but for what a
chain stretches. For tests without actuation: `vents_open` (muscles limp, open to the room),
`attached` = 0 (chains taken off), `clamped_1`, `clamped_2`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import Expr, Number, cos, sin
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig, chain_of_links
from pamid.rigs import antagonists as pair
from pamid.rigs.antagonists import Muscle, pressure_rate, pull_of, valves_of
from pamid.rigs.muscle import LAWS, StaticForce, law_named
from pamid.rigs.muscle_experiments import EXPERIMENTS, HIGHEST_TORQUE_NM
from pamid.rigs.pneumatics import ATMOSPHERE_PA

GRAVITY_M_S2 = 9.81
JOINTS = ("1", "2")
MUSCLES = ("11", "12", "21", "22")
COMPENSATED = "-compensated"  # ends the variants whose muscles have force compensators


_MUSCLE_SENSORS = {
    "contraction_sensor": Port("reading", "", {"rate": "1/s"}, group="sensor", size={"value": 0.2}),
    **pair.MUSCLE_SENSORS,
}
# N m, rad/s, rad, N
_JOINT_SIZES = {
    "1": {"value": 15.0, "velocity": 2.0, "position": 0.5, "load": 1000.0},
    "2": {"value": 5.0, "velocity": 3.0, "position": 0.7, "load": 1000.0},
}


def _ports() -> dict[str, Port]:
    """A port per joint and per muscle; like ports are kin, but for those whose sizes differ from
    joint to joint."""
    ports: dict[str, Port] = {}
    for j in JOINTS:
        ports |= _ports_at(j, {"command": Port("command", "", size={"value": 1.0})})
    for i in MUSCLES:
        ports |= _ports_at(i, pair.MUSCLE_PORTS)
    for j in JOINTS:
        ports |= pair.joint_ports(f"joint_{j}", f"arm_{j}", _JOINT_SIZES[j], f"structure_{j}")
        ports |= _ports_at(j, {"angle_sensor": pair.ANGLE_SENSOR})
    for i in MUSCLES:
        ports |= _ports_at(i, _MUSCLE_SENSORS)
    return ports


def _ports_at(place: str, table: Mapping[str, Port]) -> dict[str, Port]:
    """The ports of a table at a joint or muscle, which share an effect's parameters with their
    like (kin). What a chain stretches belongs to the structure of its joint."""
    groups = {"muscle": place, "sensor": place, "structure": place[0]}
    return {
        f"{name}_{place}": replace(
            port,
            group=port.group and f"{port.group}_{groups[port.group]}",
            kin=name,
            general=False,
        )
        for name, port in table.items()
    }


def _link(
    number: str, mass: float, centre: float, inertia: float, length: float
) -> tuple[Parameter, ...]:
    known = (
        Parameter.positive(f"link_{number}_mass", mass, 0.1, 20.0, "kg", factor=1.25),
        Parameter.positive(f"link_{number}_centre", centre, 0.01, 1.0, "m", factor=1.2),
        Parameter.positive(f"link_{number}_inertia", inertia, 1e-5, 2.0, "kg m2", factor=1.35),
    )
    measured = Parameter.held(f"link_{number}_length", length, 0.05, 2.0, "m")
    source = "estimate: weighing and CAD, off by 15-25 % for want of muscles, chains and screws"
    return (
        *(p.with_source(source) for p in known),
        measured.with_source("estimate, tape measure"),
    )


class _Inertia(NamedTuple):
    """Base parameters of the arm: inertias about the joints (kg m2) and first moments (kg m),
    payload included."""

    inertia_1: Any
    inertia_2: Any
    moment_1: Any
    moment_2: Any


class TwoLink(Rig):
    """Two links in a plane, four muscles."""

    name = "two-link"
    inputs = {
        "command_1": "",
        "command_2": "",
        "external_torque_1_nm": "N m",
        "external_torque_2_nm": "N m",
    }
    optional = dict.fromkeys(inputs, 0.0)
    outputs = {
        **{f"angle_{j}_deg": "rad" for j in JOINTS},
        **{f"contraction_{i}": "" for i in MUSCLES},
        **{f"pressure_{i}_kpa": "Pa" for i in MUSCLES},
        **{f"force_{i}_n": "N" for i in MUSCLES},
    }
    ports = _ports()
    states = (
        State("angle_1", "rad"),
        State("angle_2", "rad"),
        State("velocity_1", "rad/s"),
        State("velocity_2", "rad/s"),
        *(State(f"pressure_{i}", "Pa") for i in MUSCLES),
    )
    parameters = (
        *_link("1", 2.2, 0.20, 0.040, 0.40),
        *_link("2", 0.70, 0.13, 0.0075, 0.30),
        Parameter.held("payload", 0.0, 0.0, 20.0, "kg").with_source(
            "weighed; at the tip of link 2"
        ),
        Parameter.held("plane", 90.0, -90.0, 90.0, "deg").with_source(
            "90: vertical, 0: horizontal"
        ),
        Parameter.held("radius_1", 0.035, 0.005, 0.2, "m").with_source(
            "estimate, wheel of joint 1"
        ),
        Parameter.held("radius_2", 0.025, 0.005, 0.2, "m").with_source(
            "estimate, wheel of joint 2"
        ),
        Parameter.held("wrap_radius", 0.0, -0.2, 0.2, "m").with_source(
            "idler at joint 1 over which the chain of joint 2 runs; 0: none"
        ),
        pair.LENGTH,
        *pair.SUPPLY_PARAMETERS,
        Parameter("viscous_1", 0.10, 0.0, 2.0, "N m s", spread=0.15).with_source(
            "estimate, bearing and chain"
        ),
        Parameter("viscous_2", 0.05, 0.0, 1.0, "N m s", spread=0.10).with_source(
            "estimate, bearing and chain"
        ),
        *pair.AIR,
        *pair.ATTACHING,
        *(
            Parameter.held(f"initial_angle_{j}", 0.0, -180.0, 180.0, "deg").with_source(
                "where a recording begins, at rest"
            )
            for j in JOINTS
        ),
        *(
            Parameter.held(f"clamped_{j}", 0.0, 0.0, 1.0).with_source("1: the joint is clamped")
            for j in JOINTS
        ),
        Parameter.held("vents_open", 0.0, 0.0, 1.0).with_source("1: all vent valves stand open"),
        Parameter.held("attached", 1.0, 0.0, 1.0).with_source(
            "0: the chains are taken off the joints"
        ),
    )
    background = {
        **{f"muscle_{i}": pair.force_map(f"force_map_{i}") for i in MUSCLES},
        **{f"valve_{i}": pair.flow_tolerance(f"flow_{i}") for i in MUSCLES},
    }
    loops = tuple(Loop(f"command_{j}", f"reference_{j}_deg", f"angle_{j}_deg") for j in JOINTS)
    controller = {
        "kp_per_deg": 0.05,
        "kd_s_per_deg": 0.003,
        "derivative_filter_s": 0.006,
        "command_limit": 1.0,
    }
    noise = {
        **dict.fromkeys(("angle_1_deg", "angle_2_deg"), 0.05),
        **{f"contraction_{i}": 2e-4 for i in MUSCLES},
        **{f"pressure_{i}_kpa": 1.0 for i in MUSCLES},
        **{f"force_{i}_n": 3.0 for i in MUSCLES},
    }
    period_s = 0.003
    excited = {"reference_1_deg": 20.0, "reference_2_deg": 30.0, "command_1": 0.8, "command_2": 0.8}
    experiments = EXPERIMENTS
    changeable = {"payload_kg": 0.5}
    external = dict.fromkeys(("external_torque_1_nm", "external_torque_2_nm"), HIGHEST_TORQUE_NM)
    actuators = {i: (f"command_{i[0]}", 1.0 if i[1] == "1" else -1.0) for i in MUSCLES}
    variants = (*LAWS, *(f"{law}{COMPENSATED}" for law in LAWS))
    static_force = StaticForce()
    option_parameters: tuple[Parameter, ...] = ()

    def __init__(self, law: str = "exponential") -> None:
        self.compensator = law.endswith(COMPENSATED)
        if self.compensator:
            self.option_parameters = pair.COMPENSATOR
        # a rig file may put another here, such as `force_law_of` a network
        self.static_force = law_named(law.removesuffix(COMPENSATED))

    def start(self, p: Any) -> dict[str, float]:
        """At rest where the recording begins; muscles at p0, or limp where the vents stand open."""
        held = ATMOSPHERE_PA + (0.0 if p.vents_open > 0.5 else p.initial_pressure)
        return {
            **{f"pressure_{i}": held for i in MUSCLES},
            "angle_1": p.initial_angle_1,
            "angle_2": p.initial_angle_2,
        }

    # ---- muscles --------------------------------------------------------------------------------

    def muscles(self, x: Any, p: Any) -> dict[str, Muscle]:
        """All muscles where the joints have taken them."""
        scale = p.attached / p.length
        wound = {
            "1": p.radius_1 * scale * x.angle_1,
            "2": p.radius_2 * scale * x.angle_2 + p.wrap_radius * scale * x.angle_1,
        }
        winding = {
            "1": p.radius_1 * scale * x.velocity_1,
            "2": p.radius_2 * scale * x.velocity_2 + p.wrap_radius * scale * x.velocity_1,
        }
        muscles = {}
        for i in MUSCLES:
            side = 1.0 if i[1] == "1" else -1.0
            muscles[i] = Muscle(
                i,
                side,
                p.contraction_0 + side * wound[i[0]],
                side * winding[i[0]],
                getattr(x, f"pressure_{i}"),
            )
        return muscles

    def pulls(self, x: Any, p: Any, port: Any) -> dict[str, Expr]:
        """Forces of all muscles, N."""
        return {
            i: pull_of(m, self.static_force, p, _each(port)) for i, m in self.muscles(x, p).items()
        }

    def pressure_rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Expr]:
        """dP/dt of all muscles, Pa/s; the four valve pairs share a supply."""
        muscles, pulls = self.muscles(x, p), self.pulls(x, p, port)
        valves = {}
        for j in JOINTS:
            both = (muscles[f"{j}1"], muscles[f"{j}2"])
            command = port(f"command_{j}", getattr(u, f"command_{j}"))
            valves[f"{j}1"], valves[f"{j}2"] = valves_of(both, command, p, p.vents_open)
        drawn = (valves["11"].drawn + valves["12"].drawn) + (
            valves["21"].drawn + valves["22"].drawn
        )
        return {
            i: pressure_rate(
                muscles[i], valves[i], drawn, pulls[i], p, _each(port), compensator=self.compensator
            )
            for i in MUSCLES
        }

    # ---- links ----------------------------------------------------------------------------------

    def combinations(self, p: Any) -> dict[str, Number]:
        """Combinations of masses, centres and inertias in the equations of motion; p: numbers or
        symbols."""
        inertia = self._inertia(p)
        return {
            "inertia_about_joint_1_kg_m2": inertia.inertia_1,
            "inertia_about_joint_2_kg_m2": inertia.inertia_2,
            "first_moment_1_kg_m": inertia.moment_1,
            "first_moment_2_kg_m": inertia.moment_2,
        }

    @staticmethod
    def _inertia(p: Any) -> _Inertia:
        beyond = p.link_2_mass + p.payload
        return _Inertia(
            p.link_1_inertia
            + p.link_1_mass * p.link_1_centre * p.link_1_centre
            + beyond * p.link_1_length * p.link_1_length,
            p.link_2_inertia
            + p.link_2_mass * p.link_2_centre * p.link_2_centre
            + p.payload * p.link_2_length * p.link_2_length,
            p.link_1_mass * p.link_1_centre + beyond * p.link_1_length,
            p.link_2_mass * p.link_2_centre + p.payload * p.link_2_length,
        )

    def coupling(self, x: Any, p: Any, lever: Expr, about_2: Expr) -> tuple[Expr, Expr]:
        """Of the two joints: M12 (kg m2), none where either is clamped, and what the squares of the
        velocities are weighed by (kg m2). lever: l1 B2; about_2: A2 + l1 B2 cos q2."""
        m12 = about_2 * (1.0 - p.clamped_1) * (1.0 - p.clamped_2)
        return m12, lever * sin(x.angle_2)

    def accelerations(
        self, x: Any, p: Any, port: Any, torque_1: Expr, torque_2: Expr
    ) -> tuple[Expr, Expr]:
        """q'' of both joints under these torques, rad/s2.

        A port `arm` carries what accelerates the inertia about its joint. Where an effect lets a
        share of it swing, that share of the coupling swings along: on the average over it the other
        joint feels what it felt before.
        """
        inertia = self._inertia(p)
        lever, g = inertia.moment_2 * p.link_1_length, GRAVITY_M_S2 * sin(p.plane)
        bent = lever * cos(x.angle_2)
        m11, m22 = inertia.inertia_1 + inertia.inertia_2 + 2.0 * bent, inertia.inertia_2
        m12, swing = self.coupling(x, p, lever, inertia.inertia_2 + bent)
        outer = inertia.moment_2 * g * sin(x.angle_1 + x.angle_2)
        n1 = (
            torque_1
            + swing * (2.0 * x.velocity_1 * x.velocity_2 + x.velocity_2 * x.velocity_2)
            - inertia.moment_1 * g * sin(x.angle_1)
            - outer
        )
        n2 = torque_2 - swing * x.velocity_1 * x.velocity_1 - outer
        det = m11 * m22 - m12 * m12
        a1, a2 = (m22 * n1 - m12 * n2) / det, (m11 * n2 - m12 * n1) / det
        a1 = port("arm_1", m11 * a1, position=x.angle_1, velocity=x.velocity_1, inertia=m11) / m11
        a2 = port("arm_2", m22 * a2, position=x.angle_2, velocity=x.velocity_2, inertia=m22) / m22
        return a1 * (1.0 - p.clamped_1), a2 * (1.0 - p.clamped_2)

    # ---- the rig --------------------------------------------------------------------------------

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        f = self.pulls(x, p, port)
        tension = {j: (f[f"{j}1"] - f[f"{j}2"]) * p.attached for j in JOINTS}
        torque_1 = (
            p.radius_1 * tension["1"]
            + p.wrap_radius * tension["2"]
            - p.viscous_1 * x.velocity_1
            + u.external_torque_1_nm
        )
        torque_2 = p.radius_2 * tension["2"] - p.viscous_2 * x.velocity_2 + u.external_torque_2_nm
        torque_1 = port(
            "joint_1", torque_1, position=x.angle_1, velocity=x.velocity_1, load=f["11"] + f["12"]
        )
        torque_2 = port(
            "joint_2", torque_2, position=x.angle_2, velocity=x.velocity_2, load=f["21"] + f["22"]
        )
        a1, a2 = self.accelerations(x, p, port, torque_1, torque_2)
        return {
            "angle_1": x.velocity_1,
            "angle_2": x.velocity_2,
            "velocity_1": a1,
            "velocity_2": a2,
            **{f"pressure_{i}": rate for i, rate in self.pressure_rates(x, u, p, port).items()},
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        out: dict[str, Number] = {
            "angle_1_deg": port("angle_sensor_1", x.angle_1, rate=x.velocity_1),
            "angle_2_deg": port("angle_sensor_2", x.angle_2, rate=x.velocity_2),
        }
        muscles, rates, pulls = (
            self.muscles(x, p),
            self.pressure_rates(x, u, p, port),
            self.pulls(x, p, port),
        )
        for i, m in muscles.items():
            out[f"contraction_{i}"] = port(f"contraction_sensor_{i}", m.contraction, rate=m.rate)
            out[f"pressure_{i}_kpa"] = port(f"pressure_sensor_{i}", m.gauge, rate=rates[i])
            out[f"force_{i}_n"] = port(f"force_sensor_{i}", pulls[i], rate=0.0)
        return out

    def pose(self, y: Mapping[str, Array], p: Any) -> dict[str, Array]:
        """Base, elbow and tip, seen from the side; both angles zero hang straight down."""
        first = y["angle_1_deg"] - 0.5 * np.pi
        return {
            "arm": chain_of_links(
                [first, first + y["angle_2_deg"]], [p.link_1_length, p.link_2_length]
            )
        }


def _each(port: Any) -> Any:
    """The ports of the muscles' shared equations, a port per muscle here: muscle at 11 is
    muscle_11."""

    def at(name: str, value: Expr, *, place: str, **signals: Any) -> Expr:
        passed: Expr = port(f"{name}_{place}", value, **signals)
        return passed

    return at
