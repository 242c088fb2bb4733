"""Starting values of a parameter over which the misfit has many narrow minima, such as the step by
which a command is rounded: no slope leads between them.

Every value v of a grid is tried by a run, no fit; these runs go side by side. What the rig's
parameters, the windows' starts and the other amounts of the effect could take up is projected out
of the residual r(v),

    misfit(v) = |(I - Q Q') r(v)|^2,    J(v) = Q R,

with J the derivatives by these where the effect is at its null, or where a fit has led it: variable
projection (Golub and Pereyra 1973, SIAM J. Numer. Anal. 10(2)) to first order. A grid fine enough
for the amplitudes of all windows is tried on a part of them; its best values, on all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.llvm_ir import LANES
from pamid.engine.program import Stepping
from pamid.engine.simulator import DIFFERENCE
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights
from pamid.model.bound_parameter import Bound
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, Window

# values of a scanned parameter that are best on a part and tried on all fitted data, and of these
# the ones to start from
SCAN_CHECKED, SCAN_STARTS = 24, 2
SCAN_SAMPLES = 4000  # on which all values are tried


class Linearisation(NamedTuple):
    """Weighted residuals of all windows in a row, infinite if the model does not stay finite; and
    per window the derivatives of the outputs by the free parameters, and then by its start."""

    residual: Array
    slopes: list[Array]


@dataclass(frozen=True, eq=False)
class ScanPart:
    """Part of the recordings for a scan.

    Windows with their starts (states per track), and the parameters (SI) of the model without the
    effect; most: samples, in whole windows, at least two of every track; with_effect: the
    parameters are of a model with the effect, whose other amounts stay at their values instead of
    their null.
    """

    problem: Problem
    p: Array
    starts: tuple[Array, ...]
    weights: Weights
    stepping: Stepping
    most: int | None = None
    with_effect: bool = False
    _known: dict[bytes, Linearisation] = field(default_factory=dict, init=False, repr=False)

    def windows(self, track: Track) -> list[Window]:
        """The first windows of a track that have no more samples than its share, two at least."""
        windows = self.problem.windows(track)
        if self.most is None:
            return windows
        share = self.most // len(self.problem.tracks)
        return [w for k, w in enumerate(windows) if k < 2 or w.stop <= share]

    def linearised(self, p: Array) -> Linearisation:
        """Linearisation at these parameters (SI).

        It is kept: an effect at its null is the same for all scanned parameters, and the run of a
        robot with all derivatives takes seconds.
        """
        key = p.tobytes()
        if key not in self._known:
            self._known[key] = self._linearised(p)
        return self._known[key]

    def _linearised(self, p: Array) -> Linearisation:
        problem, rows, slopes = self.problem, [], []
        for track, x in zip(problem.tracks, self.starts, strict=True):
            runner = Runner(problem.assembly, track, self.stepping, problem.free)
            values, windows = runner.parameters(p), self.windows(track)
            root, memory = self.weights.root[track.seen], runner.memory(values)
            runs = runner.run_windows(memory, windows, x[: len(windows)], values, True)
            for window, run in zip(windows, runs, strict=True):
                left = (track.y[window.start : window.stop] - run.Y)[:, track.seen] * root
                rows.append(left.ravel() if run.fine else np.full(left.size, np.inf))
                by_sample = run.JY[:, track.seen] * root[:, None]
                width = len(problem.free) + runner.start_states
                slopes.append(by_sample.reshape(left.size, -1)[:, :width])
        return Linearisation(np.concatenate(rows), slopes)


def scanned_values(part: ScanPart, whole: ScanPart, place: int) -> list[float]:
    """Values (SI) of the parameter in this place with the least misfit on the whole, the best
    first.

    Only values that leave less than the effect at its null. Candidates are those that are best on a
    part.
    """
    if part.problem.assembly.program.keeps_slopes:  # a run is expensive there
        return []
    grid = scan_grid(part.problem.assembly.parameters[place])
    # Narrow minima need a fine grid, and a run of all windows per value would cost as much as a
    # refit. The part rejects nearly all values.
    best = _least(part, place, grid, SCAN_CHECKED)
    return _least(whole, place, best, SCAN_STARTS).tolist()


def _least(where: ScanPart, place: int, values: Array, count: int) -> Array:
    """So many of these values, the least misfit first.

    Amounts of the same effect stay at their null, or where they were found, and are projected out
    at every value, too: a force of a given period is linear in them."""
    problem, assembly = where.problem, where.problem.assembly
    owner = assembly.parameters[place].owner
    owned = [i for i in problem.free if assembly.parameters[i].owner == owner]
    amounts = tuple(i for i in owned if i != place)
    at = where.p.copy()
    for i in [place] if where.with_effect else owned:
        null = assembly.parameters[i].null
        at[i] = at[i] if null is None else null
    residual, slopes = where.linearised(at)
    if not np.isfinite(residual).all() or not len(values):
        return values[:0]
    common = [k for k, i in enumerate(problem.free) if i not in owned]
    # To first order a single projection serves all values of the grid. Only the slopes by the
    # amounts are formed at each value.
    free = _Orthogonal.to(
        [part[:, [*common, *range(len(problem.free), part.shape[1])]] for part in slopes],
        len(common),
    )
    least = float((free.part_of(residual[:, None]) ** 2).sum())
    misfits = np.full(len(values), np.inf)  # where the model blows up
    for first in range(0, len(values), LANES):
        residuals, slopes_there = _side_by_side(
            where, at, place, values[first : first + LANES], amounts
        )
        finite = np.flatnonzero(np.isfinite(residuals).all(axis=0))
        for k, left in zip(finite, free.part_of(residuals[:, finite]).T, strict=True):
            if amounts:
                further = np.linalg.qr(free.part_of(slopes_there[:, k]))[0]
                left = left - further @ (further.T @ left)
            misfits[first + k] = left @ left
    # Equal misfits keep the grid's order, which begins at the upper end of the range.
    order = np.argsort(misfits, kind="stable")[:count]
    return values[[i for i in order if misfits[i] < least]]


class _Orthogonal(NamedTuple):
    """The space orthogonal to slopes by shared parameters and by every window's start: orthonormal
    bases of each window's rows, and of the shared slopes without these (rows, shared)."""

    windows: list[Array]
    shared: Array

    @classmethod
    def to(cls, slopes: list[Array], shared: int) -> _Orthogonal:
        """slopes: of each window (its rows, shared parameters and then its start)."""
        # A window's start acts on that window alone. The projection by blocks avoids a dense
        # matrix of all starts.
        windows = [np.linalg.qr(part[:, shared:])[0] for part in slopes]
        alone = cls(windows, np.zeros((sum(map(len, slopes)), 0)))
        joined = alone.part_of(np.concatenate([part[:, :shared] for part in slopes]))
        return cls(windows, np.linalg.qr(joined)[0])

    def part_of(self, columns: Array) -> Array:
        """The part of columns (rows, any number) that lies in the space."""
        out, row = np.empty_like(columns), 0
        for basis in self.windows:
            part = columns[row : row + len(basis)]
            out[row : row + len(basis)] = part - basis @ (basis.T @ part)
            row += len(basis)
        out -= self.shared @ (self.shared.T @ out)
        return out


