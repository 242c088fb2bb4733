"""Estimates of a fit: value, interval, a word, prior distance, bounds; from the Jacobian or the
bootstrap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.base.progress import Progress, silent
from pamid.base.schemas.estimates import Estimate
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, Problem
from pamid.model.background import pull_of
from pamid.model.bound_parameter import Bound

NORMAL_95 = 1.959964
SETTLED, SILENT = 0.3, 0.9  # posterior over prior standard deviation


def word_for(share: float) -> str:
    """Word for a posterior of this share of the prior's standard deviation."""
    return "settled" if share < SETTLED else "weak" if share < SILENT else "silent"


def estimates(fitted: Fit, draws: Array | None = None) -> dict[Bound, Estimate]:
    """The free parameters of a fit, in their order.

    draws (bootstrap draws x free, scaled) replace the Jacobian's intervals.
    """
    assembly, free, scale = fitted.problem.assembly, list(fitted.problem.free), fitted.problem.scale
    s = scale.inside(fitted.p[free])
    deviation = np.sqrt(np.maximum(fitted.covariance.diagonal(), 0.0))
    low_s, high_s = s - NORMAL_95 * deviation, s + NORMAL_95 * deviation
    if draws is not None:
        deviation = draws.std(axis=0)
        low_s, high_s = np.percentile(draws, [2.5, 97.5], axis=0)
    # A normal interval may leave the range, where the equation is not defined.
    low = scale.outside(np.clip(low_s, scale.low, scale.high))
    high = scale.outside(np.clip(high_s, scale.low, scale.high))
    out = {}
    for k, i in enumerate(free):
        b = assembly.parameters[i]
        width = abs(float(scale.high[k] - scale.low[k])) if np.isfinite(scale.high[k]) else 1.0
        # Relative to the range: a fit clips to the bound exactly, but a restored file has rounded
        # once.
        edge = 1e-6 * max(1.0, width)
        at_low, at_high = s[k] <= scale.low[k] + edge, s[k] >= scale.high[k] - edge
        out[b] = Estimate(
            value=float(fitted.p[i] / b.factor),
            low=float(low[k] / b.factor),
            high=float(high[k] / b.factor),
            prior=b.value / b.factor,
            strain=float(abs(s[k])),
            unit=b.unit,
            word=word_for(float(deviation[k])),
            at_bound="low" if at_low else "high" if at_high else None,
            source=b.source,
            null=None if b.null is None else b.null / b.factor,
        )
    return out


def bootstrap(
    fitted: Fit,
    count: int,
    *,
    seed: int = 0,
    pool: WorkerPool | None = None,
    progress: Progress = silent,
) -> Array:
    """Refits with windows drawn with replacement (a block bootstrap: residuals are correlated
    within a window), and with the priors drawn anew: the data sheet and an earlier fit's. Without
    the second a parameter of which the recordings say nothing would not vary at all; with it, it
    keeps the width of its prior. Draws x free parameters in prior spreads; a draw that fails
    is missing. pool: who does the refits (default: this process).

    Kuensch (1989), Ann. Statist. 17(3), 1217-1241; randomised priors: Bardsley, Solonen, Haario and
    Laine (2014), SIAM J. Sci. Comput. 36(4), A1895-A1910."""
    draws = (pool or WorkerPool()).run(_BootstrapWork(fitted, seed), range(count), progress)
    return np.array([draw for draw in draws if not isinstance(draw, Failed)])


@dataclass(frozen=True, eq=False)
class _BootstrapWork(Work[int, Array]):
    """A refit to a drawing; items are their numbers."""

    what = "bootstrap draw"
    fitted: Fit
    seed: int

    def __call__(self, item: int) -> Array:
        f, problem, random = (
            self.fitted,
            self.fitted.problem,
            np.random.default_rng([self.seed, item]),
        )
        windows = sum(len(problem.windows(t)) for t in problem.tracks)
        # a window that was drawn k times counts k times; 0 leaves it out
        importance = np.bincount(random.integers(0, windows, windows), minlength=windows).astype(
            float
        )
        drawn: Problem = replace(
            problem,
            importance=importance,
            sheet=random.standard_normal(len(problem.free)),
            prior=problem.prior and problem.prior.drawn(random),
        )
        done = fit(
            drawn,
            # A draw is a small change of the data, so that it starts from the fit and needs few
            # steps.
            replace(f.end, continuity=()),
            iterations=8,
            tolerance=1e-2,
        )
        return problem.scale.inside(done.p[list(problem.free)])


def background_pull(fitted: Fit) -> dict[str, float]:
    """Deviation of every background term, in tolerances, by its name and place (force_map_1)."""
    terms = fitted.problem.assembly.background_terms
    strains: dict[str, list[float]] = {owner: [] for owner in terms}
    for i, b in enumerate(fitted.problem.assembly.parameters):
        if b.nuisance and b.fitted:
            strains[b.owner].append(float((fitted.p[i] - b.value) / b.spread))
    return {
        owner.removeprefix("background."): pull_of(terms[owner], pulls)
        for owner, pulls in strains.items()
    }
