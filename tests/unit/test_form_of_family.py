"""Which form of a family leads: the simpler one, unless windows or fitted data are sure of
another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import silent
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.search import Search, ranked
from pamid.diagnosis.settings import DEFAULT

Array = NDArray[np.float64]

FEW, MANY = 8, 400


class Known(Search):
    """A search whose models know their evidence."""

    def nats(self, c: CandidateModel) -> float:
        return float(cast(Any, c).nats)


def model(name: str, errors: Array, family: str, parameters: int, nats: float) -> CandidateModel:
    """A form of a family with these errors per held-out window, and so much evidence on what was
    fitted."""
    attached = SimpleNamespace(
        label=name, family=lambda rig: family, effect=SimpleNamespace(defining=())
    )
    return cast(
        CandidateModel,
        SimpleNamespace(
            assembly=SimpleNamespace(
                attachments=(attached,), parameters=(), traced=SimpleNamespace(passages=())
            ),
            attached=(attached,),
            label=name,
            family=family,
            fit=SimpleNamespace(residuals=(), p=()),
            nats=nats,
            free_count=parameters,
            squares=errors[:, None] ** 2,
            absolutes=errors[:, None],
            fitted_squares=np.ones((8, 1)),
            drawn_losses={},
        ),
    )


def first(*models: CandidateModel) -> str:
    windows = len(models[0].squares)
    level = np.full((windows, 1), 0.1)
    base = model("baseline", np.full(windows, 2.0), "", 2, 0.0)
    base.__dict__["attached"] = ()
    budget = Budget(cast(Any, None), base, level, level, level)
    every = np.ones(windows, bool)
    search = Known(
        cast(Any, SimpleNamespace(rig=None)),
        budget,
        every,
        every,
        [],
        cast(Any, None),
        0,
        cast(Any, None),
        silent,
    )
    return ranked(search, list(models))[0].label


def uneven(windows: int, level: float, spread: float) -> Array:
    """Errors about a level, every other window on the other side of it."""
    return level + spread * np.where(np.arange(windows) // 3 % 2 == 0, 1.0, -1.0)


def forms(windows: int, fuller: float, spread: float, nats: float) -> list[CandidateModel]:
    """A simple form that leaves 0.8 everywhere; one with a parameter more that leaves `fuller`,
    uneven by `spread`, with so many nats more."""
    return [
        model("simple", np.full(windows, 0.8), "overflow", 4, 20.0),
        model("fuller", uneven(windows, fuller, spread), "overflow", 5, 20.0 + nats),
    ]


def test_an_uncertain_gain_goes_to_the_simpler_form() -> None:
    assert first(*forms(FEW, 0.65, 0.3, nats=0.0)) == "simple"


def test_an_uncertain_gain_for_which_the_fitted_data_speak_is_kept() -> None:
    more = 1.1 * DEFAULT.simpler_evidence
    assert first(*forms(FEW, 0.65, 0.3, nats=more)) == "fuller"
    less = 0.9 * DEFAULT.simpler_evidence
    assert first(*forms(FEW, 0.65, 0.3, nats=less)) == "simple"


def test_a_surely_slight_gain_is_not_worth_a_parameter_whatever_the_evidence() -> None:
    assert first(*forms(MANY, 0.78, 0.001, nats=100.0)) == "simple"


def test_fitted_data_decide_where_few_windows_lean_to_the_simpler_form() -> None:
    assert first(*forms(FEW, 0.6, 0.55, nats=20.0)) == "fuller"
    assert first(*forms(FEW, 0.6, 0.55, nats=2.0)) == "simple"


def test_windows_that_surely_gain_nothing_by_a_form_are_not_overruled() -> None:
    assert first(*forms(FEW, 0.82, 0.3, nats=20.0)) == "simple"
    assert first(*forms(MANY, 1.5, 0.01, nats=20.0)) == "simple"


def test_evidence_does_not_decide_between_families() -> None:
    leak = model("leak", uneven(FEW, 0.82, 0.3), "leak", 4, 100.0)
    assert first(*forms(FEW, 0.9, 0.3, nats=0.0), leak) == "simple"
