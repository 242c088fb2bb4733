"""Restart of fits that ended in a local minimum: initial states estimated anew, or other values.

The states at the window starts are estimated once, with the first parameters, and then fitted with
them. Where something sticks (friction, play) the outputs do not depend on such a state within some
range, so that no derivative leads out of it. The fit ends short of the optimum, and its interval
misses the truth. States estimated anew with the fitted parameters are nearly right, and the fit
goes on to the optimum. Three steps show whether the cost falls; a fit without a local minimum is
returned unchanged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.damped_gauss_newton import iterate
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.problem import Fit, FitStart
from pamid.estimation.robust_fit import fit_in_stages, fit_robustly
from pamid.estimation.weights import residual_weights

SHORTER = 0.25  # of a window: where a fit begins that long windows would trap
RESTARTS = 4  # starting parameters drawn from the priors for a fit that failed
DRAW_STEPS = 8  # that each is given
# of the cost, or of what another model removed of the held-out error: a fit from elsewhere that
# reaches it shows that the old fit was a trap
TRAPPED = 0.5
SAME_COST = 1.1  # ratio of the costs of two fits that ended alike
# Gauss-Newton steps of a fit that begins along another; share of the cost that ends it
REFIT_ITERATIONS, REFIT_TOLERANCE = 15, 0.02
PROBE_STEPS = 3  # that show whether the cost falls
REWEIGHT_ROUNDS = 2  # of weights that follow the residuals


def escape_local_minimum(fitted: Fit, noise: Array) -> Fit:
    """The fit; where it ended in a local minimum, the fit reached from states estimated anew.

    noise: of the sensors, per channel (SI).
    """
    if not fitted.residuals:
        return fitted
    shooting, begun = begin(fitted.problem, replace(fitted.end, starts=None), probe=True)
    if not begun.point.normal.fine:
        return fitted
    # New states cost a little at first, because they were not fitted. A fall by half within three
    # steps is no accident.
    probe = iterate(shooting, begun, PROBE_STEPS)
    if not probe.point.cost < TRAPPED * fitted.cost:
        return fitted
    return reweighted(shooting.resumed(probe), noise)


def reweighted(fitted: Fit, noise: Array) -> Fit:
    """The fit continued with weights that follow its residuals."""
    for _ in range(REWEIGHT_ROUNDS):
        weights = residual_weights(fitted.residuals, noise, fitted.problem.window)
        refit = fit(
            fitted.problem,
            replace(fitted.end, weights=weights, continuity=()),
        )
        if not refit.residuals:
            break
        fitted = refit
    return fitted


def fit_from_shorter_windows(fitted: Fit) -> Fit:
    """The fit, or a fit that begins at the parameters found with windows of a quarter of the
    length, where that leaves clearly less.

    A motion with contacts changes after every impact. Over a long window the misfit has a minimum
    for every order of impacts, over a short window there are few of them. An arm whose payload is
    not in the model falls another way. The misfit of a long window then has many minima, or a
    narrow, curved valley in which the fit does not converge. Growing windows are the usual way past
    (Ribeiro, Tiels, Umenberger, Schoen, Aguirre 2020, Automatica 121, on the smoothness of
    nonlinear system identification).
    """
    problem = fitted.problem
    period = max(problem.tracks, key=len).period_s
    short = replace(problem, window_s=SHORTER * problem.window * period)
    if not short.window < problem.window:
        return fitted
    begun = fit_in_stages(short)
    if not begun.residuals:
        return fitted
    # The short windows give parameters only. Their many free starts would hide what the model
    # lacks.
    grown = fit_robustly(problem, p=begun.p)
    return grown if closeness(grown) > closeness(fitted) - np.log(TRAPPED) else fitted


def closeness(fitted: Fit) -> float:
    """Minus the sum over channels of the logarithms of the residuals' sizes."""
    return float(np.log(fitted.weights.root).sum()) if fitted.residuals else -np.inf


def refound(fitted: Fit) -> bool:
    """Whether a fit from the data sheet, with the same states at the window starts and the same
    weights, ends at the same cost."""
    repeated = fit(
        fitted.problem,
        replace(fitted.end, p=fitted.problem.start(), known=fitted.known),
        exact=False,
        iterations=REFIT_ITERATIONS,
        tolerance=REFIT_TOLERANCE,
    )
    lower, higher = sorted((repeated.cost, fitted.cost))
    return higher <= SAME_COST * lower


def is_failed(fitted: Fit) -> bool:
    """Whether the fit ended above the data sheet's cost, with the same weights and with window
    states estimated for it: it is then worse than no fit."""
    if not fitted.residuals:
        return True
    _, begun = begin(
        fitted.problem,
        replace(fitted.end, p=fitted.problem.start(), starts=None),
        probe=True,
    )
    return begun.point.normal.fine and begun.point.cost < fitted.cost


def fit_from_draws(fitted: Fit, noise: Array, seed: int) -> Fit:
    """The best of several fits that begin at draws from the priors and at the data sheet. Each
    takes a few steps, and the best is completed; the fit itself where none is better. noise: of
    the sensors, per channel (SI)."""
    problem, scale = fitted.problem, fitted.problem.scale
    random = np.random.default_rng(seed)
    weights = fitted.weights
    best, least = fitted, fitted.cost if fitted.residuals else np.inf
    for k in range(RESTARTS + 1):
        p = problem.start()
        if k:
            # From the prior itself, so that no range of starting values has to be invented.
            s = random.standard_normal(len(problem.free))
            p[list(problem.free)] = scale.outside(np.clip(s, scale.low, scale.high))
        tried = fit(problem, FitStart(p=p, weights=weights), iterations=DRAW_STEPS)
        if tried.residuals and tried.cost < least:
            best, least = tried, tried.cost
    return fitted if best is fitted else reweighted(best, noise)
