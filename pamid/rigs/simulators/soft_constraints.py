"""Accelerations of a tree, with friction losses and couplings as in MuJoCo.

At a joint with a loss, MuJoCo computes the force f, |f| <= loss, that comes nearest to stopping it.
Below the loss,

    f = -(q'' + rate q') / softness

so that the joint does not stick but creeps (documentation, Computation, Constraint model, friction
loss). The joints are coupled through q''. A few sweeps of projected Gauss-Seidel over the forces
determine the joints at their loss. Then f adds 1 / softness to the inertia of a creeping joint and
is constant at a sliding joint, and q'' follows exactly. It is solved for twice, because the first
solution still moves joints across zero.

A coupling with the error r, whose slopes by the positions are J, exerts J' f with

    f = (-rate J q' - stiffness d(r) r - J q'') / softness

(the same chapter, equality). Its impedance d(r) lies between 0 and 1; the softness is (1 - d) / d
times an inverse inertia. The couplings are few: they are solved for by the Woodbury identity on the
factors of M.

The derivatives of the accelerations are implicit, because differentiating the algorithm would be
longer than necessary. Along a solution the inverse dynamics ID(q, q', q'', p) = force stays true,
so that

    dq'' = M^-1 (dforce - dID)      at q'' held

and the partials of ID have a closed form in the composites (Singh, Russell and Wensing 2022, IEEE
Robot. Autom. Lett. 7(2), 1760-1767), about as long as ID itself. The derivative of ID by a mass is
the force on that body per mass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

from pamid.engine.symbolic.vocabulary import (
    ZERO,
    Expr,
    absolute,
    clip,
    exp,
    expression,
    held,
    log,
    maximum,
    tangent,
    where,
)
from pamid.rigs.simulators.tree_dynamics import Factors, Tree

SWEEPS, SOLVES = 4, 2  # of several joints; a single joint needs no iteration
LEAST_IMPEDANCE, LARGEST_IMPEDANCE = 1e-4, 0.9999
LEAST_SOFTNESS = 1e-15
MODELS_ALIKE = 64  # trees and accelerations that are kept for models in which they are the same


@dataclass(frozen=True)
class SoftFriction:
    """Friction of a joint.

    loss: N m or N; rate: 1/s; softness: 1/(kg m2) or 1/kg; velocity of the joint.
    """

    loss: Expr
    rate: float
    softness: Expr
    velocity: Expr


@dataclass(frozen=True, eq=False)
class SoftCoupling:
    """slopes: J by joint; aim: the J q'' without a force; softness."""

    slopes: Mapping[int, Expr]
    aim: Expr
    softness: Expr

    def force(self, qdd: Sequence[Expr]) -> Expr:
        """Force along the coupling at these accelerations."""
        return (self.aim - self.along(qdd)) / self.softness

    def along(self, of: Sequence[Expr], more: Expr = ZERO) -> Expr:
        """J times values of the joints, and more."""
        return sum((slope * of[j] for j, slope in self.slopes.items()), more)


def impedance(shape: Sequence[float], error: Expr) -> Expr:
    """d(r) for (at no error, at a width, the width, midpoint, power): MuJoCo's solimp
    (documentation, Modeling, Solver parameters, Impedance)."""
    low, high = (min(max(v, LEAST_IMPEDANCE), LARGEST_IMPEDANCE) for v in shape[:2])
    width, power = shape[2], max(shape[4], 1.0)
    middle = min(max(shape[3], LEAST_IMPEDANCE), LARGEST_IMPEDANCE)
    if low == high or width <= LEAST_SOFTNESS:
        return expression(0.5 * (low + high))
    share = clip(absolute(error) / width, 0.0, 1.0)
    if power > 1.0:
        near = _power(share, power) / middle ** (power - 1.0)
        far = 1.0 - _power(1.0 - share, power) / (1.0 - middle) ** (power - 1.0)
        share = where(share <= middle, near, far)
    return low + share * (high - low)


def _power(base: Expr, power: float) -> Expr:
    if power == int(power):
        product = base
        for _ in range(int(power) - 1):
            product = product * base
        return product
    return exp(power * log(maximum(base, 1e-12)))


class CoupledSystem:
    """M q'' = force of a tree with couplings, with an optional addition to the diagonal of M."""

    def __init__(
        self,
        tree: Tree,
        couplings: Sequence[SoftCoupling] = (),
        added: Sequence[Expr] | None = None,
    ) -> None:
        self.tree, self.couplings = tree, couplings
        self.factors: Factors = tree.factors if added is None else tree.factored(added)

    def column(self, i: int) -> list[Expr]:
        """Change of q'' with the force at a joint."""
        force = [expression(1.0 if k == i else 0.0) for k in range(self.tree.n)]
        return self.accelerations(force, aimed=False)

    def accelerations(self, force: Sequence[Expr], *, aimed: bool = True) -> list[Expr]:
        """q'' under this force and that of the couplings.

        aimed: False for couplings with zero aim: (M + J' J / softness)^-1 force.
        """
        free = self.tree.solve(self.factors, force)
        if not self.couplings:
            return free
        right = [(c.aim if aimed else ZERO) - c.along(free) for c in self.couplings]
        force = _solved_dense(self._reduced, right)
        accelerations = list(free)
        for f, reach in zip(force, self._reach, strict=True):
            accelerations = [a + f * r for a, r in zip(accelerations, reach, strict=True)]
        return accelerations

    @cached_property
    def _reach(self) -> list[list[Expr]]:
        """M^-1 J', a row for each coupling."""
        n = self.tree.n
        return [
            self.tree.solve(self.factors, [c.slopes.get(j, ZERO) for j in range(n)])
            for c in self.couplings
        ]

    @cached_property
    def _reduced(self) -> list[list[Expr]]:
        """J M^-1 J' + softness."""
        return [
            [c.along(reach, c.softness if i == k else ZERO) for i, reach in enumerate(self._reach)]
            for k, c in enumerate(self.couplings)
        ]


def _solved_dense(matrix: Sequence[Sequence[Expr]], right: Sequence[Expr]) -> list[Expr]:
    """Gaussian elimination of a positive definite system, which needs no pivots."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    n = len(rows)
    for k in range(n):
        for i in range(k + 1, n):
            share = rows[i][k] / rows[k][k]
            rows[i] = [a - share * b if c > k else ZERO for c, (a, b) in
                       enumerate(zip(rows[i], rows[k], strict=True))]  # fmt: skip
    solution: list[Expr] = [ZERO] * n
    for k in reversed(range(n)):
        rest = rows[k][n]
        for j in range(k + 1, n):
            rest = rest - rows[k][j] * solution[j]
        solution[k] = rest / rows[k][k]
    return solution


def solve_joint_friction(
    system: CoupledSystem, reaching: Sequence[Expr], friction: Sequence[SoftFriction | None]
) -> tuple[list[Expr], list[Expr], list[Expr], CoupledSystem]:
    """Accelerations q'', inertia that creeping joints add, friction left, system with the addition.

    reaching: force at each joint without friction, less the bias (n,); friction: that of each
    joint, None without a loss.
    """
    none = [ZERO] * system.tree.n
    value = system.accelerations(reaching)
    where_ = {i: f for i, f in enumerate(friction) if f is not None}
    if not where_:
        return value, none, none, system
    aims = _gauss_seidel(system, value, where_)
    added, more, loaded = none, none, system
    for _ in range(SOLVES if len(where_) > 1 else 1):
        added, more = list(none), list(none)
        for i, f in where_.items():
            creeps = absolute(aims[i]) < f.softness * f.loss
            slides = where(aims[i] > 0.0, -f.loss, f.loss)
            added[i] = where(creeps, 1.0 / f.softness, 0.0)
            more[i] = where(creeps, -(f.rate / f.softness) * f.velocity, slides)
        loaded = CoupledSystem(system.tree, system.couplings, added)
        value = loaded.accelerations([r + m for r, m in zip(reaching, more, strict=True)])
        aims = {i: value[i] + f.rate * f.velocity for i, f in where_.items()}
    return value, added, more, loaded


def _gauss_seidel(
    system: CoupledSystem, free: list[Expr], friction: dict[int, SoftFriction]
) -> dict[int, Expr]:
    """Projected Gauss-Seidel: q'' + rate q' of each joint from its friction force."""
    columns = {i: system.column(i) for i in friction}
    a = {i: free[i] for i in friction}
    force: dict[int, Expr] = dict.fromkeys(friction, ZERO)
    order = list(friction)
    for _ in range(SWEEPS if len(friction) > 1 else 1):
        for i in order:
            f = friction[i]
            aim = a[i] + f.rate * f.velocity + f.softness * force[i]
            new = clip(force[i] - aim / (columns[i][i] + f.softness), -f.loss, f.loss)
            change = new - force[i]
            for j in friction:
                a[j] = a[j] + columns[i][j] * change
            force[i] = new
        order.reverse()
    # at the loss the aim is placed beyond it, because only its sign counts
    slopes = {}
    for i, f in friction.items():
        reached = absolute(force[i]) >= f.loss
        slopes[i] = where(reached, -2.0 * f.softness * force[i], -f.softness * force[i])
    return slopes


@lru_cache(maxsize=MODELS_ALIKE)
def accelerations(
    tree: Tree,
    force: tuple[Expr, ...],
    passed: tuple[Expr | None, ...],
    friction: tuple[SoftFriction | None, ...],
    couplings: tuple[SoftCoupling, ...] = (),
) -> list[Expr]:
    """q'' (n,) under these forces, with its exact derivatives.

    Models that differ in their readings alone share it, so that it is built once.

    force: at each joint, without c and friction; passed: force that reaches a joint, if it is not
    force - c but derived from `force - tree.holding`, otherwise None.
    """
    reaching = [
        f - c if p is None else p for f, c, p in zip(force, tree.holding, passed, strict=True)
    ]
    value, added, rubbing, system = solve_joint_friction(
        CoupledSystem(tree, couplings), reaching, friction
    )
    still = [held(v) for v in value]
    moving = tree.inverse_dynamics(still)
    change = []
    for i in range(tree.n):
        diagonal = moving[i] + still[i] * (tree.armature[i] + added[i]) - rubbing[i]
        if passed[i] is None:
            change.append(diagonal - force[i])
        else:
            change.append(diagonal - tree.bias_change[i] - reaching[i])
    for coupling in couplings:
        force_along = coupling.force(still)
        for j, slope in coupling.slopes.items():
            change[j] = change[j] - slope * force_along
    inverse = [system.column(i) for i in range(tree.n)]
    return [
        tangent(value[i], -sum((held(inverse[j][i]) * c for j, c in enumerate(change)), ZERO))
        for i in range(tree.n)
    ]
