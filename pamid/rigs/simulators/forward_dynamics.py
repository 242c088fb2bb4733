"""Accelerations of a tree under forces, friction and couplings, with implicit derivatives.

Differentiating the algorithm would be longer than necessary. Along a solution the inverse dynamics
ID(q, q', q'', p) = force stays true, so that

    dq'' = M^-1 (dforce - dID)      at q'' held

and the partials of ID have a closed form in the composites (Singh, Russell and Wensing 2022, IEEE
Robot. Autom. Lett. 7(2), 1760-1767), about as long as ID itself. The derivative of ID by a mass is
the force on that body per mass.
"""

from __future__ import annotations

from functools import lru_cache

from pamid.engine.symbolic.vocabulary import ZERO, Expr, held, tangent
from pamid.rigs.simulators.soft_constraints import (
    CoupledSystem,
    SoftCoupling,
    SoftFriction,
    solve_joint_friction,
)
from pamid.rigs.simulators.tree_dynamics import Tree

MODELS_ALIKE = 64  # trees and accelerations that are kept for models in which they are the same


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
