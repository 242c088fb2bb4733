"""Sets of effects that might act together: best subsets of the screened candidates' responses.

Every candidate e has two responses in the rows r of the baseline's least squares
(`pamid.estimation.linear_rows`) where it was screened. D_e = r(e) - r(baseline) is the change at
its best screened start, and T_e holds the derivatives of that by its parameters. With
parameters and window starts projected out by P, the gain of a set S of effects is to first order

    gain(S) = |P r|^2 - min [ |P (r + sum_e (a_e D_e + T_e b_e))|^2 + sum_e (a_e^2 + |b_e|^2) ]

with a_e >= 0 and b_e (in prior spreads) within the parameters' ranges. The term a_e^2 keeps a small
response from being scaled up to the whole gap. The gain needs inner products alone, so that every
pair can be evaluated. It only selects the sets to refit jointly, and held-out windows decide.
Frisch and Waugh (1933), Econometrica 1:387, for the projection; Miller (2002), Subset Selection in
Regression, section 3.5, for subsets in the place of a greedy path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.diagnosis.screening import ScreenedCandidate, ScreeningBaseline
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.estimation.linear_rows import linear_rows, moved_rows, orthonormal_span
from pamid.model.attachment import Addition
from pamid.model.step_rig import StepRig
from pamid.simulation.data_split import DataSplit

SUBSET_ROWS = 8000  # residuals to which the rows are thinned


@dataclass(frozen=True, eq=False)
class Response:
    """Response of a candidate in the rows of the baseline.

    columns (rows, 1 + its parameters): P D_e and P T_e; room: bounds of a_e and b_e within the
    ranges of its parameters.
    """

    columns: Array
    room: Array  # (1 + effect parameters, 2)


@dataclass(frozen=True, eq=False)
class ResponseWork(Work[ScreenedCandidate, Response]):
    """The response of a screened candidate. ground: the baseline's rows; spanned: orthonormal
    columns that span the effect of its parameters and window starts."""

    what = "response of"
    evidence: DataSplit
    reference: ScreeningBaseline
    ground: Array
    spanned: Array

    def __call__(self, item: ScreenedCandidate) -> Response:
        assembly, p = item.ended
        assert item.stepping is not None
        problem = self.reference.problem(self.evidence, assembly)
        base = self.reference.baseline.fit
        labels, bounds = item.added.labels, assembly.parameters
        of_effect = np.array([bounds[i].owner in labels for i in problem.free], bool)
        scale = problem.scale
        s = scale.inside(p[list(problem.free)])
        point = replace(base, problem=problem, p=p, starts=item.starts, stepping=item.stepping)
        # Derivatives of a rig that is stepped cost calls of its code, so that those of the
        # baseline are reused.
        if isinstance(assembly.rig, StepRig):
            rows = linear_rows(point, SUBSET_ROWS, known=self.reference.known)
            # the last rows are the data sheet's, and the baseline has none for the effect
            shared = np.concatenate([np.ones(len(rows.away) - len(of_effect), bool), ~of_effect])
            away, by_effect = rows.away[shared], rows.by_parameters[np.ix_(shared, of_effect)]
        # Equations are differentiated in lanes at little cost, so that only the effect's columns
        # are formed.
        else:
            away, by_effect = moved_rows(point, SUBSET_ROWS, np.flatnonzero(of_effect))
            sheet = s[~of_effect]
            away = np.concatenate([away, sheet])
            by_effect = np.concatenate([by_effect, np.zeros((len(sheet), by_effect.shape[1]))])
        columns = np.column_stack([away - self.ground, by_effect])
        room = np.column_stack([scale.low - s, scale.high - s])[of_effect]
        return Response(
            columns - self.spanned @ (self.spanned.T @ columns),
            np.concatenate([[[0.0, np.inf]], room]),
        )


@dataclass(frozen=True, eq=False)
class ScreenedResponses:
    """Responses of all candidates. gram: inner products of all their columns; against: those with
    the baseline's projected residual; places: every candidate's columns."""

    screened: list[ScreenedCandidate]
    gram: Array
    against: Array
    room: Array
    places: list[range]

    def gain(self, members: Sequence[int]) -> float:
        """gain(S) of these candidates: a quadratic programme with bounds, by an active set that
        takes in the worst offender until there is none."""
        at = np.concatenate([self.places[i] for i in members])
        A, g = self.gram[np.ix_(at, at)] + np.eye(len(at)), self.against[at]
        low, high = self.room[at].T
        x, free = np.zeros(len(at)), np.ones(len(at), bool)
        while free.any():
            # Bounds matter here: without them a subset could gain by a negative amount of dry
            # friction.
            held = A[np.ix_(free, ~free)] @ x[~free]
            # of least squares: where two columns are equal to rounding, A is singular
            x[free] = -np.linalg.lstsq(A[np.ix_(free, free)], g[free] + held, rcond=None)[0]
            beyond = np.where(free, np.maximum(low - x, x - high), 0.0)
            worst = int(beyond.argmax())
            if beyond[worst] <= 0.0:
                break
            x[worst] = np.clip(x[worst], low[worst], high[worst])
            free[worst] = False
        return float(-(2.0 * g + A @ x) @ x)


def responses_of(
    evidence: DataSplit,
    reference: ScreeningBaseline,
    screened: list[ScreenedCandidate],
    pool: WorkerPool,
) -> ScreenedResponses:
    """Responses of all screened candidates, each linearised where its screening has ended."""
    ground = linear_rows(reference.point, SUBSET_ROWS, known=reference.known)
    spanned = orthonormal_span(np.column_stack([ground.by_parameters, ground.by_starts]))
    responses = pool.run(ResponseWork(evidence, reference, ground.away, spanned), screened)
    finite = [
        (s, r)
        for s, r in zip(screened, responses, strict=True)
        if not isinstance(r, Failed) and np.isfinite(r.columns).all()
    ]
    columns = np.column_stack([np.zeros((len(ground.away), 0)), *(r.columns for _, r in finite)])
    edges = np.cumsum([0, *(len(r.room) for _, r in finite)]).tolist()
    return ScreenedResponses(
        [s for s, _ in finite],
        columns.T @ columns,
        columns.T @ ground.away,
        np.concatenate([np.zeros((0, 2)), *(r.room for _, r in finite)]),
        [range(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)],
    )


@dataclass(frozen=True)
class Subset:
    """Candidates that may act together. gain: see the module, in the unit of a fit's cost."""

    members: tuple[ScreenedCandidate, ...]
    gain: float

    @property
    def labels(self) -> frozenset[str]:
        return frozenset(label for s in self.members for label in s.added.labels)


