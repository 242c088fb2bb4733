"""Muscles in antagonistic pairs with a fill and a vent valve each: equations that every rig
driven by them shares.

Equations
    muscle       F = max(0, scale F_static(chi, p) - R dchi/dt P), p gauge, P absolute
    pressure     dP/dt = n (P_atm Q - P dV/dt)/V(chi)
    flow         ISO 6358 through opened valves
    compensator  where the muscles have it: dP/dt -= opening smooth_step((F - limit)/blend) vent,
                 the maker's valve against too large a force (the effect `force-compensator`)
    valves       the first muscle stays at p0, only the other is vented: u > 0 fills 1 up to p0,
                 then vents 2; u < 0 mirrored

A rig's parameters bear the names used here (`PARAMETERS`), and its ports those of `port`: valve,
pressure, relief, muscle, chain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, clip, maximum, where
from pamid.model.background import SmoothGain, SplitGain
from pamid.model.force_limit import LIMIT, OPENING, OPENING_SPAN, blown_off
from pamid.model.parameter import Parameter
from pamid.model.rig import Port
from pamid.rigs.muscle import Law, law_with
from pamid.rigs.pneumatics import (
    ATMOSPHERE_PA,
    TEMPERATURE_RATIO,
    VOLUME,
    conductances,
    iso_flow,
    muscle_volume,
    muscle_volume_slope,
)

FILL_BLEND_PA = 10e3  # over which filling hands over to venting as the muscle reaches p0

#: ports of a muscle, from its valve to the joint; those of several muscles have `places` or are kin
MUSCLE_PORTS = {
    "valve": Port(
        "flow",
        "m3/s",
        {"pressure": "Pa", "ratio": "", "drawn": "m3/s", "fill": "", "supply": "Pa", "side": ""},
        size={"value": 2e-3, "pressure": 6e5, "ratio": 1.0, "supply": 7e5},
        general=False,
        called={"drawn": "flow_drawn"},
    ),
    "pressure": Port(
        "rate",
        "Pa/s",
        {"stored": "Pa", "outflow": "Pa/s"},
        size={"value": 1e6, "stored": 5e5},
        general=False,
    ),
    "relief": Port(
        "rate",
        "Pa/s",
        {"force": "N", "outflow": "Pa/s"},
        group="muscle",
        size={"value": 1e6, "force": 700.0},
        general=False,
    ),
    "muscle": Port(
        "actuator-force",
        "N",
        {"position": "", "velocity": "1/s", "pressure": "Pa", "side": "", "law": ""},
        size={"value": 700.0, "position": 0.08, "velocity": 0.2, "pressure": 4e5},
        general=False,
        called={"position": "contraction", "velocity": "contraction_rate"},
    ),
    "chain": Port(
        "transmission",
        "N",
        {"position": "", "pressure": "Pa", "law": "", "drag": "N s"},
        group="structure",
        size={"value": 700.0},
        general=False,
    ),
}


def _sensor(unit: str, **size: float) -> Port:
    return Port("reading", unit, {"rate": f"{unit}/s"}, group="sensor", size=size, general=False)


MUSCLE_SENSORS = {
    "pressure_sensor": _sensor("Pa", value=4e5, rate=1e6),
    "force_sensor": _sensor("N", value=700.0),
}
ANGLE_SENSOR = _sensor("rad", value=0.7, rate=2.0)

LENGTH = Parameter.held("length", 0.250, 0.05, 2.0, "m").with_source("data sheet, nominal length")
SUPPLY_PARAMETERS = (
    Parameter.held("supply_pressure", 600.0, 200.0, 900.0, "kPa").with_source("estimate, gauge"),
    Parameter.held("initial_pressure", 550.0, 0.0, 850.0, "kPa").with_source(
        "first paper's scheme, gauge"
    ),
)
AIR = (
    Parameter.positive("damping", 6e-4, 6e-5, 4e-3, "m2 s", factor=2.0).with_source(
        "estimate, R of eq. 2"
    ),
    Parameter("scale", 1.0, 0.5, 1.6, spread=0.15).with_source(
        "specimens differ from the chart by 10-19 %"
    ),
    Parameter.positive(
        "conductance_in", 3.777e-9, 1e-9, 1e-8, "m3/(s Pa)", factor=1.15
    ).with_source("22.66 l/(min bar), fill valve"),
    Parameter.positive(
        "conductance_out", 3.777e-9, 1e-9, 1e-8, "m3/(s Pa)", factor=1.15
    ).with_source("22.66 l/(min bar), vent valve"),
    Parameter("critical_ratio", 0.433, 0.1, 0.6, spread=0.08).with_source(
        "literature on the same valves"
    ),
    Parameter("polytropic", 1.0, 1.0, 1.4, spread=0.2).with_source(
        "1: isothermal, eq. 3 of the first paper"
    ),
    TEMPERATURE_RATIO,
)
ATTACHING = (
    Parameter("contraction_0", 0.10, 0.05, 0.15, spread=0.005).with_source(
        "estimate, both muscles at p0"
    ),
    Parameter("dead_volume", 5.0, 0.0, 20.0, "cm3", spread=4.0).with_source(
        "estimate, tube and fittings"
    ),
    *VOLUME,
)

#: of muscles with the maker's force compensator: held, as the effect's data sheet has them
COMPENSATOR = tuple(
    replace(q, name=f"compensator_{q.name}", null=None, fitted=False)
    for q in (OPENING, LIMIT, OPENING_SPAN)
)

WARMING_S = 60.0  # until a muscle has drifted by half of what it will: estimate


def joint_ports(
    joint: str, arm: str, size: dict[str, float], group: str = "structure"
) -> dict[str, Port]:
    """The torque at a joint, and what of it accelerates the inertia about it (arm)."""
    turn = {"position": "rad", "velocity": "rad/s"}
    turning = {name: usual for name, usual in size.items() if name != "load"}
    return {
        joint: Port("motion", "N m", {**turn, "load": "N"}, size=size, general=False),
        arm: Port(
            "transmission",
            "N m",
            {**turn, "inertia": "kg m2"},
            group=group,
            size=turning,
            general=False,
        ),
    }


def force_map(name: str = "force_map") -> SmoothGain:
    """Tolerance of a specimen's force map."""
    return SmoothGain(
        name,
        ("position", 0.0, 0.20),
        tolerance=0.03,
        degree=8,
        along=("pressure", 0.0, 6e5),
        level=True,
        drift=True,
        warming_s=WARMING_S,
    )


