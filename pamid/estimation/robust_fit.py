"""Fit with weights that follow the residuals: iteratively reweighted least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import Progress, fit
from pamid.estimation.problem import Fit, FitStart, Problem
from pamid.estimation.weights import Weights, residual_weights

ROUNDS, FIRST_STEPS = 3, 15


def fit_robustly(
    problem: Problem,
    *,
    p: Array | None = None,
    progress: Progress | None = None,
    stepping: Stepping | None = None,
) -> Fit:
    """Fit from p (SI; default: the data sheet) with weights that are updated from the residuals of
    the preceding fit.

    Iteratively reweighted least squares with a weight per channel, not per sample. The first
    weights come from a fit of a single step. A long fit with sensor-noise weights would distort the
    parameters of a wrong model.
    """
    noise = problem.noise
    alone = Weights(noise, np.ones_like(noise))
    fitted = fit(problem, FitStart(p=p, weights=alone, stepping=stepping), iterations=1, probe=True)
    weights = (
        residual_weights(fitted.residuals, noise, problem.window)
        if fitted.residuals
        # the model diverged and has no residuals: a correlation length of 30 samples is assumed
        else Weights(noise, np.full_like(noise, 30.0))
    )
    fitted = fit(
        problem,
        FitStart(p=p, weights=weights, stepping=fitted.stepping, known=fitted.known),
        progress=progress,
        tolerance=1e-2,
        iterations=FIRST_STEPS,
        exact=False,
    )
    for rounds_left in range(ROUNDS - 2, -1, -1):
        if not fitted.residuals:
            break
        # Weights change between fits and not within a fit: a cost that moves with every step has no
        # minimum to converge to.
        weights = residual_weights(fitted.residuals, noise, problem.window)
        fitted = fit(
            problem,
            replace(fitted.end, weights=weights, continuity=(), known=fitted.known),
            exact=rounds_left == 0,
            progress=progress,
            tolerance=1e-3,
        )
    for _ in range(ROUNDS):
        if fitted.converged or not fitted.residuals:
            break
        # A candidate begins elsewhere and may converge. What it gains by that would be counted as
        # the gain of its effect.
        fitted = fit(problem, fitted.end, progress=progress, tolerance=1e-3)
    return fitted


def fit_in_stages(problem: Problem, *, progress: Progress | None = None) -> Fit:
    """Fit robustly from the data sheet, with the groups of `Rig.on_request` held at first.

    The shape of a body can be estimated only if the simulated motion is nearly right. Without motor
    inertia a light wrist moves far too fast. A shape that is free from the beginning then leads to
    a local minimum.
    """
    parameters = problem.assembly.parameters
    groups = problem.assembly.rig.on_request.values()
    late = {p.name for group in groups for p in group}
    early = tuple(i for i in problem.free if parameters[i].key not in late)
    # with the posterior of an earlier fit, all parameters have good initial values
    if early == problem.free or problem.prior is not None:
        return fit_robustly(problem, progress=progress)
    first = fit_robustly(replace(problem, free=early), progress=progress)
    return fit_robustly(problem, p=first.p, progress=progress)
