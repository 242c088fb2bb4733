"""What a rig that is stepped is spared: finer steps that would settle nothing, and refits."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pendulums import SteppedTwin, WrittenPendulum

from pamid.diagnosis import screening
from pamid.diagnosis.screening import ScreeningBaseline
from pamid.diagnosis.settings import DEFAULT
from pamid.engine.program import Stepping
from pamid.estimation import grey_box
from pamid.estimation.grey_box import settles
from pamid.estimation.problem import Fit, Problem
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly

NONE = np.zeros(0)


def _fitted(a: Assembly) -> Fit:
    problem, weights = Problem(a, (), ()), Weights(NONE, NONE)
    return Fit(problem, NONE, (), weights, 0.0, NONE, 0, True, "", Stepping(2))


@pytest.mark.parametrize(
    ("again", "expected"), [(0.5, True), (0.9, False), (1.5, False), (np.nan, True)]
)
def test_finer_steps_are_fitted_where_they_settle_something(again, expected, monkeypatch):
    """A method of order 1 leaves half of a change; contacts that lead elsewhere leave all of it."""
    asked: list[Stepping] = []

    def rechecked(a, fitted, held, noise):
        asked.append(fitted.stepping)
        return (), again

    monkeypatch.setattr(grey_box, "rechecked", rechecked)
    a = Assembly(SteppedTwin())
    assert settles(a, _fitted(a), (), NONE, 1.0) is expected
    assert asked == [Stepping(4)]
    asked.clear()
    a = Assembly(WrittenPendulum())
    assert settles(a, _fitted(a), (), NONE, 1.0)  # the steps of equations have an order
    assert not asked


def test_what_is_stepped_is_screened_by_no_finer_steps_than_it_asks_for(monkeypatch):
    """Those of a leader that was refined cost more, and only choose what is refitted."""
    monkeypatch.setattr(screening, "careful_stepping", lambda *_: Stepping(1))
    found = []
    for rig in (WrittenPendulum(), SteppedTwin()):
        leader: Any = SimpleNamespace(fit=_fitted(Assembly(rig)))
        found.append(ScreeningBaseline(leader, NONE, 0.0, False, DEFAULT).stepping)
    assert found == [Stepping(2), Stepping(1)]


def test_what_is_stepped_is_screened_by_the_slopes_that_are_kept():
    """Lanes of a simulator run one after the other, and every chord step would cost as many runs
    as there are parameters."""
    leader: Any = SimpleNamespace(fit=_fitted(Assembly(SteppedTwin())))
    base = ScreeningBaseline(leader, NONE, 0.0, False, DEFAULT)
    assert base.frozen is None