def flow_tolerance(name: str = "flow") -> SplitGain:
    """Tolerance of a valve's conductances, filling and venting."""
    return SplitGain(name, tolerance=0.05)


@dataclass(frozen=True)
class Muscle:
    """A muscle in the equations: its place at the ports, its side of the joint (+1 pulls
    forwards), its contraction (1) and contraction rate (1/s), its absolute pressure (Pa)."""

    place: str
    side: float
    contraction: Expr
    rate: Expr
    pressure: Expr

    @property
    def gauge(self) -> Expr:
        return self.pressure - ATMOSPHERE_PA


def pull_of(m: Muscle, static_force: Law, p: Any, port: Any) -> Expr:
    """Force of a muscle, N. static_force: a law, whose coefficients are taken from p where it has
    any."""
    static_pull = law_with(static_force, p)

    def law(contraction: Expr, pressure: Expr) -> Expr:
        return p.scale * static_pull(contraction, pressure)

    gauge = m.gauge
    drag = p.damping * m.pressure
    pull = law(m.contraction, gauge) - drag * m.rate
    pull = port(
        "muscle",
        pull,
        place=m.place,
        position=m.contraction,
        velocity=m.rate,
        pressure=gauge,
        side=m.side,
        law=law,
    )
    pull = port(
        "chain", pull, place=m.place, position=m.contraction, pressure=gauge, law=law, drag=drag
    )
    return maximum(0.0, pull)


@dataclass(frozen=True)
class Valves:
    """The valves of a muscle: flow in (m3/s at atmospheric conditions, negative out), whether the
    muscle is being filled, how far its fill valve is open, downstream over upstream pressure."""

    flow: Expr
    fills: Expr
    opening: Expr
    ratio: Expr

    @property
    def drawn(self) -> Expr:
        """Flow taken from the supply, m3/s."""
        return maximum(self.flow, 0.0)


def valves_of(
    pair: tuple[Muscle, Muscle], command: Expr, p: Any, vented: Number = 0.0
) -> tuple[Valves, Valves]:
    """The valves of both muscles of a joint at a command; vented: 1 where both vent valves stand
    open whatever is sent."""
    size, (inwards, outwards) = absolute(command), conductances(p)
    supply, hold = p.supply_pressure + ATMOSPHERE_PA, p.initial_pressure + ATMOSPHERE_PA
    share1, share2 = (clip((hold - m.pressure) / FILL_BLEND_PA, 0.0, 1.0) for m in pair)
    valves = []
    for m, fills, share, other in (
        (pair[0], command > 0.0, share1, share2),
        (pair[1], command < 0.0, share2, share1),
    ):
        up, down = where(fills, supply, m.pressure), where(fills, m.pressure, ATMOSPHERE_PA)
        opening = where(fills, size * share * inwards, -size * (1.0 - other) * outwards)
        flow = opening * iso_flow(up, down, p.critical_ratio)
        ambient = iso_flow(ATMOSPHERE_PA, m.pressure, p.critical_ratio) - iso_flow(
            m.pressure, ATMOSPHERE_PA, p.critical_ratio
        )
        valves.append(Valves(flow + vented * outwards * ambient, fills, size * share, down / up))
    return valves[0], valves[1]


def pressure_rate(
    m: Muscle,
    valves: Valves,
    drawn: Expr,
    force: Expr,
    p: Any,
    port: Any,
    *,
    compensator: bool = False,
) -> Expr:
    """dP/dt of a muscle, Pa/s. drawn: flow taken from the supply by all valves that share it;
    compensator: the muscle has it, and p holds COMPENSATOR."""
    supply, (inwards, outwards) = p.supply_pressure + ATMOSPHERE_PA, conductances(p)

    def fill(at_supply: Expr) -> Expr:
        through = valves.opening * inwards * iso_flow(at_supply, m.pressure, p.critical_ratio)
        return where(valves.fills, through, 0.0)

    flow = port(
        "valve",
        valves.flow,
        place=m.place,
        pressure=m.pressure,
        ratio=valves.ratio,
        drawn=drawn,
        fill=fill,
        supply=supply,
        side=m.side,
    )
    volume = muscle_volume(m.contraction, p)
    vent = (
        p.polytropic
        * ATMOSPHERE_PA
        * outwards
        / volume
        * iso_flow(m.pressure, ATMOSPHERE_PA, p.critical_ratio)
    )
    change = (
        p.polytropic
        * (ATMOSPHERE_PA * flow - m.pressure * muscle_volume_slope(m.contraction, p) * m.rate)
        / volume
    )
    change = port("pressure", change, place=m.place, stored=m.pressure, outflow=vent)
    if compensator:
        change = blown_off(
            change, force, vent, p.compensator_opening, p.compensator_limit, p.compensator_blend
        )
    return port("relief", change, place=m.place, force=force, outflow=vent)
