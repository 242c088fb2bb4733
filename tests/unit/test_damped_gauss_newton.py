"""The iteration that fits, initial states and smoothing share, on Rosenbrock's valley."""

from typing import NamedTuple

import numpy as np
import pytest

from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate

Array = np.ndarray


class Point(NamedTuple):
    x: Array
    cost: float
    linearised: bool = False


class Valley(LeastSquares[Point, Array]):
    """r = (10 (y - x^2), 1 - x): Rosenbrock (1960), Comput. J. 3(3). wall: beyond this x the model
    cannot be run."""

    rule = DampingRule(1e-3, falls=0.2, least=1e-9, rises=10.0, most=1e7)

    def __init__(self, wall: float = np.inf) -> None:
        self.wall, self.tried = wall, 0

    def at(self, x: Array, linearised: bool = False) -> Point:
        r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return Point(x, float(r @ r) if x[0] <= self.wall else np.nan, linearised)

    def step(self, at: Point, damping: float) -> Array | None:
        assert at.linearised, "a step is taken only from a point that was linearised"
        x, y = at.x
        r, J = np.array([10.0 * (y - x**2), 1.0 - x]), np.array([[-20.0 * x, 10.0], [-1.0, 0.0]])
        H = J.T @ J
        return np.asarray(np.linalg.solve(H + damping * np.diag(H.diagonal()), -J.T @ r))

    def moved(self, at: Point, step: Array, last: bool) -> Point:
        self.tried += 1
        return self.at(at.x + step)

    def linearised(self, at: Point, last: bool) -> Point:
        return at._replace(linearised=True)

    def settled(self, gain: float, before: Point, after: Point) -> bool:
        return gain < 1e-12


def begun(problem: Valley) -> Iteration[Point]:
    return Iteration(problem.at(np.array([-1.2, 1.0]), True), problem.rule.start)


def test_it_finds_the_minimum_and_the_cost_never_rises():
    costs: list[float] = []
    ended = iterate(Valley(), begun(Valley()), 100, lambda _, cost: costs.append(cost))
    assert ended.settled and ended.point.x == pytest.approx([1.0, 1.0], abs=1e-6)
    assert costs == sorted(costs, reverse=True)


@pytest.mark.parametrize("probe", [1, 3, 8])
def test_going_on_from_a_probe_equals_not_having_stopped(probe):
    whole = iterate(Valley(), begun(Valley()), 60)
    first, rest = Valley(), Valley()
    parts = iterate(rest, iterate(first, begun(first), probe), 60)
    assert first.tried == probe and rest.tried == whole.steps - probe
    assert (parts.point.x == whole.point.x).all()
    assert (parts.damping, parts.steps, parts.settled) == (whole.damping, whole.steps, True)


def test_where_the_model_cannot_be_run_the_step_is_shortened():
    problem = Valley(wall=0.5)
    ended = iterate(problem, begun(problem), 400)
    assert ended.settled and ended.damping > problem.rule.most
    assert ended.point.x[0] <= 0.5 and np.isfinite(ended.point.cost)


def test_normal_equations_that_are_not_finite_end_it_unsettled():
    class Broken(Valley):
        def step(self, at, damping):
            return None

    ended = iterate(Broken(), begun(Broken()), 60)
    assert (ended.steps, ended.settled) == (0, False)


@pytest.mark.parametrize("limit", [1, 3, 5])
def test_only_steps_that_count_use_up_the_limit(limit):
    class Generous(Valley):
        """Rejected steps are free, and so are those that halve the cost."""

        def counts(self, before, trial):
            return 0.5 * before.cost < trial.cost < before.cost

    whole = iterate(Generous(), begun(Generous()), 100)
    ended = iterate(Generous(), begun(Generous()), limit)
    assert whole.counted > limit, "else the limit shows nothing"
    assert (ended.counted, ended.settled) == (limit, False) and ended.steps > limit
    resumed = iterate(Generous(), ended, 100)
    assert (resumed.steps, resumed.counted) == (whole.steps, whole.counted)
    assert (resumed.point.x == whole.point.x).all()
