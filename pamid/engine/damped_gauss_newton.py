"""Nonlinear least squares by damped Gauss-Newton steps (Levenberg-Marquardt).

With residuals r(x), Jacobian J and cost |r|^2, a step d from x solves

    (J'J + lambda diag(J'J)) d = -J'r

(Marquardt's scaling: d does not depend on the units of x). A step that lowers the cost is taken,
and lambda falls: the next step is closer to Gauss-Newton's. Any other step is rejected, and lambda
rises: the next step is shorter and turns to steepest descent.

Marquardt (1963), SIAM J. Appl. Math. 11(2), 431-441; Nocedal and Wright (2006), Numerical
Optimization, 2nd ed., ch. 10.3. Multiple shooting (estimation), initial states (simulation) and the
smoother (diagnosis) share this iteration. They differ in their points, in the solution for the step
(dense, or bordered block-tridiagonal), in bounds and in the criterion of their end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

CALM_STEPS = 2  # in a row end an iteration


class HasCost(Protocol):
    @property
    def cost(self) -> float: ...


Point = TypeVar("Point", bound=HasCost)
Step = TypeVar("Step")


@dataclass(frozen=True)
class DampingRule:
    """Schedule of lambda: start, factors of its fall and rise, and bounds. raised: least value
    after a failed step."""

    start: float
    falls: float
    least: float
    rises: float
    most: float = float("inf")
    raised: float = 0.0


class LeastSquares(ABC, Generic[Point, Step]):
    """A problem: how its points cost, how a step is solved for, and when it is settled."""

    rule: DampingRule

    @abstractmethod
    def step(self, at: Point, damping: float) -> Step | None:
        """The damped step within the bounds; None where the normal equations are not finite."""

    @abstractmethod
    def moved(self, at: Point, step: Step, last: bool) -> Point:
        """The point behind a step, with its cost (inf or NaN where the model cannot be run). last:
        no further step follows."""

    def linearised(self, at: Point, last: bool) -> Point:
        """A point that lowers the cost, with the normal equations that `moved` may leave out; its
        cost is inf or NaN where they are not finite."""
        return at

    def counts(self, before: Point, trial: Point) -> bool:
        """Whether a step counts against the limit. A rejected step may be so cheap, and the gain of
        one that is taken so large, that it does not."""
        return True

    def settled(self, gain: float, before: Point, after: Point) -> bool:
        """Whether the gain of the step taken is too small for another step."""
        return False

    def calm(self, step: Step, damping: float) -> bool:
        """Whether the step is so short that two such in a row end the iteration."""
        return False

    def stuck(self, at: Point, step: Step) -> bool:
        """Whether no shorter step than this failed step would gain anything."""
        return False


@dataclass(frozen=True)
class Iteration(Generic[Point]):
    """State of an iteration: steps tried, those of them that count, calm steps in a row; settled:
    whether it ended before its steps were used up."""

    point: Point
    damping: float
    steps: int = 0
    counted: int = 0
    calm: int = 0
    settled: bool = False


def iterate(
    problem: LeastSquares[Point, Step],
    begun: Iteration[Point],
    steps: int,
    progress: Callable[[int, float], None] | None = None,
) -> Iteration[Point]:
    """Go on from `begun` until settled, or until the number of steps that count, those before
    included, is reached. progress: called with this number and the cost after every step."""
    at, rule = begun, problem.rule
    while not at.settled and at.counted < steps:
        # A rejected step is solved again from the same point. Only an accepted step pays for new
        # derivatives.
        step = problem.step(at.point, at.damping)
        if step is None:
            return at
        last = at.counted + 1 == steps
        trial = problem.moved(at.point, step, last)
        if trial.cost < at.point.cost:
            trial = problem.linearised(trial, last)
        gain = at.point.cost - trial.cost
        point, calm = at.point, at.calm
        if gain > 0.0:  # False where either is not a number
            # Marquardt's rule: success or failure alone moves lambda, not the ratio of the
            # gain to the promised gain, for which not every problem here has the quadratic at hand
            point = trial
            damping = max(rule.falls * at.damping, rule.least)
            calm = at.calm + 1 if problem.calm(step, damping) else 0
            settled = calm == CALM_STEPS or problem.settled(gain, at.point, trial)
        else:
            # from nearly zero a factor alone would give the same step again, several times over
            damping = max(rule.rises * at.damping, rule.raised)
            settled = damping > rule.most or problem.stuck(at.point, step)
        counted = at.counted + problem.counts(at.point, trial)
        at = Iteration(point, damping, at.steps + 1, counted, calm, settled)
        if progress is not None and not settled:
            progress(counted, point.cost)
    return at
