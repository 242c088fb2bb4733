"""Fit with weights that follow the residuals: iteratively reweighted least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import Progress, fit
from pamid.estimation.problem import Fit, Problem
from pamid.estimation.weights import Weights, residual_weights

Array = NDArray[np.float64]

ROUNDS, FIRST_STEPS = 3, 15


def fit_robustly(
    problem: Problem,
    *,
    p: Array | None = None,
    progress: Progress | None = None,
    stepping: Stepping | None = None,
) -> Fit:
    """Fit with weights that follow the residuals, from the misfit at p (default: the data sheet)
    down to the remaining residual.

    Iteratively reweighted least squares, by sizes per channel rather than per sample. The first
    weights come from a single step. With those of the sensor noise, a long fit of a model that errs
    by many times the noise would distort its parameters.
    """
    noise = problem.noise
    alone = Weights(noise, np.ones_like(noise))
    fitted = fit(problem, p=p, iterations=1, weights=alone, stepping=stepping, exact=False)
    weights = (
        residual_weights(fitted.residuals, noise, problem.window)
        if fitted.residuals
        # the model ran away and left nothing to measure: alike over so many samples, as a guess
        else Weights(noise, np.full_like(noise, 30.0))
    )
    fitted = fit(
        problem,
        p=p,
        weights=weights,
        progress=progress,
        tolerance=1e-2,
        known=fitted.known,
        iterations=FIRST_STEPS,
        stepping=fitted.stepping,
        exact=False,
    )
    for last in range(2 - ROUNDS, 1):
        if not fitted.residuals:
            break
        # Weights change between fits and not within a fit: a cost that moves with every step has no
        # minimum to converge to.
        weights = residual_weights(fitted.residuals, noise, problem.window)
        fitted = fit(
            problem,
            p=fitted.p,
            starts=fitted.starts,
            weights=weights,
            stepping=fitted.stepping,
            known=fitted.known,
            exact=last == 0,
            progress=progress,
            tolerance=1e-3,
        )
    return fitted
