"""Reported errors are free of the choice: either half of the held-out windows is scored with the
model that the other half would have chosen."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
from made_models import comparison, effect, model
from numpy.typing import NDArray

from pamid.diagnosis.answer import Answer
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.pipeline import Diagnosis
from pamid.diagnosis.selection import Selection, SelectionStep
from pamid.estimation.port_evidence import PortEvidence

WINDOWS = 16
FIRST = np.arange(WINDOWS) < WINDOWS // 2
NOWHERE = PortEvidence({}, (), {}, {})
BEFORE = np.full(WINDOWS, 11.0)
FRICTION, LEAK = effect("coulomb-friction", "friction"), effect("leak")


@dataclass(frozen=True, eq=False)
class Halved(Diagnosis):
    """Windows are halved in their order."""

    @property
    def half(self) -> NDArray[np.bool_]:  # type: ignore[override]
        return FIRST


def losses(first: float, second: float) -> NDArray[np.float64]:
    return np.where(FIRST, first, second)


def diagnosis(best: CandidateModel, *candidates: CandidateModel) -> Diagnosis:
    """best: the answer; candidates: of the step that has chosen it."""
    budget = comparison(BEFORE).budget
    steps = (SelectionStep(budget.baseline, candidates, (best,)),)
    found = Answer("explained", best, (), False)
    return Halved(
        cast(Any, None),
        budget,
        selection=Selection(best, steps, NOWHERE),
        answer=found,
    )


def test_each_half_is_scored_with_the_choice_of_the_other():
    """Friction is chosen by the first half, and worse in the second; the leak the reverse."""
    friction = model(losses(2.0, 5.0), FRICTION)
    leak = model(losses(6.0, 3.0), LEAK)
    d = diagnosis(friction, friction, leak)
    assert d.reported(friction)[:, 0] == pytest.approx(losses(6.0, 5.0))
    assert d.removed is not None
    assert d.removed.share == pytest.approx(1.0 - (5.5 - 1.0) / 10.0)
    assert d.removed.share < d.comparison.removed(friction).share


def test_a_model_that_both_halves_choose_is_reported_as_it_is():
    friction, leak = model(losses(2.0, 3.0), FRICTION), model(losses(4.0, 5.0), LEAK)
    d = diagnosis(friction, friction, leak)
    assert (d.reported(friction) == friction.absolutes).all()
    assert d.reported(leak) is leak.absolutes, "no answer, not corrected"
