"""Load behind a joint: the part of effects that let a load move against its drive by a twist t, a
share of its inertia J on the far side,

    J q'' = T_out, T_out = (T + share J pull) / (1 - share), t'' = -pull - T_out/J

where pull is what the far side exerts on the joint per unit of its inertia, less the acceleration
g with which it would fall if it were let go: `free_fall` of the port, 0 where it offers none.

A port may offer `behind` instead, a function of T, the angle by which the far side is turned
against the joint, and the rate of that angle. It returns what holds in that pose, as attributes:
`torque` that passes, the `inertia` J that it moves, of which `carried` is the joint's load without
its motor, the load's `free_fall`, and its `usual` size. The share is then that of the load, of
which what is not on the far side turns with the motor; the angle is share t, which is exact where
nothing or all of the load is on the far side, and to the first order of t between. Pull is given
for the usual load: what springs has the same stiffness in all poses.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from pamid.engine.symbolic.vocabulary import ZERO, Expr, expression
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter

LOAD_SHARE = Parameter.share("share", 0.6, 0.0, 0.95, spread=0.35, tries=(0.85,)).with_source(
    "load behind the joint: 0.5-0.92 of the inertia"
)
CARRIED_SHARE = replace(
    LOAD_SHARE,
    value=0.9,
    high=1.0,
    tries=(0.5, 1.0),
    source="of what the joint carries: all of it, or what is not fixed to the motor",
)


@dataclass(frozen=True)
class Outboard:
    """The two sides of a port: torque that reaches them, their inertia, the share of it on the far
    side, the acceleration of that side let go, and the ratio of its usual to its present size."""

    torque: Expr
    inertia: Expr
    share: Expr
    free_fall: Expr
    usual: Expr

    def moved(self, pull: Expr) -> tuple[Expr, Expr]:
        """Torque that accelerates the whole inertia as the joint moves, and the acceleration of the
        twist.

        pull: what the far side exerts on the joint, per unit of its usual inertia (rad/s2 or m/s2).
        """
        pull = self.usual * pull - self.free_fall
        total = (self.torque + self.share * self.inertia * pull) / (1.0 - self.share)
        return total, -pull - total / self.inertia


class OutboardEffect(Effect):
    """Base of effects by which a load moves against its drive; their states are `twist` and
    `twisting`, its rate."""

    family = "flexible-transmission"
    kinds = ("transmission",)
    states = (State("twist", "rad"), State("twisting", "rad/s"))

    @classmethod
    def parameters_at(cls, kind: str, offered: Collection[str] = ()) -> tuple[Parameter, ...]:
        """The parameters, with the share of the carried load where the port offers it."""
        parameters = super().parameters_at(kind, offered)
        if "behind" not in offered:
            return parameters
        return tuple(CARRIED_SHARE if p is LOAD_SHARE else p for p in parameters)

    def outboard(self, torque: Expr, at: Any, share: Expr, z: Any, turned: bool = True) -> Outboard:
        """The two sides of a port under this torque, with the twist in the states z.

        turned: whether the load stands turned against the port's position, which is the near
        side's then.
        """
        if at.offers("behind"):
            angle = (share * z.twist, share * z.twisting) if turned else (ZERO, ZERO)
            there = at.behind(torque, *angle)
            return Outboard(
                there.torque,
                there.inertia,
                share * there.carried / there.inertia,
                there.free_fall,
                there.usual / there.carried,
            )
        falling = at.free_fall if at.offers("free_fall") else ZERO
        return Outboard(torque, at.inertia, share, falling, expression(1.0))
