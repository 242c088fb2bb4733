"""Chord steps with the frozen Jacobian of a fitted model: exact where it was computed, and on the
way to where exact steps lead."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart

from pamid.diagnosis.candidate_model import transferred
from pamid.engine.damped_gauss_newton import Iteration, iterate
from pamid.estimation.frozen_jacobian import (
    ChordShooting,
    FrozenJacobian,
    PaddedWindows,
    begin_chords,
)
from pamid.estimation.grey_box import fit_model, model_with
from pamid.estimation.linear_rows import linear_rows, moved_rows
from pamid.estimation.multiple_shooting import ShootingPoint, begin, fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.model.attachment import attach
from pamid.model.registry import effects
from pamid.simulation.windows import Window

SLIGHT = 0.1  # of the typical friction: where a candidate begins near the fitted model


class Candidate(NamedTuple):
    """A fitted cart, and the problem and starting parameters (SI) of friction on top of it."""

    fitted: Fit
    problem: Problem
    p: np.ndarray
    frozen: FrozenJacobian


@pytest.fixture(scope="module")
def candidate(tmp_path_factory: pytest.TempPathFactory) -> Candidate:
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


def settings_of(f: Fit) -> dict[str, Any]:
    """Window starts, weights and stepping of a fit, with which another begins."""
    return {
        "starts": f.starts,
        "weights": f.weights,
        "continuity": f.continuity,
        "stepping": f.stepping,
    }


def chords(c: Candidate) -> tuple[ChordShooting, Iteration[ShootingPoint]]:
    f = c.fitted
    return begin_chords(
        c.problem,
        c.frozen,
        p=c.p,
        **settings_of(f),
    )


def test_normal_equations_are_those_of_exact_derivatives(candidate: Candidate) -> None:
    """Of the fitted model itself, frozen where it is asked for: no column is out of date."""
    f = candidate.fitted
    point = begin_chords(
        f.problem,
        candidate.frozen,
        p=f.p,
        **settings_of(f),
    )[1].point
    exact = begin(
        f.problem,
        p=f.p,
        **settings_of(f),
    )[1].point
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


def test_own_columns_are_exact_where_shared_ones_are_frozen(candidate: Candidate) -> None:
    f, p = candidate.fitted, candidate.p
    shooting, begun = chords(candidate)
    exact = begin(
        candidate.problem,
        p=p,
        **settings_of(f),
    )[1].point
    shared, own = shooting.places
    assert len(own) == 2 and len(shared) == len(f.problem.free)
    for place in own:
        ours, theirs = begun.point.normal.H[place, own], exact.normal.H[place, own]
        np.testing.assert_allclose(ours, theirs, rtol=1e-3)


def test_chord_steps_lead_where_exact_steps_lead(candidate: Candidate) -> None:
    f = candidate.fitted
    shooting, begun = chords(candidate)
    reached = iterate(shooting, begun, 12).point.cost
    exact = fit(
        candidate.problem,
        p=candidate.p,
        **settings_of(f),
        iterations=12,
    ).cost
    gain = f.cost - exact
    assert gain > 10.0, "the cart rubs"
    assert f.cost - reached == pytest.approx(gain, rel=0.02)
    # the prediction of one step is below what is reached, and of its size
    assert shooting.predicted_cost(begun.point) < begun.point.cost


def test_a_lane_that_runs_away_leaves_the_point(candidate: Candidate) -> None:
    """A difference that cannot be computed has no column; the cost is that of the point."""
    shooting, begun = chords(candidate)
    wild = replace(shooting, moves=tuple(np.full_like(m, 1e300) for m in shooting.moves))
    point = wild.at(begun.point.s, begun.point.starts)
    assert point.normal.fine and point.cost == begun.point.cost


def test_columns_follow_the_keys_of_a_problem(candidate: Candidate) -> None:
    held = replace(candidate.fitted.problem, free=candidate.fitted.problem.free[1:])
    part = candidate.frozen.of_shared(held)
    assert part.keys == candidate.frozen.keys[1:]
    np.testing.assert_array_equal(part.tracks[0].ends, candidate.frozen.tracks[0].ends[:, :, 1:])


def test_windows_of_unequal_length_are_padded_with_zeros() -> None:
    padded = PaddedWindows([Window(0, 2), Window(2, 5)])
    rows = padded.rows(np.arange(1.0, 6.0)[:, None])
    np.testing.assert_array_equal(rows, [[1.0, 2.0, 0.0], [3.0, 4.0, 5.0]])


def test_rows_of_lanes_are_those_of_sensitivities(candidate: Candidate) -> None:
    f, k = candidate.fitted, len(candidate.problem.free)
    own = np.array([k - 2, k - 1])
    point = (candidate.problem, candidate.p, f.starts, f.weights, f.continuity, f.stepping, 400)
    rows = linear_rows(*point)
    away, by_own = moved_rows(*point, own)
    sheet = len(rows.away) - k
    np.testing.assert_allclose(away, rows.away[:sheet], rtol=1e-9, atol=1e-9)
    expected = rows.by_parameters[:sheet, own]
    np.testing.assert_allclose(by_own, expected, rtol=0.0, atol=1e-3 * np.abs(expected).max())
