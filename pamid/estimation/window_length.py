"""Length of the windows of a fit: so short that the first Gauss-Newton step lowers the misfit.

Over a long window the misfit of an unstable or barely damped machine has many minima, and a step
from the data sheet raises it. Over a shorter window the outputs depend nearly linearly on the
parameters and on the state at its start (Ribeiro, Tiels, Umenberger, Schoen and Aguirre 2020,
Automatica 121).
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

SEEN = 60.0  # correlation times of the recordings on which the step is tried


def with_linear_windows(evidence: DataSplit) -> DataSplit:
    """The evidence, with windows halved until the first Gauss-Newton step from the data sheet
    lowers the misfit; unchanged where no length does.

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
        if first_step_helps(replace(problem, tracks=shorter)):
            return replace(evidence, timescale_s=timescale_s)
        halved *= 2.0
    return evidence


def first_step_helps(problem: Problem) -> bool:
    """Whether the undamped step from the data sheet lowers the cost; False where the model runs
    away."""
    white = Weights(problem.noise, np.ones_like(problem.noise))
    first = fit(problem, weights=white, iterations=1, exact=False)
    if not first.residuals:
        return False
    weights = residual_weights(first.residuals, problem.noise, problem.window)
    shooting, begun = begin(problem, weights=weights, known=first.known, probe=True)
    if not begun.point.normal.fine:
        return False
    reached = shooting.moved(begun.point, shooting.step(begun.point, 0.0), last=True)
    return bool(reached.cost <= begun.point.cost)
