"""A refit that predicts worse than the data sheet is repaired, or the data sheet is used."""

import numpy as np
import pytest
from small_cart import RIG, record_cart

from pamid.base.parallel.packing import Question
from pamid.estimation import grey_box
from pamid.estimation.grey_box import (
    WORSE,
    GreyBox,
    fit_held,
    fit_model,
    relative_error,
    repaired,
    undetermined_parameters,
    with_fit,
    without_harmful_background,
)
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import FitStart
from pamid.model.background import Gain
from pamid.model.parameter import Parameter
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings

BACKGROUND = "background.push_gain:"


@pytest.fixture(scope="module")
def healthy(tmp_path_factory) -> GreyBox:
    """A cart, fitted with a tolerance of its amplifier and a parameter that does nothing."""
    rig = rig_named(RIG)
    rig.parameters = (
        *rig.parameters,
        Parameter("colour", 2.0, 0.0, 4.0, spread=0.5, source="catalogue"),
    )
    port = next(name for name, port in rig.ports.items() if port.kind == "motion")
    rig.background = {port: Gain("push_gain", tolerance=0.02)}
    path = record_cart(tmp_path_factory.mktemp("cart"), ())
    return fit_model(split_recordings(rig, [read_recording(path)], []))


def moved(model: GreyBox, **values: float) -> GreyBox:
    """The model with other parameters, its windows begun anew."""
    p = model.fit.p.copy()
    for key, value in values.items():
        p[model.assembly.index_of(key.replace("__", BACKGROUND))] = value
    at = fit(model.fit.problem, FitStart(p=p, weights=model.fit.weights), iterations=0)
    return with_fit(model, at)


def test_a_good_refit_is_left_alone(healthy):
    assert repaired(healthy, 0) is healthy
    assert without_harmful_background(healthy).fit is healthy.fit
    assert healthy.remark == ""


def test_a_refit_in_a_wrong_place_is_fitted_from_other_starts(healthy):
    bad = moved(healthy, mass_kg=4.0)
    assert relative_error(bad.held_out, healthy.data_sheet) > WORSE
    good = repaired(bad, 0)
    place = healthy.assembly.index_of("mass_kg")
    assert good.fit.p[place] == pytest.approx(1.2, rel=0.05)
    assert "drawn from the priors" in good.remark


def test_what_the_data_do_not_determine_is_held(healthy):
    place = healthy.assembly.index_of("colour")
    assert undetermined_parameters(healthy.fit) == [place]
    held = fit_held(moved(healthy, colour=3.0).fit, [place])
    assert held.p[place] == 2.0
    assert held.p[healthy.assembly.index_of("mass_kg")] == pytest.approx(1.2, rel=0.05)
    assert held.problem.free == healthy.fit.problem.free


def test_a_refit_that_nothing_mends_is_worse_than_the_data_sheet_and_says_so(healthy, monkeypatch):
    for attempt in ("_from_draws", "_with_held"):
        monkeypatch.setattr(grey_box, attempt, lambda *_: None)
    bad = moved(healthy, mass_kg=4.0)
    same = repaired(bad, 0)
    assert same.fit is bad.fit
    assert "The data sheet predicts better" in same.remark


def test_a_background_term_that_does_harm_is_dropped(healthy):
    key = next(k for k in healthy.assembly.keys if k.startswith("background."))
    p = healthy.fit.p.copy()
    p[healthy.assembly.keys[key]] = healthy.assembly.parameters[healthy.assembly.keys[key]].high
    at = fit(healthy.fit.problem, FitStart(p=p, weights=healthy.fit.weights), iterations=0)
    bad = with_fit(healthy, at)
    good = without_harmful_background(bad)
    assert not good.assembly.background_terms and not good.evidence.rig.background
    assert healthy.evidence.rig.background  # the rig itself keeps it
    assert relative_error(good.held_out, bad.held_out) < 1.0 / WORSE
    assert good.remark == "Background push_gain was removed: it increased the held-out error."
    question = Question(healthy.evidence)
    restored = question.unpacked(question.packed(good))
    assert restored.assembly.keys == good.assembly.keys and restored.remark == good.remark
    np.testing.assert_array_equal(restored.fit.p, good.fit.p)
