"""Starting values of a parameter over which the misfit has many narrow minima, such as the step by
which a command is rounded: no slope leads from one of them to the next.

Every value v of a grid is tried by one run, no fit. What the rig's parameters, the windows' starts
and the other amounts of the effect could take up is projected out of the residual r(v),

    misfit(v) = |(I - Q Q') r(v)|^2,    J(v) = Q R,

with J the derivatives by these where the effect is at its null, or where a fit has led it: variable
projection (Golub and Pereyra 1973, SIAM J. Numer. Anal. 10(2)) to first order. A grid fine enough
for the amplitudes of all windows is tried on a part of them; its best values, on all.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.settings import Settings
from pamid.engine.program import Stepping
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights
from pamid.model.bound_parameter import Bound
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, Window

Array = NDArray[np.float64]


class Scanned(NamedTuple):
    """Where the misfit is asked: windows with their starts (states per track), and the parameters
    (SI) of the model without the effect; most: samples, of which whole windows are asked, two at
    least of every track; beside: these are of a model with the effect, whose other amounts count as
    they are found there, not at their null."""

    problem: Problem
    p: Array
    starts: tuple[Array, ...]
    weights: Weights
    stepping: Stepping
    most: int | None = None
    beside: bool = False


def scanned_values(part: Scanned, whole: Scanned, place: int, settings: Settings) -> list[float]:
    """The values (SI) of the parameter in this place with the least misfit on the whole, the best
    first, where they leave less than the effect at its null; of those tried that are best on a part
    of it."""
    if part.problem.assembly.program.keeps_slopes:  # a run is dear there
        return []
    grid = scan_grid(part.problem.assembly.parameters[place])
    best = _least(part, place, grid, settings.scanned_checked)
    return _least(whole, place, best, settings.scanned_starts).tolist()


def _least(where: Scanned, place: int, values: Array, count: int) -> Array:
    """So many of these values, the least misfit first.

    Amounts of the same effect stay at their null, or where they were found, and are projected out
    at every value, too: a force of a given period is linear in them."""
    problem, assembly = where.problem, where.problem.assembly
    owner = assembly.parameters[place].owner
    owned = [i for i in problem.free if assembly.parameters[i].owner == owner]
    amounts = tuple(i for i in owned if i != place)
    at = where.p.copy()
    for i in [place] if where.beside else owned:
        null = assembly.parameters[i].null
        at[i] = at[i] if null is None else null
    common = replace(problem, free=tuple(i for i in problem.free if i not in owned))
    residual, slopes = _residuals(where, common, at, slopes=True)
    if not np.isfinite(residual).all():
        return values[:0]
    basis = np.linalg.qr(slopes)[0]
    least, alone, found = _misfit(residual, basis), replace(problem, free=amounts), []
    for value in values:
        at[place] = value
        r, own = _residuals(where, alone, at, slopes=bool(amounts))
        found.append(_misfit(r, basis, own[:, : len(amounts)]))
    order = np.argsort(found, kind="stable")[:count]
    return values[[i for i in order if found[i] < least]]


def _misfit(residual: Array, basis: Array, further: Array | None = None) -> float:
    """Squares of what the columns of an orthonormal basis, and further ones, leave of it; endless
    where it is."""
    if not np.isfinite(residual).all():
        return float("inf")
    left = residual - basis @ (basis.T @ residual)
    if further is not None and further.size:
        own = np.linalg.qr(further - basis @ (basis.T @ further))[0]
        left = left - own @ (own.T @ left)
    return float(left @ left)


def _residuals(
    where: Scanned, problem: Problem, p: Array, *, slopes: bool = False
) -> tuple[Array, Array]:
    """Weighted residuals of all windows in a row, and their derivatives by the free parameters and
    every window's start; endless residuals where the model does not stay finite."""
    rows, parts = [], []
    for track, x in zip(problem.tracks, where.starts, strict=True):
        runner = Runner(problem.assembly, track, where.stepping, problem.free)
        values = runner.parameters(p)
        root, windows = where.weights.root[track.seen], _asked(where, track)
        runs = runner.run_windows(runner.memory(values), windows, x[: len(windows)], values, slopes)
        for window, run in zip(windows, runs, strict=True):
            left = (track.y[window.start : window.stop] - run.Y)[:, track.seen] * root
            rows.append(left.ravel() if run.fine else np.full(left.size, np.inf))
            if slopes:
                by_sample = run.JY[:, track.seen] * root[:, None]
                width = len(problem.free) + runner.start_states
                parts.append(by_sample.reshape(left.size, -1)[:, :width])
    return np.concatenate(rows), _joined(parts, len(problem.free)) if parts else np.empty((0, 0))


def _asked(where: Scanned, track: Track) -> list[Window]:
    """The first windows of a track that have no more samples than its share, two at least."""
    windows = where.problem.windows(track)
    if where.most is None:
        return windows
    share = where.most // len(where.problem.tracks)
    return [w for k, w in enumerate(windows) if k < 2 or w.stop <= share]


def _joined(parts: list[Array], shared: int) -> Array:
    """Rows of all windows: the shared columns, then those of every window's own start."""
    own = [part.shape[1] - shared for part in parts]
    joined = np.zeros((sum(map(len, parts)), shared + sum(own)))
    row, column = 0, shared
    for part, width in zip(parts, own, strict=True):
        joined[row : row + len(part), :shared] = part[:, :shared]
        joined[row : row + len(part), column : column + width] = part[:, shared:]
        row, column = row + len(part), column + width
    return joined


def scan_grid(bound: Bound) -> Array:
    """Values from the upper end of a parameter's range down, evenly spaced in 1/value."""
    step, count = bound.scan
    return np.asarray(bound.high / (1.0 + step * np.arange(count)))
