"""Forecasts without a model: the median of a window, or a line through its start. A model that does
no better has explained nothing, however much an effect improves it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import moving_block_interval, seen_mean
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.simulation.replay import Replay, run_windows, warm_up
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

Array = NDArray[np.float64]


def explains_nothing(budget: Budget, model: CandidateModel, seed: int) -> bool:
    """True where the model beats no guess in any channel. To explain one it must be better, by the
    margin and with 95 % confidence or by plainly more, than the median of everything scored. Unless
    it is near the noise floor it must also beat the forecasts from the first part of a window, on
    which its start was estimated: the median of that part, and the line through it. A model without
    states has no start, so that it has seen nothing of that part: such a forecast would know more
    than it. Of a slow machine these are good, and a model that is far off within a window may yet
    know what the input does: one that runs through what was fitted or held out from single starts,
    and is plainly better than the median, has explained something."""
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
            return False
    return not _follows_the_input(model, budget.settings)


def _follows_the_input(model: CandidateModel, settings: Settings) -> bool:
    """Run freely from where each recording's first window began, does it leave plainly less than
    the median of what was measured leaves, in any channel, of what was held out or of what was
    fitted?"""
    held = [(r.track, r.entered) for r in model.replays]
    fitted = list(zip(model.fit.problem.tracks, model.fit.starts, strict=True))
    return _follows(model, held, settings) or _follows(model, fitted, settings)


def _follows(model: CandidateModel, begun: list[tuple[Track, Array]], settings: Settings) -> bool:
    """begun: tracks, and the states in which their windows begin."""
    left, flat = [], []
    for track, starts in begun:
        y = track.y
        run = run_windows(
            model.assembly.program,
            model.assembly,
            model.fit.p,
            track,
            [Window(0, len(track))],
            starts[:1],
            model.fit.stepping,
        )
        left.append(np.abs(y - run).sum(axis=0))
        flat.append(np.abs(y - np.median(y, axis=0)).sum(axis=0))
    return bool((np.nansum(left, axis=0) < settings.naive_plain * np.nansum(flat, axis=0)).any())


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
