"""From a selection of effects to a verdict, with made-up losses."""

from typing import Any, cast

import numpy as np
import pytest
from made_models import comparison, effect, model

from pamid.diagnosis.answer import (
    Answer,
    answer,
    features,
    forecast_interval,
    probability,
)
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison
from pamid.diagnosis.family_forms import FreeForm
from pamid.diagnosis.selection import Selection
from pamid.estimation.port_evidence import PortEvidence

WINDOWS = 24
BEFORE = np.random.default_rng(0).uniform(9.0, 30.0, WINDOWS)
FRICTION = effect("coulomb-friction", "friction")
ELSEWHERE = effect("coulomb-friction", "friction", "motor")
LEAK = effect("leak", port="chamber")
DELAY = effect("dead-time", port="command")
AFTER = PortEvidence({}, (), {}, {})
FORM = cast(FreeForm, object())


@pytest.fixture(autouse=True)
def _models_differ(monkeypatch) -> None:
    """Made-up models have no predictions to compare."""
    monkeypatch.setattr(Comparison, "predict_the_same", lambda *_: False)


def leaving(share: float, *effects: Any, spread: float = 0.0, parameters: int = 0) -> Any:
    """A model that leaves this share of the gap in every window, or about it."""
    random = np.random.default_rng(1)
    left = share * (1.0 + spread * random.standard_normal(WINDOWS))
    return model(1.0 + left * (BEFORE - 1.0), *effects, parameters=parameters)


def answered(
    best: CandidateModel | None = None,
    *others: CandidateModel,
    ranking: list[CandidateModel] | None = None,
    forms: tuple[FreeForm, ...] = (),
    without: dict[str, CandidateModel] | None = None,
    set_aside: tuple[str, ...] = (),
) -> tuple[Comparison, Answer]:
    """The answer where `best` was selected; others: that do as well in the place of its first
    effect."""
    found = comparison(BEFORE)
    base = found.budget.baseline
    chosen = best or base
    models = [c for c in (best, *others) if c is not None] if ranking is None else ranking
    instead = {a.label: () for a in chosen.attached}
    if chosen.attached:
        instead[chosen.attached[0].label] = others
    selection = Selection(
        chosen, (), AFTER, without or {a.label: base for a in chosen.attached}, instead
    )
    return found, answer(found, selection, found.ordered(models), forms, set_aside)


def labels(a: Answer) -> list[str]:
    return [c.effect.label for c in a.causes]


@pytest.mark.parametrize(("left", "verdict"), [(0.1, "explained"), (0.4, "partly-explained")])
def test_one_cause_explains_the_gap_unless_a_material_remainder_is_left(left, verdict):
    best = leaving(left, FRICTION)
    found, a = answered(best, ranking=[best, leaving(0.6, LEAK)])
    assert a.verdict == verdict and labels(a) == ["coulomb-friction@joint"]
    assert a.causes[0].removes.share == pytest.approx(1.0 - left)
    assert a.causes[0].or_at == a.causes[0].instead == ()
    assert a.material_rest == a.left_over == (verdict != "explained")
    assert found.floors(a.model) > 1.1


def test_two_families_that_tie_are_both_named():
    best, rival = leaving(0.10, FRICTION), leaving(0.11, LEAK)
    _, a = answered(best, rival)
    assert a.verdict == "ambiguous" and labels(a) == ["coulomb-friction@joint", "leak@chamber"]
    assert [c.model for c in a.causes] == [best, rival] and a.model is best
    assert [c.removes.share for c in a.causes] == pytest.approx([0.9, 0.89])


@pytest.mark.parametrize("same", [True, False])
def test_many_that_tie_are_one_group_only_if_they_predict_the_same(same, monkeypatch):
    monkeypatch.setattr(Comparison, "predict_the_same", lambda *_: same)
    best, *others = leaving(0.1, FRICTION), leaving(0.1, LEAK), leaving(0.1, DELAY)
    _, a = answered(best, *others)
    if same:
        assert a.verdict == "ambiguous" and len(a.causes) == 3
    else:
        assert (a.verdict, a.causes) == ("cannot-tell", ())
        assert a.model is not best and a.leader is best


def test_the_same_effect_at_another_port_is_a_decision():
    best, elsewhere = leaving(0.10, FRICTION), leaving(0.11, ELSEWHERE)
    _, a = answered(best, elsewhere, ranking=[best, elsewhere, leaving(0.6, LEAK)])
    assert a.verdict == "explained" and labels(a) == ["coulomb-friction@joint"]
    assert a.causes[0].or_at == ("motor",) and a.causes[0].instead == ()


