"""Added-variable plots: what the refitted model leaves, over what a candidate adds to it.

With the rows r of the refitted model's least squares (`pamid.estimation.linear_rows`), the plot of
a candidate shows

    y = -P r   over   x = P (r(candidate) - r(candidate without its effect))

and a line of slope x'y / x'x. P projects out what the other parameters and the window starts can
make of either: their derivatives, and the change r(candidate without its effect) - r, which differs
from these where the refit has moved them far. By the theorem of Frisch, Waugh and Lovell the slope
is the coefficient of the effect in the joint least squares, as a multiple of its refitted size.

The derivative by the amount at the null would do for effects that are linear in it. It misses half
of a dead time, and of a saturation it sees what is left after the refitted gain has shrunk in its
place.

Frisch and Waugh (1933), Econometrica 1:387; Lovell (1963), JASA 58:993; Belsley, Kuh and Welsch
(1980), Regression Diagnostics, Wiley, section 2.1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.schemas.added_variables_file import AddedVariable, AddedVariablesFile
from pamid.base.units import size_from_si, split_column
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.pipeline import Diagnosis
from pamid.estimation.intervals import NORMAL_95
from pamid.estimation.linear_rows import LinearRows, left_over, linear_rows
from pamid.estimation.problem import Fit

PLOT_ROWS = 8000  # residuals to which the rows are thinned
PLOT_POINTS = 300  # shown, of a channel
DIGITS = 4  # of a point: a file half as large


def added_variables(d: Diagnosis) -> AddedVariablesFile:
    """Plots of a diagnosis: of several causes each in addition to the others, then of each
    candidate of the ranking alone."""
    # refitted models, and models that add an effect to each, with its label
    compared: list[tuple[CandidateModel, list[tuple[CandidateModel, str]]]] = []
    if d.cause is not None and d.selection is not None and len(d.cause.attached) > 1:
        compared += [
            (below, [(d.cause, label)])
            for label, below in d.selection.without.items()
            if len(below.attached) == len(d.cause.attached) - 1
        ]
    # what an effect at several ports adds is all of it
    compared.append((d.budget.baseline, [(c, c.label) for c in d.ranking]))
    plots = []
    for below, models in compared:
        if not models:
            continue
        fitted = below.fit
        ground = _rows(fitted, fitted, fitted.p, derivatives=True)
        pairs = [_with_and_without(fitted, c, label) for c, label in models]
        usable = [
            k for k, (a, b) in enumerate(pairs) if np.isfinite(a - b).all() and (a != b).any()
        ]
        if not ground.finite or not usable:
            continue
        k = len(fitted.problem.free)
        added = [pairs[i][0] - pairs[i][1] for i in usable]
        others = [pairs[i][1] - ground.away for i in usable]
        held = fitted.held != 0.0 if len(fitted.held) == k else np.zeros(k, bool)
        left, *columns = left_over(ground, np.column_stack([-ground.away, *added, *others]), held).T
        root = fitted.weights.root * np.sqrt(ground.every)
        company = tuple(a.label for a in below.attached)
        for i, x, other in zip(usable, columns[: len(usable)], columns[len(usable) :], strict=True):
            x, y = _without(x, other), _without(left, other)
            if x @ x > 0.0 and y @ y > 0.0:
                label = models[i][1]
                plots.append(_plot(label, company, ground, root, d.evidence.channels, x, y))
    return AddedVariablesFile(plots=tuple(plots))


def _without(column: Array, other: Array) -> Array:
    """A column less its part along another column."""
    size = float(other @ other)
    return column - other * (float(other @ column) / size) if size > 0.0 else column


def _rows(fitted: Fit, at: Fit, p: Array, *, derivatives: bool = False) -> LinearRows:
    """Rows of a fit's model at p, with the weights of the refitted model."""
    with np.errstate(over="ignore", invalid="ignore"):
        point = replace(at, p=p, weights=fitted.weights, continuity=fitted.continuity)
        return linear_rows(point, PLOT_ROWS, derivatives=derivatives)


def _with_and_without(fitted: Fit, model: CandidateModel, label: str) -> tuple[Array, Array]:
    """Rows of a model, and of it without any of its effects; of the data sheet those of the other
    parameters."""
    p, labels = model.fit.p.copy(), label.split(" + ")
    for i, bound in enumerate(model.assembly.parameters):
        if bound.owner in labels and bound.null is not None:
            p[i] = bound.null
    bounds = [model.assembly.parameters[i] for i in model.fit.problem.free]
    with_effect, without = (_rows(fitted, model.fit, values).away for values in (model.fit.p, p))
    counted = np.ones(len(without), bool)
    counted[len(without) - len(bounds) :] = [bound.owner not in labels for bound in bounds]
    return with_effect[counted], without[counted]


def _plot(
    label: str,
    company: tuple[str, ...],
    ground: LinearRows,
    root: Array,
    channels: tuple[str, ...],
    x: Array,
    y: Array,
) -> AddedVariable:
    """The slope over all rows, and the points of the channel that contributes most to it."""
    slope = float(x @ y / (x @ x))
    # the weights make the variance of an independent residual of the refitted model 1
    error = NORMAL_95 * float(np.sqrt(max(1.0 - _share(x, y), 0.0) / (x @ x)))
    parts = [abs(float(x[at] @ y[at])) for at in (ground.channel == c for c in range(len(root)))]
    channel = int(np.argmax(parts))
    places = np.flatnonzero((ground.channel == channel) & ((x != 0.0) | (y != 0.0)))
    shown = places[np.unique(np.linspace(0, len(places) - 1, PLOT_POINTS).round().astype(int))]
    unit = split_column(channels[channel])[1]
    added, residual = (size_from_si(v[shown] / root[channel], unit) for v in (x, y))
    return AddedVariable(
        effect=label,
        beside=company,
        channel=channels[channel],
        slope=slope,
        low=slope - error,
        high=slope + error,
        share=_share(x[places], y[places]),
        added=_rounded(added),
        residual=_rounded(residual),
    )


def _share(x: Array, y: Array) -> float:
    """Share of the squares of y that a line through zero over x explains."""
    return float((x @ y) ** 2 / (x @ x) / (y @ y))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.{DIGITS}g}") for value in values)
