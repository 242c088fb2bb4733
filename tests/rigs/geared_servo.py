"""A servo that swings a weight.

What it is
    A motor with a position loop of its own behind a gear, and a rod with a weight on its shaft.
Equations
    (armature + inertia) q'' = kp (target - q) - kv q' - weight sin q, through the gear.
Typically missing
    Play or softness of the gear, with the encoder on either side of it.
References
    Nordin, Gutman (2002), Automatica 38(10), 1633-1649.
"""

from dataclasses import dataclass, replace

from pamid import Parameter, Port, Rig, State
from pamid.equations import Expr, sin

WEIGHT_NM, INERTIA_KG_M2 = 0.6, 0.02


@dataclass(frozen=True)
class Carried:
    """What the gear drives; as in `pamid.model.outboard`."""

    torque: Expr
    inertia: Expr
    carried: float
    free_fall: Expr
    usual: float = INERTIA_KG_M2


class GearedServo(Rig):
    """One joint, whose gear offers what it drives and what drives it."""

    inputs = {"target_rad": "rad"}
    outputs = {"encoder_rad": "rad"}
    ports = {
        "gear": Port(
            "transmission",
            "N m",
            {
                "position": "rad",
                "velocity": "rad/s",
                "inertia": "kg m2",
                "free_fall": "rad/s2",
                "behind": "",
                "driven": "",
            },
        ),
        "encoder": Port("reading", "rad"),
    }
    states = (State("angle", "rad"), State("rate", "rad/s"))
    parameters = (
        Parameter(
            "armature", 0.01, 0.002, 0.05, "kg m2", spread=1.3, log=True, source="data sheet"
        ),
        Parameter("kp", 6.0, 1.0, 30.0, "N m/rad", spread=1.3, log=True, source="data sheet"),
        Parameter("kv", 0.3, 0.05, 2.0, "N m s/rad", spread=1.3, log=True, source="data sheet"),
    )
    noise = {"encoder_rad": 1e-4}
    excited = {"target_rad": 0.6}
    period_s = 0.004

    def rates(self, x, u, p, port):
        def driven(angle, rate):
            return p.kp * angle + p.kv * rate

        def carried(angle):
            weight = -WEIGHT_NM * sin(x.angle + angle)
            inertia = p.armature + INERTIA_KG_M2
            torque = p.kp * (u.target_rad - x.angle) - p.kv * x.rate + weight
            return Carried(torque, inertia, INERTIA_KG_M2, weight / INERTIA_KG_M2)

        here = carried(0.0)

        def behind(torque, angle, rate):
            there = carried(angle)
            return replace(there, torque=there.torque + (torque - here.torque))

        torque = port(
            "gear",
            here.torque,
            position=x.angle,
            velocity=x.rate,
            inertia=here.inertia,
            free_fall=here.free_fall,
            behind=behind,
            driven=driven,
        )
        return {"angle": x.rate, "rate": torque / here.inertia}

    def measure(self, x, u, p, port):
        return {"encoder_rad": port("encoder", x.angle)}