def test_two_causes_each_next_to_the_other():
    both = leaving(0.1, FRICTION, LEAK)
    friction, leak = leaving(0.4, FRICTION), leaving(0.7, LEAK)
    without = {FRICTION.label: leak, LEAK.label: friction}
    _, a = answered(both, ranking=[friction, leak], without=without)
    assert a.verdict == "explained" and labels(a) == [FRICTION.label, LEAK.label]
    assert [c.removes.share for c in a.causes] == pytest.approx([0.6, 0.3])


def test_few_windows_leave_a_large_share_open():
    leader = leaving(0.6, FRICTION, spread=1.5)
    found, a = answered(ranking=[leader, leaving(0.95, LEAK)])
    removed = found.removed(leader)
    assert removed.low > 0.0 and removed.z < 3.0
    assert (a.verdict, a.causes) == ("cannot-tell", ())
    assert a.leader is leader and a.model is found.budget.baseline


def test_what_physics_objects_to_leads_nowhere():
    certain, open_one = leaving(0.3, LEAK), leaving(0.6, FRICTION, spread=1.5)
    _, a = answered(ranking=[certain, open_one], set_aside=("leak@chamber",))
    assert a.leader is open_one and a.verdict == "cannot-tell"
    best, elsewhere = leaving(0.10, FRICTION), leaving(0.11, ELSEWHERE)
    _, a = answered(best, elsewhere, set_aside=(ELSEWHERE.label,))
    assert a.causes[0].or_at == ()


def test_a_curve_at_a_port_is_an_unknown_effect():
    _, a = answered(ranking=[leaving(0.95, FRICTION)], forms=(FORM,))
    assert a.verdict == "unknown-effect" and a.free_forms == (FORM,)
    assert a.material_rest and a.left_over


@pytest.mark.parametrize(("scale", "verdict"), [(0.2, "no-structural-gap"), (1.0, "cannot-tell")])
def test_a_large_gap_that_nothing_explains_is_not_denied(scale, verdict):
    found = comparison(scale * BEFORE)
    selection = Selection(found.budget.baseline, (), AFTER, {}, {})
    a = answer(found, selection, [], ())
    assert a.verdict == verdict and a.leader is None


# ---- probability --------------------------------------------------------------------------------


def figures(share_left: float, rival_left: float, spread: float = 0.3) -> dict[str, float]:
    c = leaving(share_left, FRICTION, spread=spread)
    found = comparison(BEFORE)
    return features(found, c, found.budget.baseline, [c, leaving(rival_left, LEAK)])


def test_probability_grows_with_what_is_removed_and_with_the_lead():
    high, behind, small = figures(0.1, 0.8), figures(0.3, 0.2), figures(0.9, 0.95)
    assert 1.0 > probability(high) > max(probability(behind), probability(small)) > 0.0


# ---- forecast -----------------------------------------------------------------------------------


def test_a_forecast_is_wide_and_surer_where_hardly_anything_remains():
    low, high = forecast_interval(BEFORE, 0.4 * BEFORE, 0)
    assert low < 0.6 < high < 1.0
    assert high - low > 0.1, "a further recording differs, though these windows agree"
    half, hardly = (np.ptp(forecast_interval(BEFORE, k * BEFORE, 0)) for k in (0.5, 0.05))
    assert hardly < half
    assert forecast_interval(BEFORE, BEFORE, 0) == pytest.approx((0.0, 0.0))


# ---- one effect at several ports -----------------------------------------------------------------


def test_one_effect_at_several_ports_has_one_probability_and_a_share_at_each():
    one, other = (effect("coulomb-friction", "friction", f"joint_{k}") for k in (1, 2))
    both, only = leaving(0.1, one, other), leaving(0.3, one)
    without = {
        one.label: leaving(0.7, other),
        other.label: only,
        f"{one.label} + {other.label}": comparison(BEFORE).budget.baseline,
    }
    rival = leaving(0.12, effect("lugre-friction", "friction", "joint_1"),
                    effect("lugre-friction", "friction", "joint_2"))  # fmt: skip
    _, a = answered(both, ranking=[both, rival, leaving(0.9, LEAK)], without=without)
    assert a.verdict == "explained" and labels(a) == [one.label, other.label]
    first, second = a.causes
    assert first.figures == second.figures and first.figures["removed"] == pytest.approx(0.9)
    assert (first.removes.share, second.removes.share) == pytest.approx((0.6, 0.2))
    # another law at the same joints is no other place
    assert first.or_at == second.or_at == ()
