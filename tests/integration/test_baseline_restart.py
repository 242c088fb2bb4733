"""A baseline in a local minimum: no effect is named for what its refit found in the parameters."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import FEW, cart_evidence, record_cart

from pamid.diagnosis import pipeline
from pamid.diagnosis.budget import Budget, budget_of
from pamid.diagnosis.pipeline import diagnose
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import FitStart
from pamid.estimation.weights import Weights, residual_weights
from pamid.model.registry import effects
from pamid.simulation.replay import replay_track


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> GreyBox:
    """A cart without any effect, fitted."""
    return fit_model(cart_evidence(record_cart(tmp_path_factory.mktemp("cart"), ())))


def trapped(model: GreyBox) -> GreyBox:
    """The model as if its fit had ended at half of the mass."""
    wrong, problem, noise = model.fit.p.copy(), model.fit.problem, model.evidence.noise
    wrong[model.assembly.keys["mass_kg"]] /= 2.0
    start = FitStart(wrong, weights=Weights(noise, np.ones_like(noise)))
    residuals = fit(problem, start, iterations=0).residuals
    weights = residual_weights(residuals, noise, problem.window)
    fitted = fit(problem, replace(start, weights=weights), iterations=0)
    replays = tuple(
        replay_track(model.assembly, wrong, r.full_track, fitted.stepping, noise)
        for r in model.held_out
    )
    return replace(model, fit=fitted, held_out=replays)


def test_a_baseline_in_its_minimum_stays(tmp_path):
    """Also where an effect is missing: without it, the fit ends where the baseline is."""
    evidence = cart_evidence(record_cart(tmp_path))
    found = diagnose(evidence, {name: effects()[name] for name in FEW})
    assert found.budget.model.remark == "" and found.verdict == "explained"


def test_nothing_is_named_where_the_baseline_was_trapped(model, monkeypatch):
    begun: list[Budget] = []

    def in_trap(evidence, *, pool, **options):
        begun.append(budget_of(trapped(model), **options))  # type: ignore[arg-type]
        return begun[0]

    monkeypatch.setattr(pipeline, "gap_budget", in_trap)
    catalogue = {name: effects()[name] for name in FEW}
    found = diagnose(model.evidence, catalogue)
    assert begun[0].baseline.fit.cost > 2.0 * found.budget.baseline.fit.cost
    assert found.verdict == "no-structural-gap"
    mass = model.assembly.keys["mass_kg"]
    assert found.budget.baseline.fit.p[mass] == pytest.approx(model.fit.p[mass], rel=1e-3)
    assert "local minimum" in found.budget.model.remark
    # that of the trap would have been blamed on an effect
    monkeypatch.setattr(pipeline, "lower_baseline", lambda *_: None)
    assert diagnose(model.evidence, catalogue).verdict != "no-structural-gap"