def best_subsets(
    responses: ScreenedResponses,
    family: Callable[[Addition], str],
    size: int,
    settings: Settings = DEFAULT,
    apart: Callable[[Addition, Addition], bool] = lambda a, b: False,
) -> list[Subset]:
    """The best `size` (two or more) candidates of every combination of as many families.

    Returns the `subsets` best of these that gain beyond fewer candidates, by a minimum share of the
    best gain. A family occurs twice where two of it stand `apart`, at places that the recordings
    separate, such as gaps at two joints. Every pair is evaluated; larger sets add a candidate to
    each of the best smaller sets.
    """
    # A single law per family and place: two laws of friction at the same joint are a single cause.
    families = [family(s.added) for s in responses.screened]
    everyone = range(len(families))

    def at_once(i: int, j: int) -> bool:
        first, rest = responses.screened[i].added, responses.screened[j].added
        return families[i] != families[j] or apart(first, rest)

    # All single candidates stay, whatever they gain: two effects that cancel each other show no
    # gain alone.
    leading: list[tuple[float, tuple[int, ...]]] = [(responses.gain((i,)), (i,)) for i in everyone]
    fewer = 0.0
    for _ in range(size - 1):
        fewer = max((gain for gain, _ in leading), default=0.0)
        tried = {
            tuple(sorted((*m, i)))
            for _, m in leading
            for i in everyone
            if i not in m and all(at_once(i, j) for j in m)
        }
        best: dict[tuple[str, ...], tuple[float, tuple[int, ...]]] = {}
        for members in sorted(tried):
            names = tuple(sorted(families[i] for i in members))
            gain = responses.gain(members)
            if names not in best or gain > best[names][0]:
                best[names] = gain, members
        # Indices break ties of equal gains, so that the result does not depend on the order of a
        # set.
        leading = sorted(best.values(), key=lambda e: (-e[0], e[1]))[: settings.subsets]
    # a share, no size in nats: the weights are those of the baseline's residuals, and where the
    # first effect removes nearly all of these, an effect that halves the rest gains only a fraction
    least = settings.pair_share * max((gain - fewer for gain, _ in leading), default=0.0)
    return [
        Subset(tuple(responses.screened[i] for i in m), gain)
        for gain, m in leading
        if gain - fewer > max(least, 0.0)
    ]
