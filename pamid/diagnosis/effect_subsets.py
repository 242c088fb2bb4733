"""Which effects might act together: best subsets of what the screened candidates change.

Of every candidate e two things are known in the rows r of the baseline's least squares
(`pamid.estimation.linear_rows`) where it was screened: what it changes at its best screened start,
D_e = r(e) - r(baseline), and the derivatives T_e of that by its own parameters. With parameters and
window starts projected out (P, onto what their derivatives cannot make), the gain of a set S of
effects is to first order

    gain(S) = |P r|^2 - min_(a,b) [ |P (r + sum_(e in S) (a_e D_e + T_e b_e))|^2 + sum |b_e|^2 ]

which needs inner products alone, so that every pair and triple of other families is looked at. It
only says which are refitted jointly: held-out windows decide. Frisch and Waugh (1933), Econometrica
1:387, for the projection; Miller (2002), Subset Selection in Regression, section 3.5, for all
subsets in the place of a greedy path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.screening import Screened, ScreeningBaseline
from pamid.estimation.linear_rows import linear_rows
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Responding(Work[Screened, Array]):
    """What a screened candidate changes in the rows of the baseline, less what parameters and window
    starts could change as well: (rows, 1 + own parameters), D_e and T_e."""

    what = "response of"
    evidence: DataSplit
    reference: ScreeningBaseline
    ground: Array  # the baseline's rows
    spanned: Array  # orthonormal columns that span what parameters and starts change

    def __call__(self, item: Screened) -> Plain:
        assert item.assembly is not None and item.p is not None and item.stepping is not None
        problem = self.reference.problem(self.evidence, item.assembly)
        base = self.reference.baseline.fit
        rows = linear_rows(
            problem,
            item.p,
            item.starts,
            base.weights,
            base.continuity,
            item.stepping,
            self.reference.settings.subset_rows,
        )
        own = {b.key for b in item.assembly.parameters if b.owner == item.attachment.label}
        keys = [item.assembly.parameters[i].key for i in problem.free]
        shared = [i for i, key in enumerate(keys) if key not in own]
        # the own parameters' rows of the data sheet are left out: the baseline has none
        kept = [*range(len(rows.away) - len(keys)), *(len(rows.away) - len(keys) + i for i in shared)]
        tangents = rows.by_parameters[np.ix_(kept, [i for i, key in enumerate(keys) if key in own])]
        found = np.column_stack([rows.away[kept] - self.ground, tangents])
        return {"columns": found - self.spanned @ (self.spanned.T @ found)}

    def restored(self, item: Screened, found: Plain) -> Array:
        columns: Array = found["columns"]
        return columns

    def name(self, item: Screened) -> str:
        return item.attachment.label


@dataclass(frozen=True, eq=False)
class Responses:
    """Projected responses of screened candidates. gram: inner products of all their columns;
    against: of each with the baseline's projected residual; places: columns of each candidate."""

    screened: list[Screened]
    gram: Array
    against: Array
    places: list[range]
    slack: float

    def gain(self, members: Sequence[int]) -> float:
        """To first order, of these candidates together, in units of the fit's cost; 0 where one of
        them would have to change the rows the other way round."""
        at = np.concatenate([self.places[i] for i in members])
        own = np.concatenate([np.arange(len(self.places[i])) > 0 for i in members])
        A = self.gram[np.ix_(at, at)] + np.diag(np.where(own, 1.0, self.slack))
        steps = -np.linalg.solve(A, self.against[at])
        return float(-steps @ self.against[at])


def responses_of(
    evidence: DataSplit, reference: ScreeningBaseline, screened: list[Screened], pool: WorkerPool
) -> Responses:
    """Of all screened candidates, each linearised where its screening has ended."""
    base = reference.baseline
    ground = linear_rows(
        reference.problem(evidence, base.assembly),
        reference.p,
        reference.starts,
        base.fit.weights,
        base.fit.continuity,
        base.fit.stepping,
        reference.settings.subset_rows,
    )
    spanned = _span(np.column_stack([ground.by_parameters, ground.by_starts]))
    work = Responding(evidence, reference, ground.away, spanned)
    found = pool.run(work, screened)
    kept = [
        (s, columns)
        for s, columns in zip(screened, found, strict=True)
        if not isinstance(columns, Failed) and np.isfinite(columns).all()
    ]
    everything = np.column_stack([columns for _, columns in kept])
    edges = np.cumsum([0, *(columns.shape[1] for _, columns in kept)])
    gram = everything.T @ everything
    return Responses(
        [s for s, _ in kept],
        gram,
        everything.T @ (ground.away - spanned @ (spanned.T @ ground.away)),
        [range(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)],
        1e-9 * float(gram.diagonal().max()),
    )


def _span(columns: Array) -> Array:
    """Orthonormal columns with the same span."""
    u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return u[:, s > 1e-9 * s[0]]


def best_subsets(
    responses: Responses, family_of: dict[str, str], size: int
) -> list[tuple[float, tuple[Screened, ...]]]:
    """The best set of `size` candidates of every combination of as many families, with its gain,
    the largest first."""
    families = [family_of[s.attachment.label] for s in responses.screened]
    best: dict[frozenset[str], tuple[float, tuple[int, ...]]] = {}
    for members in combinations(range(len(families)), size):
        names = frozenset(families[i] for i in members)
        if len(names) == size:
            gain = responses.gain(members)
            if names not in best or gain > best[names][0]:
                best[names] = gain, members
    return [
        (gain, tuple(responses.screened[i] for i in members))
        for gain, members in sorted(best.values(), key=lambda e: (-e[0], e[1]))
    ]
