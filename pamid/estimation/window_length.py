"""Length of the windows of a fit: so short that a Gauss-Newton step does what it promises.

Over a long window the misfit of an unstable or barely damped machine has many minima, and a step
from the data sheet raises it. Over a shorter window the outputs depend nearly linearly on the
parameters and on the state at its start (Ribeiro, Tiels, Umenberger, Schoen and Aguirre 2020,
Automatica 121). The ratio of the decrease to that of the linear model decides, as in a trust region
(Nocedal and Wright 2006, Numerical Optimization, 2nd ed., ch. 4.1).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pamid.estimation.grey_box import model_with
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import SHORTEST, Problem, free_parameters
from pamid.estimation.weights import Weights, residual_weights
from pamid.simulation.data_split import DataSplit

LEAST_RATIO = 0.25  # of the decrease to the promised one: below it a trust region is made smaller
SEEN = 60.0  # correlation times of the recordings on which the step is tried


def with_linear_windows(evidence: DataSplit) -> DataSplit:
    """The evidence, with windows halved until the first Gauss-Newton step from the data sheet
    lowers the misfit by a quarter of what it promises; unchanged where no length does.

    Parameters
    ----------
    evidence
        Recordings of a rig, with windows by their correlation time.
    """
    part = evidence.excerpt(SEEN, SEEN)
    assembly = model_with(part, (), observed_sizes(part))
    tracks = part.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    halved = 1.0
    while problem.window / halved >= SHORTEST:
        timescale_s = evidence.timescale_s / halved
        shorter = tuple(replace(t, timescale_s=timescale_s) for t in tracks)
        if decrease_ratio(replace(problem, tracks=shorter)) >= LEAST_RATIO:
            return replace(evidence, timescale_s=timescale_s)
        halved *= 2.0
    return evidence


def decrease_ratio(problem: Problem) -> float:
    """Decrease of the cost by the first Gauss-Newton step over that of the linear model; minus
    infinity where the model runs away."""
    white = Weights(problem.noise, np.ones_like(problem.noise))
    first = fit(problem, weights=white, iterations=1, exact=False)
    if not first.residuals:
        return -np.inf
    weights = residual_weights(first.residuals, problem.noise, problem.window)
    shooting, begun = begin(problem, weights=weights, known=first.known, probe=True)
    if not begun.point.normal.fine:
        return -np.inf
    promised = begun.point.cost - shooting.predicted_cost(begun.point)
    reached = shooting.moved(begun.point, shooting.step(begun.point, 0.0), last=True)
    # at the data sheet already: nothing is promised
    return (begun.point.cost - reached.cost) / promised if promised > 1.0 else 1.0