def _side_by_side(
    where: ScanPart, at: Array, place: int, values: Array, amounts: tuple[int, ...]
) -> tuple[Array, Array]:
    """Weighted residuals of all windows in a row (rows, values), and their differences by the
    amounts (rows, values, amounts): each value has a lane, and another for each amount."""
    problem, program = where.problem, where.problem.assembly.lane_program
    bounds = problem.assembly.parameters
    width = 1 + len(amounts)
    p = np.repeat(at[:, None], len(values) * width, axis=1)
    p[place] = np.repeat(values, width)
    steps = np.ones(len(amounts))
    for k, i in enumerate(amounts):
        b = bounds[i]
        size = DIFFERENCE * max(abs(at[i]), b.spread * (abs(at[i]) if b.log else 1.0))
        # A step beyond the range might leave the region where the equation is defined.
        steps[k] = -size if at[i] + size > b.high else size
        p[i, k + 1 :: width] += steps[k]
    rows = []
    for track, x in zip(problem.tracks, where.starts, strict=True):
        # Values that belong to a track replace those of the parameter vector in every lane.
        known = list(track.known)
        p[known] = track.p[known, None]
        windows = where.windows(track)
        edges = np.array([windows[0].start, *(w.stop for w in windows)])
        begun = np.stack([problem.assembly.start(q) for q in p.T], axis=1)
        memory = program.memory(begun, stepping=where.stepping, period_s=track.period_s)
        Y, _, _ = program.run_windows(
            memory,
            track.inputs,
            p,
            edges,
            np.repeat(x[: len(windows), :, None], p.shape[1], axis=2),
            stepping=where.stepping,
        )
        left = (track.y[: edges[-1], :, None] - Y)[:, track.seen] * where.weights.root[
            track.seen, None
        ]
        rows.append(left.reshape(-1, len(values), width))
    joined = np.concatenate(rows)
    return joined[:, :, 0], (joined[:, :, 1:] - joined[:, :, :1]) / steps


def scan_grid(bound: Bound) -> Array:
    """Values from the upper end of a parameter's range down; see `Parameter.scan`."""
    step, count, power = (*bound.scan, -1.0)[:3]
    return np.asarray(bound.high * (1.0 + step * np.arange(count)) ** power)
