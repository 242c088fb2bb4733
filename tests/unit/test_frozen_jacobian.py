"""Chord steps with the frozen Jacobian of a fitted model: exact where it was computed, and on the
way to where exact steps lead."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart

from pamid.diagnosis.candidate_model import refit, transferred
from pamid.engine.damped_gauss_newton import Iteration, iterate
from pamid.engine.program import Stepping
from pamid.estimation.frozen_jacobian import (
    ChordShooting,
    FrozenJacobian,
    begin_chords,
)
from pamid.estimation.grey_box import fit_model, model_with
from pamid.estimation.multiple_shooting import ShootingPoint, begin, fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.model.attachment import attach
from pamid.model.registry import effects

SLIGHT = 0.1  # of the typical friction: where a candidate begins near the fitted model


class Candidate(NamedTuple):
    """A fitted cart, and the problem and starting parameters (SI) of friction on top of it."""

    fitted: Fit
    problem: Problem
    p: np.ndarray
    frozen: FrozenJacobian


@pytest.fixture(scope="module")
def candidate(tmp_path_factory) -> Candidate:
    data = cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))
    model = fit_model(data)
    fitted = model.fit
    friction = attach(data.rig, "coulomb-friction", effects())
    assembly = model_with(data, (friction,), model.assembly.sizes)
    problem = Problem(
        assembly, fitted.problem.tracks, free_parameters(assembly, data.tracks(assembly))
    )
    p = transferred(assembly, (model.assembly, fitted.p))
    for i, bound in enumerate(assembly.parameters):
        if bound.owner == friction.label and bound.null is not None:
            p[i] = bound.null + SLIGHT * (bound.value - bound.null)
    frozen = FrozenJacobian.of(
        fitted.problem, fitted.p, fitted.starts, fitted.weights, fitted.stepping
    )
    return Candidate(fitted, problem, p, frozen)


def test_a_candidate_is_integrated_as_finely_as_the_baseline(tmp_path_factory):
    """Errors of longer steps would otherwise be made up for by its parameters."""
    data = cart_evidence(record_cart(tmp_path_factory.mktemp("fine")))
    model = fit_model(data)
    friction = attach(data.rig, "coulomb-friction", effects())
    assembly = model_with(data, (friction,), model.assembly.sizes)
    coarse = refit(data, assembly, model.fit)
    fine = refit(data, assembly, replace(model.fit, stepping=Stepping(8)))
    assert coarse.stepping.substeps < fine.stepping.substeps == 8


def chords(c: Candidate) -> tuple[ChordShooting, Iteration[ShootingPoint]]:
    return begin_chords(c.problem, c.frozen, replace(c.fitted.end, p=c.p))


def test_normal_equations_are_those_of_exact_derivatives(candidate):
    """Of the fitted model itself, frozen where it is asked for: no column is out of date."""
    f = candidate.fitted
    point = begin_chords(f.problem, candidate.frozen, f.end)[1].point
    exact = begin(f.problem, f.end)[1].point
    assert point.cost == pytest.approx(exact.cost, rel=1e-9)
    (D, off, B, gx), blocks = point.normal.blocks[0], exact.normal.blocks[0]
    for ours, theirs in zip(
        (point.normal.H, D, off, B), (exact.normal.H, *blocks[:3]), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-4 * np.abs(theirs).max())
    # gradients vanish at a fit: their size is that of a column times the residual
    for ours, theirs, H in ((point.normal.g, exact.normal.g, exact.normal.H), (gx, blocks[3], D)):
        most = 1e-4 * np.sqrt(np.abs(H).max() * exact.cost)
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=most)


def test_own_columns_are_exact_where_shared_ones_are_frozen(candidate):
    f, p = candidate.fitted, candidate.p
    shooting, begun = chords(candidate)
    exact = begin(candidate.problem, replace(f.end, p=p))[1].point
    shared, own = shooting.places
    assert len(own) == 2 and len(shared) == len(f.problem.free)
    for place in own:
        ours, theirs = begun.point.normal.H[place, own], exact.normal.H[place, own]
        np.testing.assert_allclose(ours, theirs, rtol=1e-3)


def test_chord_steps_lead_where_exact_steps_lead(candidate):
    f = candidate.fitted
    shooting, begun = chords(candidate)
    reached = iterate(shooting, begun, 12).point.cost
    exact = fit(candidate.problem, replace(f.end, p=candidate.p), iterations=12).cost
    gain = f.cost - exact
    assert gain > 10.0, "the cart rubs"
    assert f.cost - reached == pytest.approx(gain, rel=0.02)
    # the prediction of one step is below what is reached, and of its size
    assert shooting.predicted_cost(begun.point) < begun.point.cost
