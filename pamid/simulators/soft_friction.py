"""Friction losses as MuJoCo has them, solved together with the accelerations.

At a joint with a loss, MuJoCo looks for the force f, |f| <= loss, that comes nearest to stopping
it: where the loss is not reached,

    f = -(q'' + rate q') / softness

so that the joint does not stick but creeps (documentation, Computation, Constraint model, friction
loss). What the joints do is coupled through q''. Which of them have reached their loss is found by
a few sweeps of projected Gauss-Seidel over the forces; with that known, f adds 1 / softness to the
inertia of a joint that creeps and is a constant at one that slides, and q'' follows exactly. It is
solved for twice: the first one still moves joints from one side to the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pamid.simulators.tree_dynamics import Factors, Tree
from pamid.symbolic.vocabulary import ZERO, Expr, absolute, clip, where

SWEEPS, SOLVES = 4, 2  # of several joints; a single one is found at once


@dataclass(frozen=True)
class SoftFriction:
    """loss: N m or N; rate: 1/s, softness: 1/(kg m2) or 1/kg, as above; velocity of the joint."""

    loss: Expr
    rate: float
    softness: float
    velocity: Expr


@dataclass(frozen=True)
class Rubbed:
    """q'' (value), what creeping joints have more of inertia (added), the rest of their friction
    force (friction), and the factors of M with what is added."""

    value: list[Expr]
    added: list[Expr]
    friction: list[Expr]
    factors: Factors


def rub(tree: Tree, reaching: Sequence[Expr], friction: Sequence[SoftFriction | None]) -> Rubbed:
    """Accelerations under what reaches each joint and friction; see above."""
    none, factors = [ZERO] * tree.n, tree.factors
    value = tree.solve(factors, reaching)
    where_ = {i: f for i, f in enumerate(friction) if f is not None}
    if not where_:
        return Rubbed(value, none, none, factors)
    aims = _swept(tree, factors, value, where_)
    found = Rubbed(value, none, none, factors)
    for _ in range(SOLVES if len(where_) > 1 else 1):
        found = _solved(tree, reaching, where_, aims)
        aims = {i: found.value[i] + f.rate * f.velocity for i, f in where_.items()}
    return found


def _swept(
    tree: Tree, factors: Factors, free: list[Expr], friction: dict[int, SoftFriction]
) -> dict[int, Expr]:
    """Projected Gauss-Seidel: q'' + rate q' of each joint as its friction force says it."""
    columns = {i: tree.unit(factors, i) for i in friction}
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
    # beyond what the loss allows where it was reached: the side of it is all that counts
    found = {}
    for i, f in friction.items():
        reached = absolute(force[i]) >= f.loss
        found[i] = where(reached, -2.0 * f.softness * force[i], -f.softness * force[i])
    return found


def _solved(
    tree: Tree,
    reaching: Sequence[Expr],
    friction: dict[int, SoftFriction],
    aims: dict[int, Expr],
) -> Rubbed:
    added, more = [ZERO] * tree.n, [ZERO] * tree.n
    for i, f in friction.items():
        creeps = absolute(aims[i]) < f.softness * f.loss
        slides = where(aims[i] > 0.0, -f.loss, f.loss)
        added[i] = where(creeps, 1.0 / f.softness, 0.0)
        more[i] = where(creeps, -(f.rate / f.softness) * f.velocity, slides)
    factors = tree.factored(added)
    value = tree.solve(factors, [r + m for r, m in zip(reaching, more, strict=True)])
    return Rubbed(value, added, more, factors)
