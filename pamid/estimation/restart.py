"""A restart for fits that ended in a local minimum: initial states estimated anew.

The states in which windows begin are estimated once, with the first parameters, and then fitted
with them. Where something sticks (friction, play) the outputs do not depend on such a state within
some range, so no derivative leads out of it: the fit ends short of the optimum, and an interval
drawn there misses the truth. Estimated anew with the parameters found, the states are right or
nearly so, and the fit goes on to the optimum. Three steps show whether the cost falls; a fit that
is in no local minimum is returned as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.engine.damped_gauss_newton import iterate
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.problem import Fit
from pamid.estimation.weights import residual_weights

Array = NDArray[np.float64]

# of the cost: what a fit from new starts must come below for the old one to have been a trap
TRAPPED = 0.5
PROBE_STEPS = 3  # that show whether the cost falls
REWEIGHT_ROUNDS = 2  # of weights that follow the residuals


def escape_local_minimum(fitted: Fit, noise: Array) -> Fit:
    """The fit; where it ended in a local minimum, the one reached from initial states estimated
    anew. noise: of the sensors, per channel (SI)."""
    problem = fitted.problem
    if not fitted.residuals:
        return fitted
    shooting, begun = begin(
        problem,
        p=fitted.p,
        weights=fitted.weights,
        stepping=fitted.stepping,
        continuity=fitted.continuity,
        probe=True,
    )
    if not begun.point.normal.fine:
        return fitted
    probe = iterate(shooting, begun, PROBE_STEPS)
    if not probe.point.cost < TRAPPED * fitted.cost:
        return fitted
    tried = shooting.resumed(probe)
    for _ in range(REWEIGHT_ROUNDS):
        weights = residual_weights(tried.residuals, noise, problem.window)
        again = fit(
            problem, p=tried.p, starts=tried.starts, weights=weights, stepping=tried.stepping
        )
        if not again.residuals:
            break
        tried = again
    return tried
