"""Physical reasons against a model, whatever it predicts."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from made_models import comparison, effect, model

import pamid.diagnosis.guards as guards_module
from pamid.diagnosis.guards import Guards

LEAK, DRAG = effect("leak", port="tank"), effect("drag")


@pytest.fixture
def guards() -> Guards:
    budget = comparison(np.full(8, 9.0)).budget
    search = SimpleNamespace(budget=budget, settings=budget.settings, response=None, seed=0)
    return Guards(cast(Any, search))


def found(patch: pytest.MonkeyPatch, **by_label: dict[str, Any]) -> None:
    """What each check finds, by the label of an effect."""
    patch.setattr(
        guards_module, "at_limits", lambda c, a: by_label.get("limits", {}).get(a.label, {})
    )
    for name in ("at_bounds", "vanished", "duplicated_terms"):
        answers = by_label.get(name, {})

        def check(c: Any, *more: Any, answers: Any = answers) -> tuple[str, ...]:
            return next((answers[one] for one in more if one in answers), ())

        patch.setattr(
            guards_module,
            name,
            lambda c, *more, check=check: check(c, *(one for one in more if isinstance(one, str))),
        )


def test_every_effect_of_a_model_is_held_against_physics(guards, monkeypatch):
    found(
        monkeypatch,
        at_bounds={"leak@tank": ("exponent",)},
        vanished={"drag@joint": ("drag_n_s2_per_m2",)},
        duplicated_terms={"drag@joint": ("viscous", "offset")},
    )
    assert guards.objections(model(np.full(8, 3.0), LEAK, DRAG)) == (
        "exponent of leak@tank ended at a bound",
        "drag_n_s2_per_m2 of drag@joint ended at zero effect",
        "drag@joint duplicates viscous, offset of the rig",
    )


def test_an_effect_at_the_limit_of_its_form_leaves_its_place_to_the_other_family(
    guards, monkeypatch
):
    found(monkeypatch, limits={"drag@joint": {"reach_rad": "friction"}})
    drag = model(np.full(8, 3.0), DRAG)
    search: Any = guards.search
    search.candidates, search.family = [LEAK], lambda a: "friction"
    assert guards.objections(drag) == (), "no friction at its port"
    guards._objections.clear()
    search.candidates = [effect("friction")]
    assert guards.objections(drag) == (
        "reach_rad of drag@joint ended at a value where the effect is friction",
    )


@pytest.mark.parametrize("explained", [True, False])
def test_a_model_that_predicts_as_well_without_its_inputs_is_set_aside(
    explained, guards, monkeypatch
):
    runs: list[Any] = []

    def explained_channels(budget, c, response, seed):
        runs.append(c)
        return np.array([explained, False])

    found(monkeypatch)
    monkeypatch.setattr(guards_module, "explained_channels", explained_channels)
    c = model(np.full(8, 3.0), LEAK)
    assert guards.ignores_inputs(c) == (not explained)
    objections = guards.objections(c)
    assert objections == () if explained else "without" in objections[0]
    assert guards.ignores_inputs(c) == (not explained)
    assert len(runs) == (2 if explained else 1), "a model is not run twice for the same objection"
