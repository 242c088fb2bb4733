"""Lagged linear regression of outputs on inputs: a test for a response that needs no model of the
rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.model.assembly import Assembly
from pamid.simulation.data_split import DataSplit
from pamid.simulation.tracks import Track, track_of

# Of the error without inputs: above the first there is no response, below the second a clear
# response. Chance correlations of smooth outputs reach 0.73 (benchmarks/nonsense.py).
ABSENT_RATIO, CLEAR_RATIO = 0.9, 0.7
LONGEST_LAG_SHARE = 0.2  # of the longest recording
FOLDS = 5  # of the cross-validation
RIDGE_DAMPING = 1e-3  # damping per row, of standardised regressors
# shares of a recording by which a signal is shifted to see what chance does: 1 in 20 does as
# well by chance
CHANCE_SHIFTS = tuple(np.linspace(0.05, 0.95, 19).tolist())
STANDARDISED = 1e-12  # a regressor that varies by less of its size is a constant


@dataclass(frozen=True, eq=False)
class LaggedResponse:
    """Error of the regression with inputs over that without, per channel; `backwards`: the same
    with time reversed."""

    forward: Array
    backwards: Array

    @property
    def absent(self) -> NDArray[np.bool_]:
        """Channels that the inputs do not help to predict."""
        return self.forward >= ABSENT_RATIO

    @property
    def is_clear(self) -> bool:
        """Whether the inputs help to predict an output, more than by chance."""
        return float(self.forward.min()) < CLEAR_RATIO

    @property
    def is_reversed(self) -> bool:
        """Whether outputs precede inputs: the inputs help more with time reversed. The memory of a
        machine that forgets makes the forward direction the better direction."""
        least = float(self.backwards.min())
        return least < CLEAR_RATIO and least < ABSENT_RATIO * float(self.forward.min())


def lagged_response(data: DataSplit, model: Assembly) -> LaggedResponse | None:
    """Return how much the inputs help to predict the outputs; None where no input moves.

    For every channel y the increment y(t + h) - y(t) is regressed on y(t), on the increments before
    it, and on means of the inputs u (and of their squares) over lags from 0 to a fifth of the
    recording, h being the correlation time. Every fifth of each recording is predicted from the
    rest. Of the model only the inputs are used.
    """
    tracks = [
        track_of(model, r, data.channels, timescale_s=data.timescale_s) for r in data.recordings
    ]
    if not inputs_move(tracks):
        return None
    u = np.concatenate([t.u for t in tracks])
    centre, spread = u.mean(axis=0), np.where(np.ptp(u, axis=0) > 0.0, np.ptp(u, axis=0), 1.0)
    edges_s = _lag_edges(
        data.timescale_s, LONGEST_LAG_SHARE * max(len(t) * t.period_s for t in tracks)
    )

    def ratio(c: int, direction: int) -> float:
        parts = [
            (t.y[::direction, c], (t.u[::direction] - centre) / spread, t.period_s)
            for t in tracks
            if t.seen[c]
        ]
        return _error_ratio(parts, data.timescale_s, edges_s)

    channels = range(len(data.channels))
    forward, backwards = (
        np.array([ratio(c, direction) for c in channels]) for direction in (1, -1)
    )
    return LaggedResponse(forward, backwards)


def lagged_share(parts: Sequence[tuple[Array, Array, float]], timescale_s: float) -> float:
    """Share of the error of predicting a signal that its regression on another signal removes, as
    in `lagged_response`; 0 where it is no more than by chance.

    Chance is the share removed at circular shifts of the other signal, which keep its levels and
    its pace. parts: signal (n,), the other signal (n,) and sampling period (s) by recording;
    timescale_s: horizon of the prediction.
    """
    other = np.concatenate([x for _, x, _ in parts])
    if np.ptp(other) == 0.0:
        return 0.0
    longest_s = LONGEST_LAG_SHARE * max(len(y) * period_s for y, _, period_s in parts)
    edges_s = _lag_edges(timescale_s, longest_s)
    centre, spread = other.mean(), np.ptp(other)

    def ratio(shift: float) -> float:
        shifted = [
            (y, ((np.roll(x, round(shift * len(x))) - centre) / spread)[:, None], period_s)
            for y, x, period_s in parts
        ]
        return _error_ratio(shifted, timescale_s, edges_s)

    aligned = ratio(0.0)
    if aligned >= CLEAR_RATIO or aligned >= min(map(ratio, CHANCE_SHIFTS)):
        return 0.0
    return 1.0 - aligned


def inputs_move(tracks: Sequence[Track]) -> bool:
    """Return whether an input moves to and fro, from the lower third of its range to the upper
    third and back. After a single step any smooth output looks like a response."""
    for u in np.concatenate([t.u for t in tracks]).T:
        low, high = np.quantile(u, (0.05, 0.95))  # an outlier is no range
        if low == high:
            low, high = u.min(), u.max()
        third = (high - low) / 3.0
        sides = np.where(u < low + third, -1, np.where(u > high - third, 1, 0))
        if third > 0.0 and np.count_nonzero(np.diff(sides[sides != 0])) > 1:
            return True
    return False


def _lag_edges(first_s: float, last_s: float) -> Array:
    """Edges of lag intervals (s): 0, then doubling from an eighth of `first_s` up to `last_s`."""
    count = max(1, int(np.ceil(np.log2(max(8.0 * last_s / first_s, 2.0)))))
    # Doubling intervals cover long lags with few regressors; a response to an old input has lost
    # its detail.
    return np.concatenate([[0.0], first_s / 8.0 * 2.0 ** np.arange(count + 1)])


def _regressors(
    y: Array, u: Array, period_s: float, horizon_s: float, edges_s: Array
) -> tuple[list[Array], Array]:
    """Regressors of a recording (rows x columns) by the past output, the inputs and their squares,
    and the increments they are to predict (rows).

    Four rows per horizon, from two horizons on. Earlier inputs keep their first value.
    """
    n = len(y)
    h = min(max(2, round(horizon_s / period_s)), max(2, n // 8))
    # Increments, not values: a slow output is predicted well by its last value, whatever the
    # inputs do.
    end = np.arange(2 * h, n, max(1, h // 4))
    last, half, whole = (y[end - k] for k in (h, h + h // 2, 2 * h))
    edges = np.unique(np.round(edges_s / period_s).astype(int))
    stops = np.maximum(end[:, None] + 1 - edges[:-1], 1)
    starts = np.minimum(np.maximum(end[:, None] + 1 - edges[1:], 0), stops - 1)

    def means(signal: Array) -> Array:
        sums = np.concatenate([np.zeros((1, u.shape[1])), signal.cumsum(axis=0)])
        mean = (sums[stops] - sums[starts]) / (stops - starts)[..., None]
        return np.asarray(mean.reshape(len(end), -1))

    past = np.column_stack([last, last - half, last - whole])
    return [past, means(u), means(u**2)], y[end] - last


def _error_ratio(
    parts: Sequence[tuple[Array, Array, float]], horizon_s: float, edges_s: Array
) -> float:
    """Cross-validated error of the regression with inputs over that without: summed absolute
    errors, each fifth of a recording predicted from everything else.

    parts: by recording, output (n,), inputs (n, inputs) and sampling period (s).
    """
    rows = [_regressors(y, u, period_s, horizon_s, edges_s) for y, u, period_s in parts]
    y = np.concatenate([increments for _, increments in rows])
    # Folds are contiguous stretches. Rows drawn at random would be predicted from their correlated
    # neighbours.
    fold = np.concatenate([np.arange(len(r)) * FOLDS // max(len(r), 1) for _, r in rows])
    errors = []
    for count in (1, 2, 3):  # groups of regressors: the past, with the inputs, with their squares
        x = np.concatenate([np.concatenate(groups[:count], axis=1) for groups, _ in rows])
        error = 0.0
        for k in range(FOLDS):
            held = fold == k
            if held.any() and not held.all():
                error += float(np.abs(y[held] - _ridge(x[~held], y[~held], x[held])).sum())
        errors.append(error)
    without, *with_inputs = errors
    return min(with_inputs) / without if without > 0.0 else 1.0


def _ridge(x: Array, y: Array, rows: Array) -> Array:
    """Predictions for `rows` of a ridge regression of y on x (Hoerl and Kennard 1970). Regressors
    and predictions stay within the range of x and y: extrapolation would decide."""
    centre, spread = x.mean(axis=0), x.std(axis=0)
    spread = np.where(spread > STANDARDISED * np.abs(x).max(axis=0), spread, np.inf)
    z = (x - centre) / spread
    # Means of neighbouring lags are nearly collinear.
    gram = z.T @ z + RIDGE_DAMPING * len(z) * np.eye(z.shape[1])
    weights = np.linalg.solve(gram, z.T @ (y - y.mean()))
    seen = np.clip(rows, x.min(axis=0), x.max(axis=0))
    return np.clip(y.mean() + (seen - centre) / spread @ weights, y.min(), y.max())
