"""What the fitted data say for a model: by the residuals that it leaves itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import log_evidence
from pamid.engine.program import Stepping
from pamid.estimation.problem import Fit
from pamid.estimation.weights import Weights

Array = NDArray[np.float64]
SAMPLES = 400
WHITE = np.random.default_rng(0).standard_normal((SAMPLES, 2))
NOISE = np.array([1e-3, 1e-3])
CORRELATED = np.array([4.0, 4.0])


def fitted(residuals: Array, moved: float = 0.0, spread: float = 0.1) -> Fit:
    """A fit of one parameter, moved by so many prior spreads and told to this share of one."""
    stub: Any = SimpleNamespace(free=(0,), scale=SimpleNamespace(inside=lambda p: p))
    weights = Weights(np.ones(2), np.ones(2))
    covariance, parts = np.array([[spread**2]]), (residuals[:150], residuals[150:])
    return Fit(
        stub,
        np.array([moved]),
        (),
        weights,
        0.0,
        covariance,
        1,
        True,
        "",
        Stepping(1, False),
        residuals=parts,
    )


def nats(residuals: Array, noise: Array = NOISE, **model: float) -> float:
    return log_evidence(fitted(residuals, **model), CORRELATED, noise)


@pytest.mark.parametrize("size", [1.0, 0.1])
def test_half_the_residual_is_as_much_evidence_wherever_it_is_found(size: float) -> None:
    """Beside an effect that leaves a tenth of the gap another one halves what is left: by the
    residuals of the model without either this would count next to nothing."""
    gained = nats(0.5 * size * WHITE) - nats(size * WHITE)
    assert gained == pytest.approx(2 * SAMPLES / 4.0 * np.log(2.0))


def test_a_channel_in_another_unit_is_as_much_evidence() -> None:
    smaller = WHITE * [1.0, 0.7]
    unit = np.array([1000.0, 1.0])
    gained = nats(smaller) - nats(WHITE)
    assert nats(smaller * unit, NOISE * unit) - nats(WHITE * unit, NOISE * unit) == pytest.approx(
        gained
    )


def test_below_the_noise_there_is_next_to_nothing_to_gain() -> None:
    """What remains is what the noise leaves: half of a hundredth of it, squared."""
    noise = np.array([100.0, 100.0])
    gained = nats(0.5 * WHITE, noise) - nats(WHITE, noise)
    assert 0.0 < gained < 2 * SAMPLES / 4.0 * 1e-4


def test_what_strains_a_prior_and_what_is_told_finely_costs() -> None:
    assert nats(WHITE) - nats(WHITE, moved=3.0) == pytest.approx(4.5)
    assert nats(WHITE) - nats(WHITE, spread=0.01) == pytest.approx(np.log(10.0))


def test_what_was_not_recorded_says_nothing() -> None:
    blind = WHITE.copy()
    blind[:, 1] = np.nan
    assert nats(0.5 * blind) - nats(blind) == pytest.approx(SAMPLES / 4.0 * np.log(2.0))


def test_a_fit_that_failed_has_none() -> None:
    failed = replace(fitted(WHITE), residuals=())
    assert log_evidence(failed, CORRELATED, NOISE) == 0.0
