"""Error that the noise of the sensors alone causes, through the fitted parameters as well.

A noise floor holds the parameters at their fitted values. Over a long run of a machine that forgets
nothing, such as the angle of a motor, small errors of many parameters add up; a model that lacks
nothing then errs by more than that floor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import seen_mean
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit
from pamid.estimation.weights import Weights
from pamid.simulation.replay import Replay, noise_floor

Array = NDArray[np.float64]

DRAWS = 5  # of the parameters; their median is used


def predictive_floor(fitted: Fit, runs: Sequence[Replay], noise: Array, seed: int) -> Array:
    """Mean absolute error per channel (SI) of models that lack nothing but exact parameters.

    The truth is the fitted model plus sensor noise. It is compared with the model at parameters
    that a fit to such noise could have found (Laplace's approximation). Median over the draws;
    infinite where most of them diverge.

    Parameters
    ----------
    fitted
        The fit, at the parameters taken as the truth.
    runs
        Its replays of the held-out recordings.
    noise
        Of the sensors, per channel (SI).
    seed
        Of parameters and noise.
    """
    assembly, errors = fitted.problem.assembly, []
    for p in _draws(fitted, noise, seed):
        floors = [
            noise_floor(assembly, p, run, fitted.stepping, noise, seed + i)
            for i, run in enumerate(runs)
        ]
        finite = all(floor.finite for floor in floors)
        losses = np.concatenate([floor.losses(1) for floor in floors])
        errors.append(seen_mean(losses) if finite else np.full(losses.shape[1], np.inf))
    return np.asarray(np.median(errors, axis=0))


def _draws(fitted: Fit, noise: Array, seed: int) -> Iterator[Array]:
    """Parameters (SI) from the posterior of a fit whose residuals are the noise, within bounds."""
    problem = fitted.problem
    exact = fit(
        problem,
        p=fitted.p,
        starts=fitted.starts,
        weights=Weights(noise.copy(), np.ones_like(noise)),
        stepping=fitted.stepping,
        continuity=fitted.continuity,
        iterations=0,
    )
    free, scale = list(problem.free), problem.scale
    variances, directions = np.linalg.eigh(exact.covariance)
    spread = directions * np.sqrt(np.maximum(variances, 0.0))
    centre, random = scale.inside(fitted.p[free]), np.random.default_rng(seed)
    for _ in range(DRAWS):
        drawn = centre + spread @ random.standard_normal(len(free))
        p = fitted.p.copy()
        p[free] = scale.outside(np.clip(drawn, scale.low, scale.high))
        yield p
