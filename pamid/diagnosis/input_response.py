"""Does a recording show this machine? The model's prediction with the recorded inputs is compared
with that of the same model without them. An effect that switches an input off (a saturation, a
dead zone, a gain of zero) may reproduce any smooth output by its free response, and explains
nothing. Where no input moves, the comparison is with forecasts that need no model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import block_sums, moving_block_interval, seen_mean
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.model.assembly import Assembly
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track, run_windows, warm_up
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

Array = NDArray[np.float64]

#: Circular shifts that stand for "without the inputs", as shares of the track; 0 holds every input
#: at its mean. A shifted input keeps what a rectifier or a relay makes of it, the mean does not.
SHIFTS = (0.0, 0.2, 0.4, 0.6, 0.8)
#: The lagged linear model: longest lag as a share of the recording, regressors that are past
#: outputs, parts of the cross-validation, rows (two horizons) whose error counts as one.
LONGEST_LAG = 0.2
PAST_OUTPUTS = 3
FOLDS = 5
BLOCK = 8


def explains_nothing(budget: Budget, model: CandidateModel, seed: int) -> bool:
    """Return True where the model explains no channel of the recordings.

    Where inputs move, see `_responds`; where they rest, see `_beats_extrapolation`.
    """
    held_out = [r.full_track for r in model.replays]
    for tracks in (held_out, list(model.fit.problem.tracks)):
        if _inputs_move(tracks):
            return not _responds(budget, model, tracks, seed)
    return not _beats_extrapolation(budget, model, seed)


def inputs_predict(data: DataSplit, settings: Settings = DEFAULT) -> bool | None:
    """Return whether the inputs help a lagged linear model to predict an output; None where none
    moves.

    For every channel the increment y(t + h) - y(t) is regressed on y(t), on the increments before
    it, and on means of the inputs u (and of their squares) over lags from 0 to a fifth of the
    recording, h being the correlation time. Every fifth of each recording is predicted from the rest, with and without the inputs. No
    model of the rig takes part: the machine may be far from its model.
    """
    plain = Assembly(data.rig)
    tracks = [*data.tracks(plain), *data.tracks(plain, held_out=True)]
    tracks = [t.part(t.lead, len(t)) for t in tracks]
    if not _inputs_move(tracks):
        return None
    lags_s = _lag_edges(data.timescale_s, LONGEST_LAG * max(len(t) * t.period_s for t in tracks))
    centre = np.concatenate([t.u for t in tracks]).mean(axis=0)
    for c in range(len(data.channels)):
        rows = [_lagged(t, c, data.timescale_s, lags_s, centre) for t in tracks if t.seen[c]]
        without = _cross_validated([(x[:, :PAST_OUTPUTS], y) for x, y in rows])
        linear = PAST_OUTPUTS + (rows[0][0].shape[1] - PAST_OUTPUTS) // 2
        for columns in (linear, None):
            with_inputs = _cross_validated([(x[:, :columns], y) for x, y in rows])
            if with_inputs.sum() < (1.0 - settings.naive_margin) * without.sum():
                return True
    return False


def _lag_edges(first_s: float, last_s: float) -> Array:
    """Edges of lag intervals (s): 0, then doubling from an eighth of `first_s` up to `last_s`."""
    count = max(1, int(np.ceil(np.log2(max(8.0 * last_s / first_s, 2.0)))))
    return np.concatenate([[0.0], first_s / 8.0 * 2.0 ** np.arange(count + 1)])


def _lagged(
    track: Track, c: int, horizon_s: float, lags_s: Array, centre: Array
) -> tuple[Array, Array]:
    """Regressors (past outputs, then inputs over lags, then their squares) and increments of
    channel c, four rows per horizon. Before the beginning every signal keeps its first value."""
    n = len(track)
    h = min(max(2, round(horizon_s / track.period_s)), max(2, n // 8))
    at = np.arange(h, n, max(1, h // 4))  # the increments end here
    last, half, whole = (track.y[np.maximum(at - k, 0), c] for k in (h, h + h // 2, 2 * h))
    u = track.u - centre
    features = np.stack([u, u**2])
    sums = np.concatenate([np.zeros_like(features[:, :1]), features.cumsum(axis=1)], axis=1)
    edges = np.unique(np.round(lags_s / track.period_s).astype(int))
    stops = np.maximum(at[:, None] + 1 - edges[:-1], 1)
    starts = np.minimum(np.maximum(at[:, None] + 1 - edges[1:], 0), stops - 1)
    means = (sums[:, stops] - sums[:, starts]) / (stops - starts)[..., None]
    linear, squares = means.reshape(2, len(at), -1)
    return np.column_stack([last, last - half, last - whole, linear, squares]), track.y[at, c] - last


def _cross_validated(rows: Sequence[tuple[Array, Array]]) -> Array:
    """Mean absolute errors over blocks of `BLOCK` rows, each fifth of a recording predicted from
    everything else."""
    errors = []
    for fold in range(FOLDS):
        inside = [np.arange(len(y)) * FOLDS // len(y) == fold for _, y in rows]
        x, y = (
            np.concatenate([part[k][~m] for part, m in zip(rows, inside, strict=True)])
            for k in (0, 1)
        )
        predict = _ridge(x, y)
        for (w, v), m in zip(rows, inside, strict=True):
            if m.any():
                left = np.abs(v[m] - predict(w[m]))
                errors.append(block_sums(left, min(BLOCK, len(left))) / BLOCK)
    return np.concatenate(errors)


def _ridge(x: Array, y: Array) -> Callable[[Array], Array]:
    """Linear prediction from standardised regressors, weakly damped (Hoerl and Kennard 1970)."""
    centre, spread = x.mean(axis=0), x.std(axis=0)
    spread = np.where(spread > 1e-12 * np.abs(x).max(axis=0, initial=0.0), spread, np.inf)
    z = (x - centre) / spread
    gram = z.T @ z + 1e-3 * len(z) * np.eye(z.shape[1])
    weights = np.linalg.solve(gram, z.T @ (y - y.mean()))
    # within the range of what it has seen: an extrapolation would be the error of the comparison
    return lambda rows: np.clip(
        y.mean() + (rows - centre) / spread @ weights, y.min(initial=np.inf), y.max(initial=-np.inf)
    )


def _inputs_move(tracks: Sequence[Track]) -> bool:
    """Whether an input moves to and fro: from the lower half of its range to the upper one and
    back. After one step any smooth output looks like a response."""
    for u in (np.concatenate(columns) for columns in zip(*(t.u.T for t in tracks), strict=True)):
        off = u - 0.5 * (u.min() + u.max())
        sides = np.sign(off[np.abs(off) > 0.25 * np.abs(off).max()])
        if np.count_nonzero(np.diff(sides)) > 1:
            return True
    return False


def _responds(
    budget: Budget, model: CandidateModel, tracks: Sequence[Track], seed: int
) -> bool:
    """Whether the recorded inputs help the model to predict any channel.

    They do if its error is smaller, by the margin and with 95 % confidence or by plainly more, than
    those of the median and of the same model without its inputs. The comparison is made in windows,
    and over one free run, since a window shows little of a slow machine.
    """
    settings, noise = budget.settings, budget.model.evidence.noise

    def replays(shift: float | None) -> list[Replay]:
        return [
            replay_track(
                model.assembly,
                model.fit.p,
                t if shift is None else _without_inputs(t, shift),
                model.fit.stepping,
                noise,
            )
            for t in tracks
        ]

    def losses(rs: list[Replay]) -> Array:
        return np.concatenate([r.losses() for r in rs])

    true = replays(None)
    middle = np.concatenate([_guesses(r)[0] for r in true])
    held, *shifted = (losses(replays(shift)) for shift in SHIFTS)
    rivals = (middle, held, np.mean(shifted, axis=0))
    error = losses(true)
    for c in range(error.shape[1]):
        seen = ~np.isnan(error[:, c])  # a recording may lack the channel
        if all(_better(error[seen, c], rival[seen, c], seed, settings) for rival in rivals):
            return True
    errors = _free_run_errors(model, [(r.track, r.entered[0]) for r in true])
    free, flat, *without = errors
    return bool((free < settings.naive_plain * np.min([flat, *without], axis=0)).any())


def _without_inputs(track: Track, shift: float) -> Track:
    """The track with its inputs shifted by a share of its length, or held at their means (0)."""
    if shift == 0.0:
        return replace(track, u=np.tile(track.u.mean(axis=0), (len(track), 1)))
    return replace(track, u=np.roll(track.u, round(shift * len(track)), axis=0))


def _free_run_errors(model: CandidateModel, begun: Sequence[tuple[Track, Array]]) -> Array:
    """Summed absolute errors per channel (SI) of one free run per track from its start: with the
    recorded inputs, of the median, and without the inputs (rows; see `SHIFTS`)."""
    total = np.zeros((2 + len(SHIFTS), begun[0][0].y.shape[1]))
    for track, start in begun:
        runs = [
            run_windows(
                model.assembly.program,
                model.assembly,
                model.fit.p,
                t,
                [Window(0, len(track))],
                start[None],
                model.fit.stepping,
            )
            for t in (track, *(_without_inputs(track, shift) for shift in SHIFTS))
        ]
        runs.insert(1, np.broadcast_to(np.median(track.y, axis=0), track.y.shape))
        total += [np.nansum(np.abs(track.y - run), axis=0) for run in runs]
    return total


def _beats_extrapolation(budget: Budget, model: CandidateModel, seed: int) -> bool:
    """Whether the model beats forecasts that need no model, in any channel.

    It must be better, by the margin and with 95 % confidence or by plainly more, than the median of
    everything scored. Unless it is near the noise floor it must also beat the forecasts from the
    first part of a window, on which its start was estimated: the median of that part, and the line
    through it. A model without states has not seen that part. A free run from single starts that
    is plainly better than the median will do as well.
    """
    started = bool(model.assembly.rig.states)
    middle, start, line = (
        np.concatenate([losses[i] for losses in map(_guesses, model.replays)]) for i in range(3)
    )
    for c, floor in enumerate(seen_mean(budget.floor)):
        seen = ~np.isnan(model.absolutes[:, c])  # a recording may lack the channel
        own, flat = model.absolutes[seen, c], middle[seen, c]
        guess = min(line[seen, c], start[seen, c], key=np.sum)
        near = own.mean() < budget.settings.naive_near_floor * floor
        if _better(own, flat, seed, budget.settings) and (
            not started or near or _better(own, guess, seed, budget.settings)
        ):
            return True
    return _follows(model, budget.settings)


def _follows(model: CandidateModel, settings: Settings) -> bool:
    """Whether free runs from the first start of every recording leave plainly less than the median,
    in any channel, in the held-out or in the fitted data."""
    held_out = [(r.track, r.entered[0]) for r in model.replays]
    fitted = [(t, x[0]) for t, x in zip(model.fit.problem.tracks, model.fit.starts, strict=True)]
    for begun in (held_out, fitted):
        free, flat, *_ = _free_run_errors(model, begun)
        if (free < settings.naive_plain * flat).any():
            return True
    return False


def _better(own: Array, guess: Array, seed: int, settings: Settings = DEFAULT) -> bool:
    """By the margin, with 95 % confidence, or by so much that a few windows show it; windows whose
    guess is exact say nothing of a model."""
    most = 1.0 - settings.naive_margin
    if guess.sum() <= 0.0 or own.sum() >= most * guess.sum():
        return False
    if own.sum() < settings.naive_plain * guess.sum():
        return True
    beside = guess + 1e-9 * guess.mean()
    # of few windows it is not shown that it explains nothing either
    return bool(moving_block_interval(own, beside, seed=seed, widened=False)[1] < most)


def _guesses(replay: Replay) -> tuple[Array, Array, Array]:
    """Mean absolute errors per window and channel (SI) of the median of everything scored, of that
    of the window's first part, and of the line through it."""
    y, scored = replay.track.y, replay.scored
    middle, rows = np.median(y[scored], axis=0), []
    for w in replay.windows:
        t = np.arange(w.stop - w.start, dtype=float)
        first, left = warm_up(w), y[w.start : w.stop]
        slope, level = np.polyfit(t[:first], left[:first], 1)
        rest = left[scored[w.start : w.stop]]
        after = t[scored[w.start : w.stop], None]
        rows.append(
            [
                np.abs(rest - guess).mean(axis=0)
                for guess in (middle, np.median(left[:first], axis=0), level + slope * after)
            ]
        )
    middles, starts, lines = np.array(rows).transpose(1, 0, 2)
    return middles, starts, lines
