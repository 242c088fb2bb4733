"""Either half of what is held out chooses, and reports of the other's choice."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.base.progress import silent
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.cross_fitting import crossed, reported
from pamid.diagnosis.search import Search, indistinguishable_from_first, ranked

Array = NDArray[np.float64]

WINDOWS = 24
HALF = np.arange(WINDOWS) // 2 % 2 == 0


def model(name: str, errors: Array, family: str = "") -> CandidateModel:
    """Fitted as well as any, with these errors per held-out window."""
    attached = SimpleNamespace(
        label=name, family=lambda rig: family or name, effect=SimpleNamespace(defining=())
    )
    return cast(
        CandidateModel,
        SimpleNamespace(
            assembly=SimpleNamespace(
                attachments=(attached,), parameters=(), traced=SimpleNamespace(passages=())
            ),
            attached=(attached,),
            label=name,
            family=family or name,
            fit=SimpleNamespace(residuals=(), p=()),
            free_count=3,
            squares=errors[:, None] ** 2,
            absolutes=errors[:, None],
            fitted_squares=np.ones((8, 1)),
            drawn_losses={},
        ),
    )


class AsWellFitted(Search):
    """A search in which the fitted data say the same of all models."""

    def nats(self, c: CandidateModel) -> float:
        return 0.0


def uneven(seed: int) -> Array:
    return np.random.default_rng(seed).uniform(0.9, 1.1, WINDOWS)


def search_of(floor: float = 0.1) -> Search:
    level = np.full((WINDOWS, 1), floor)
    base = model("baseline", 2.0 * uneven(0))
    base.__dict__["attached"] = ()
    budget = Budget(cast(Any, None), base, level, level, level)
    evidence = cast(Any, SimpleNamespace(rig=None))
    every = np.ones(WINDOWS, bool)
    return AsWellFitted(
        evidence, budget, every, HALF, [], cast(Any, None), 0, cast(Any, None), silent
    )


def both_halves(*models: CandidateModel) -> tuple[Search, Any]:
    search = search_of()
    ranking = ranked(search, list(models))
    tied = indistinguishable_from_first(search, ranking, [])
    return search, crossed(search, ranking, ranking[0], tied, [])


def test_a_steady_choice_is_reported_by_every_window() -> None:
    friction, leak = model("friction", 0.5 * uneven(1)), model("leak", 1.5 * uneven(2))
    search, found = both_halves(friction, leak)
    assert found.steady and all(c is friction for c in (found.best, *found.choices))
    assert (reported(found, friction) == friction.absolutes).all()


def test_a_transient_in_one_half_names_nothing_by_itself() -> None:
    """The leak is good where half of the windows lie, and useless in the other half."""
    leak = model("leak", np.where(HALF, 0.2, 2.0) * uneven(1))
    friction = model("friction", 0.9 * uneven(2))
    search, found = both_halves(friction, leak)
    assert found.best is friction and found.choices == (leak, friction) and not found.steady
    left, every = reported(found, friction), np.ones(WINDOWS, bool)
    # windows that alone would have chosen the leak report of the friction, the others of the leak
    assert left[HALF] == pytest.approx(friction.absolutes[HALF])
    assert left[~HALF] == pytest.approx(leak.absolutes[~HALF])
    told = search.budget.shrinkage(left, every)
    assert told == pytest.approx(1.0 - 0.5 * (0.9 + 2.0) / 2.0, abs=0.05)
    assert told < search.budget.shrinkage(friction.absolutes, every)


def test_two_of_a_family_and_what_nobody_can_tell_apart_are_one_name() -> None:
    stribeck = model("stribeck", np.where(HALF, 0.4, 0.6) * uneven(1), "friction")
    coulomb = model("coulomb", 0.5 * uneven(2), "friction")
    _, found = both_halves(stribeck, coulomb)
    assert found.choices == (stribeck, coulomb) and found.steady
    one, other = model("one", 0.5 * uneven(3)), model("other", 0.5 * uneven(4))
    assert both_halves(one, other)[1].steady


def test_where_there_is_no_choice_every_window_reports_of_the_model() -> None:
    friction = model("friction", 0.5 * uneven(1))
    search = search_of()
    assert crossed(search, (), search.budget.baseline, (), []) is None
    whole = replace(search, half=np.ones(WINDOWS, bool))
    assert crossed(whole, (friction,), friction, (), []) is None
    assert (reported(None, friction) == friction.absolutes).all()
