"""Length of the windows of a fit, so that the first Gauss-Newton step lowers the misfit.

Over a long window, the misfit of an unstable or barely damped machine has many minima. A step from
the data-sheet parameters may then raise it. Over a shorter window, the outputs depend nearly
linearly on the parameters and on the initial state (Ribeiro, Tiels, Umenberger, Schoen and Aguirre
2020, Automatica 121).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pamid.estimation.grey_box import model_with
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import SHORTEST, FitStart, Problem, free_parameters
from pamid.estimation.weights import Weights, residual_weights
from pamid.simulation.data_split import DataSplit

SEEN = 60.0  # length of the data on which the step is tried, in correlation times
TIE = 2.0  # cost ratios that differ by no more do not justify shorter windows


def with_linear_windows(evidence: DataSplit) -> DataSplit:
    """Halve the windows until the first Gauss-Newton step from the data sheet lowers the misfit.

    Parameters
    ----------
    evidence
        Recordings of a rig. Their windows scale with the correlation time `timescale_s`.

    Returns
    -------
    The evidence with a shorter correlation time. If every step raises the misfit, the longest
    windows decide in which it rises to no more than `TIE` times the lowest ratio. If the model
    diverges in all of them, the evidence is unchanged.
    """
    excerpt = evidence.excerpt(SEEN, SEEN)
    assembly = model_with(excerpt, (), observed_sizes(excerpt))
    tracks = excerpt.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    ratios: dict[float, float] = {}
    divisor = 1.0
    while problem.window / divisor >= SHORTEST:
        timescale_s = evidence.timescale_s / divisor
        shorter_tracks = tuple(replace(t, timescale_s=timescale_s) for t in tracks)
        ratios[timescale_s] = cost_ratio_of_first_step(replace(problem, tracks=shorter_tracks))
        if ratios[timescale_s] <= 1.0:
            return replace(evidence, timescale_s=timescale_s)
        divisor *= 2.0
    lowest = min(ratios.values(), default=np.inf)
    if np.isinf(lowest):
        return evidence
    longest = max(time for time, ratio in ratios.items() if ratio <= TIE * lowest)
    return replace(evidence, timescale_s=longest)


def cost_ratio_of_first_step(problem: Problem) -> float:
    """Cost after the undamped step from the data sheet over the cost before; infinite if the model
    diverges."""
    noise_weights = Weights(problem.noise, np.ones_like(problem.noise))
    first = fit(problem, FitStart(weights=noise_weights), iterations=1, probe=True)
    if not first.residuals:
        return np.inf
    weights = residual_weights(first.residuals, problem.noise, problem.window)
    shooting, start = begin(problem, FitStart(weights=weights, known=first.known), probe=True)
    if not start.point.normal.fine:
        return np.inf
    end_point = shooting.moved(start.point, shooting.step(start.point, 0.0), last=True)
    return float(end_point.cost / start.point.cost)
