"""Test whether a recording shows this machine.

The model's prediction with the recorded inputs is compared with that of the same model without
them. An effect that switches an input off (a saturation, a dead zone, a gain of zero) may reproduce
any smooth output by its free response, and explains nothing. Where no input moves, the comparison
is with forecasts that need no model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import moving_block_interval, seen_mean
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel, window_losses
from pamid.diagnosis.settings import Settings
from pamid.estimation.lagged_linear import LaggedResponse, inputs_move
from pamid.simulation.input_effects import held_at_mean, idle_text, input_effects
from pamid.simulation.replay import Replay, replay_track, run_windows, warm_up
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

# circular shifts that stand for "without the inputs", as shares of the track; 0 holds every input
# at its mean. A shifted input keeps what a rectifier or a relay makes of it, the mean does not
INPUT_SHIFTS = (0.0, 0.2, 0.4, 0.6, 0.8)

Channels = NDArray[np.bool_]


def explained_channels(
    budget: Budget, model: CandidateModel, response: LaggedResponse | None, seed: int
) -> Channels:
    """Channels that the model explains.

    Where inputs move, see `_responding`; where they rest (response is None), all or none: see
    `_beats_extrapolation`.
    """
    if response is not None:
        # Held-out data first: the fitted data have seen the model's parameters, and serve only
        # where the inputs rest in the held-out part.
        if inputs_move([r.full_track for r in model.replays]):
            return _responding(budget, model, model.replays, seed)
        tracks = model.fit.problem.tracks
        if inputs_move(tracks):
            return _responding(budget, model, _replays(budget, model, tracks), seed)
    beats = _beats_extrapolation(budget, model, seed)
    return np.full(len(budget.model.evidence.channels), beats)


def silent_channels(
    budget: Budget, model: CandidateModel, explained: Channels, response: LaggedResponse | None
) -> tuple[str, ...]:
    """Channels that do not show this machine: neither the model nor a lagged regression finds the
    inputs in them.

    All of them where the model explains none, unless an input clearly responds: then the machine is
    there, and its model is wrong. Of several, those that neither follow the inputs nor are at their
    noise floor. A regression that misses the inputs in every channel that the model explains too,
    as on an arm under gravity, says nothing about the others.
    """
    names = np.array(budget.model.evidence.channels)
    if not explained.any():
        wrong_model = response is not None and response.is_clear and not response.is_reversed
        return () if wrong_model else tuple(names)
    if response is None or response.absent[explained].all():
        return ()
    far = seen_mean(model.absolutes) > budget.settings.naive_near_floor * seen_mean(budget.floor)
    silent = ~explained & response.absent & far
    return tuple(names[silent & ~following_channels(budget, model)]) if silent.any() else ()


def following_channels(budget: Budget, model: CandidateModel) -> Channels:
    """Channels that the inputs as recorded predict better over windows, by the margin, than the
    same inputs at every other time: those of another machine would do as well as these."""

    def errors(replays: Sequence[Replay]) -> Array:
        return np.asarray(np.nansum([r.losses().sum(axis=0) for r in replays], axis=0))

    tracks = [r.full_track for r in model.replays]
    recorded = errors(model.replays)
    shifted = [
        errors(_replays(budget, model, [_without_inputs(t, shift) for t in tracks]))
        for shift in INPUT_SHIFTS
        if shift  # the first holds every input at its mean
    ]
    most = 1.0 - budget.settings.naive_margin
    return np.asarray(recorded < most * np.min(shifted, axis=0))


def _replays(budget: Budget, model: CandidateModel, tracks: Sequence[Track]) -> list[Replay]:
    noise, f = budget.model.evidence.noise, model.fit
    return [replay_track(model.assembly, f.p, t, f.stepping, noise) for t in tracks]


def _responding(
    budget: Budget, model: CandidateModel, true: Sequence[Replay], seed: int
) -> Channels:
    """Channels that the recorded inputs help the model to predict. true: replays with them.

    They do if its error is smaller, by the margin and with 95 % confidence or by plainly more, than
    those of the median and of the same model without its inputs. The comparison is made in windows,
    and over a free run, since a window shows little of a slow machine.
    """
    settings = budget.settings

    begun = [(r.track, r.entered[0]) for r in true]
    free, flat, *without = _free_run_errors(model, begun, INPUT_SHIFTS)
    responding = np.asarray(free < settings.naive_plain * np.min([flat, *without], axis=0))
    if responding.all():  # the windows cost ten times as much as the free runs
        return responding
    # A free response alone may beat the median, and a rectifier alone may beat the mean of its
    # input. Only a model that beats all of these uses its inputs.
    middle = np.concatenate([_guesses(r)[0] for r in true])
    held, *shifted = (
        window_losses(_replays(budget, model, [_without_inputs(r.full_track, shift) for r in true]))
        for shift in INPUT_SHIFTS
    )
    rivals = (middle, held, np.mean(shifted, axis=0))
    error = window_losses(true)
    for c in np.flatnonzero(~responding):
        seen = ~np.isnan(error[:, c])  # a recording may lack the channel
        responding[c] = all(
            _is_better(error[seen, c], rival[seen, c], seed, settings) for rival in rivals
        )
    return responding


def _without_inputs(track: Track, shift: float) -> Track:
    """The track with its inputs shifted by a share of its length, or held at their means (0)."""
    if shift == 0.0:
        return replace(track, u=held_at_mean(track.u))
    return replace(track, u=np.roll(track.u, round(shift * len(track)), axis=0))


def idle_inputs(model: CandidateModel, channels: Sequence[str], noise: Array) -> list[str]:
    """Sentences on the inputs that change no channel by more than its noise in free runs of a model
    over what was fitted. channels, noise: names, and standard deviations (SI)."""
    names = model.assembly.traced.inputs
    tracks = model.fit.problem.tracks
    changes: dict[str, list[Array]] = {}
    for track, starts in zip(tracks, model.fit.starts, strict=True):

        def run(u: Array, track: Track = track, start: Array = starts[0]) -> Array:
            return _free_run(model, replace(track, u=u), start)

        for name, change in input_effects(run, track.u, names, run(track.u)).items():
            changes.setdefault(name, []).append(change)
    texts = (
        idle_text(
            name,
            np.concatenate([t.u[:, names.index(name)] for t in tracks]),
            np.max(change, axis=0),
            channels,
            noise,
        )
        for name, change in changes.items()
    )
    return list(filter(None, texts))


def _free_run(model: CandidateModel, track: Track, start: Array) -> Array:
    """Outputs (samples x channels, SI) over a whole track from a single start."""
    return run_windows(
        model.assembly.program,
        model.assembly,
        model.fit.p,
        track,
        [Window(0, len(track))],
        start[None],
        model.fit.stepping,
    )


def _free_run_errors(
    model: CandidateModel, begun: Sequence[tuple[Track, Array]], shifts: Sequence[float]
) -> Array:
    """Summed absolute errors per channel (SI) of a free run per track from its start: with the
    recorded inputs, of the median, and without the inputs (rows; see INPUT_SHIFTS)."""
    total = np.zeros((2 + len(shifts), begun[0][0].y.shape[1]))
    for track, start in begun:
        runs = [
            _free_run(model, t, start)
            for t in (track, *(_without_inputs(track, shift) for shift in shifts))
        ]
        # The median minimises the absolute error, so that it is the hardest constant to beat.
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
    absolutes = window_losses(model.replays)
    for c, floor in enumerate(seen_mean(budget.floor)):
        seen = ~np.isnan(absolutes[:, c])  # a recording may lack the channel
        error, flat = absolutes[seen, c], middle[seen, c]
        guess = min(line[seen, c], start[seen, c], key=np.sum)
        near = error.mean() < budget.settings.naive_near_floor * floor
        if _is_better(error, flat, seed, budget.settings) and (
            not started or near or _is_better(error, guess, seed, budget.settings)
        ):
            return True
    held_out = [(r.track, r.entered[0]) for r in model.replays]
    fitted = [(t, x[0]) for t, x in zip(model.fit.problem.tracks, model.fit.starts, strict=True)]
    # A slow machine may hardly move in the held-out part. Its fitted data still show whether the
    # model follows.
    for begun in (held_out, fitted):
        free, flat = _free_run_errors(model, begun, ())
        if (free < budget.settings.naive_plain * flat).any():
            return True
    return False


def _is_better(error: Array, guess: Array, seed: int, settings: Settings) -> bool:
    """Whether the error is smaller by the margin with 95 % confidence, or by so much that a few
    windows show it. Windows with an exact guess have no weight."""
    most = 1.0 - settings.naive_margin
    if guess.sum() <= 0.0 or error.sum() >= most * guess.sum():
        return False
    # An interval of three or four windows is always wide. Half the error is a difference that
    # needs no interval.
    if error.sum() < settings.naive_plain * guess.sum():
        return True
    # A ratio of losses needs a positive denominator in every resample.
    guess_error = guess + 1e-9 * guess.mean()
    # of few windows it is not shown that it explains nothing either
    return bool(moving_block_interval(error, guess_error, seed=seed, widened=False)[1] < most)


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
