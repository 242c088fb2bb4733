"""A single muscle against a mass: equation 1 of the first paper, by itself.

What it is
    A fluidic muscle hangs from a frame and lifts a mass on a vertical guide; a fill and a vent
    valve feed it. A muscle without a joint or an antagonist: what is wrong with its force, its
    damping or its air shows here first, and nothing else can be the cause.

Equations
    mass         m dv/dt = F - m g - b v + external force, upwards positive; m: what hangs there,
                 with half of the muscle's mass
    contraction  chi = chi0 + position/L0
    muscle       F = max(0, scale F_static(chi, p) - R dchi/dt P), p gauge, P absolute: eq. 1 and 2
    pressure     dP/dt = n (P_atm Q - P dV/dt)/V(chi), V a cubic of chi: eq. 3 and 4
    flow         ISO 6358 through the opened valve: eq. 5; command > 0 fills, < 0 vents

Typically missing
    Hysteresis and creep of the muscle, a pressure below which it does not pull (muscle); dry
    friction of the guide, an end stop (guide); a leak, heat of the air (pressure); a valve with a
    dead band, dead time (command); a supply that sags, a long tube (valve).

References
    Hosovsky, Mizakova, Pitel, the first paper of `docs/project/references.md`; Kerscher, Albiez,
    Zollner, Dillmann (2006), Evaluation of the dynamic model of fluidic muscles using
    quick-release, IEEE/RAS-EMBS Int. Conf. Biomedical Robotics and Biomechatronics, 637-642.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, where
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Loop, Port, Rig
from pamid.rigs import antagonists as pair
from pamid.rigs.antagonists import Muscle, Valves, pressure_rate, pull_of
from pamid.rigs.muscle import LAWS, StaticForce, law_named
from pamid.rigs.muscle_experiments import EXPERIMENTS
from pamid.rigs.pneumatics import ATMOSPHERE_PA, conductances, iso_flow

GRAVITY_M_S2 = 9.81
MUSCLE_SIDE = 1.0  # the side of the only muscle


def _without_side(signals: Any) -> dict[str, Any]:
    """Signals of a port without the side: there is no pair of muscles."""
    return {name: symbol for name, symbol in signals.items() if name != "side"}


class MuscleMass(Rig):
    """A muscle lifts a mass: valve command in, position, pressure and force out."""

    name = "muscle-mass"
    inputs = {"command": "", "external_force_n": "N"}
    optional = {"external_force_n": 0.0}
    outputs = {"position_mm": "m", "pressure_kpa": "Pa", "force_n": "N"}
    ports = {
        "command": Port("command", "", size={"value": 1.0}, general=False),
        **{
            name: replace(port, signals=_without_side(port.signals))
            for name, port in pair.MUSCLE_PORTS.items()
        },
        "guide": Port(
            "motion",
            "N",
            {"position": "m", "velocity": "m/s", "load": "N"},
            size={"value": 100.0, "velocity": 0.1, "position": 0.02, "load": 400.0},
        ),
        "position_sensor": Port(
            "reading", "m", {"rate": "m/s"}, group="sensor", size={"value": 0.02, "rate": 0.1}
        ),
        "pressure_sensor": pair.MUSCLE_SENSORS["pressure_sensor"],
        "force_sensor": replace(pair.MUSCLE_SENSORS["force_sensor"], size={"value": 400.0}),
    }
    states = (State("position", "m"), State("velocity", "m/s"), State("pressure", "Pa"))
    parameters = (
        Parameter.held("mass", 40.0, 0.5, 200.0, "kg").with_source("weighed, m of eq. 1"),
        Parameter("viscous", 20.0, 0.0, 500.0, "N s/m", spread=20.0).with_source(
            "estimate, linear guide"
        ),
        pair.LENGTH,
        pair.SUPPLY_PARAMETERS[0],
        Parameter.held("initial_pressure", 352.3, 0.0, 850.0, "kPa").with_source(
            "holds 40 kg at contraction 0.10 by the exponential law, gauge"
        ),
        *pair.AIR,
        *pair.ATTACHING,
    )
    background = {"muscle": pair.force_map(), "valve": pair.flow_tolerance()}
    loops = (Loop("command", "reference_mm", "position_mm"),)
    controller = {
        "kp_per_mm": 0.10,
        "kd_s_per_mm": 0.003,
        "derivative_filter_s": 0.006,
        "command_limit": 1.0,
    }
    noise = {"position_mm": 0.02, "pressure_kpa": 1.0, "force_n": 1.0}
    period_s = 0.003
    excited = {"reference_mm": 15.0, "command": 0.3}
    experiments = EXPERIMENTS
    changeable = {"mass_kg": 20.0}
    actuators = {"muscle": ("command", 1.0)}
    variants = tuple(LAWS)
    static_force = StaticForce()

    def __init__(self, law: str = "exponential") -> None:
        self.static_force = law_named(law)

    def start(self, p: Any) -> dict[str, float]:
        """Let go at position 0 with the muscle at its initial pressure."""
        return {"pressure": p.initial_pressure + ATMOSPHERE_PA}

    def muscle(self, x: Any, p: Any) -> Muscle:
        """The muscle where the mass has taken it."""
        return Muscle(
            "",
            MUSCLE_SIDE,
            p.contraction_0 + x.position / p.length,
            x.velocity / p.length,
            x.pressure,
        )

    def pull(self, x: Any, p: Any, port: Any) -> Expr:
        """Force of the muscle, N."""
        return pull_of(self.muscle(x, p), self.static_force, p, _muscle_port(port))

    def pressure_rate(self, x: Any, u: Any, p: Any, port: Any) -> Expr:
        """dP/dt, Pa/s."""
        command = port("command", u.command)
        fills, size, (inwards, outwards) = command > 0.0, absolute(command), conductances(p)
        up = where(fills, p.supply_pressure + ATMOSPHERE_PA, x.pressure)
        down = where(fills, x.pressure, ATMOSPHERE_PA)
        opening = where(fills, size * inwards, -size * outwards)
        flow = opening * iso_flow(up, down, p.critical_ratio)
        valves = Valves(flow, fills, size, down / up)
        pull = self.pull(x, p, port)
        return pressure_rate(self.muscle(x, p), valves, valves.drawn, pull, p, _muscle_port(port))

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        pull, weight = self.pull(x, p, port), p.mass * GRAVITY_M_S2
        force = pull - weight - p.viscous * x.velocity + u.external_force_n
        force = port("guide", force, position=x.position, velocity=x.velocity, load=weight)
        return {
            "position": x.velocity,
            "velocity": force / p.mass,
            "pressure": self.pressure_rate(x, u, p, port),
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        rate = self.pressure_rate(x, u, p, port)
        return {
            "position_mm": port("position_sensor", x.position, rate=x.velocity),
            "pressure_kpa": port("pressure_sensor", x.pressure - ATMOSPHERE_PA, rate=rate),
            "force_n": port("force_sensor", self.pull(x, p, port), rate=0.0),
        }

    def pose(self, y: Mapping[str, Array], p: Any) -> dict[str, Array]:
        """The muscle from the frame down to the mass, seen from the side."""
        lift = y["position_mm"]
        end = np.stack([np.zeros_like(lift), lift], axis=1)
        return {"muscle": np.stack([np.zeros_like(end) + [0.0, p.length], end], axis=1)}


def _muscle_port(port: Any) -> Any:
    """The ports of the shared equations, which name the muscle that they are about."""

    def at(name: str, value: Expr, *, place: str, **signals: Any) -> Expr:
        passed: Expr = port(name, value, **_without_side(signals))
        return passed

    return at
