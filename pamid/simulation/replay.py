"""Recorded-command replay of a model, scored window by window, and its noise floor.

A run covers a window or more, up to the whole recording. It begins in a state estimated from its
data; then the model runs freely on the recorded command. What effects remember is carried on
from run to run.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import seen_mean
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.executable import Executable
from pamid.recording.noise import NEGLIGIBLE_ERROR
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, Window, cut, window_starts

LONGEST_WINDOW, SHORTEST_WINDOW = 3.8, 1.7  # correlation times of the recordings
USUAL_WINDOW_SAMPLES = 40  # of a window at least
FEWEST_WINDOW_SAMPLES = 20  # where a record would not give 3 such; 3 of them find its start
ENOUGH = 16  # windows wanted: verdicts are resampled over them
FEWEST_WINDOWS, FEWEST_USUAL_WINDOWS = 6, 3  # over all records together; of the usual length
WARM_UP = 0.15  # share of a run's first window that only serves to find its start
WHOLE = 2**31 - 1  # windows per run: a single run over the whole recording


def replay_windows(track: Track) -> list[Window]:
    """Windows of 3.8 correlation times, shorter (to 1.7) where the record would not give 16; at
    least 6 of them, as long as they have 40 samples. Records too short for that give 6 together, or
    3 that have 20; an episode among many may be a single window."""
    longest = len(track) / ENOUGH
    scale = track.timescale_s / track.period_s
    length = round(min(LONGEST_WINDOW * scale, max(SHORTEST_WINDOW * scale, longest)))
    third, sixth = (
        len(track) // max(1, round(track.share * count))
        for count in (FEWEST_USUAL_WINDOWS, FEWEST_WINDOWS)
    )
    alone = len(track) // FEWEST_WINDOWS
    sixth = alone if alone >= USUAL_WINDOW_SAMPLES else sixth
    fewest = max(FEWEST_WINDOW_SAMPLES, min(USUAL_WINDOW_SAMPLES, third))
    return cut(len(track), max(fewest, min(length, sixth)))


@dataclass(frozen=True, eq=False)
class Replay:
    """A model run over a track, its lead-in included.

    full_track, full_outputs (samples x channels, SI), full_windows: lead-in included; noise: of the
    sensors, per channel (SI); carried: the rig's states at the end of the window before (windows x
    states); starts: the states at which the window was entered (windows x states); finite: whether
    every scored sample is; per_run: scored windows that a run covers.
    """

    full_track: Track
    full_outputs: Array = field(repr=False)
    full_windows: tuple[Window, ...] = field(repr=False)
    carried: Array = field(repr=False)
    starts: Array = field(repr=False)
    finite: bool
    noise: Array
    per_run: int = 1

    @cached_property
    def track(self) -> Track:
        """Scored part, without the lead-in."""
        return self.full_track.part(self.full_track.lead, len(self.full_track))

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        lead = self.full_track.lead
        return tuple(
            Window(w.start - lead, w.stop - lead) for w in self.full_windows if w.start >= lead
        )

    @property
    def entered(self) -> Array:
        """The rig's states at the start of every scored window."""
        return self.starts[len(self.full_windows) - len(self.windows) :]

    @property
    def model(self) -> Array:
        """Outputs, samples x channels (SI)."""
        return self.full_outputs[self.full_track.lead :]

    @cached_property
    def scored(self) -> NDArray[np.bool_]:
        """Samples behind the first part of their run, on which its start was estimated."""
        out = np.ones(len(self.track), bool)
        for w in self.windows[:: self.per_run]:
            out[w.start : w.start + warm_up(w)] = False
        return out

    @property
    def residual(self) -> Array:
        """measured - model, samples x channels; 0 where a channel was not recorded."""
        left = self.track.y - self.model
        return left if self.seen.all() else np.nan_to_num(left)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Mask of the recorded channels."""
        return self.full_track.seen

    def losses(self, power: int = 1) -> Array:
        """Mean |residual|^power per window and channel over the scored part (windows x channels),
        at least that of a negligible error; NaN where a channel was not recorded.

        Losses are divided by each other and their logarithms compared. Where recording and model
        rest at exactly the same number the residual is 0, which no sensor can show.
        """
        r = np.abs(self.residual) ** power
        r[:, ~self.seen] = np.nan
        means = [
            r[w.start : w.stop][self.scored[w.start : w.stop]].mean(axis=0) for w in self.windows
        ]
        return np.maximum(means, (NEGLIGIBLE_ERROR * self.noise) ** power)


def warm_up(window: Window) -> int:
    """Samples at the beginning of a run's first window that are not scored."""
    return max(10, round(WARM_UP * (window.stop - window.start)))


def replay_track(
    assembly: Assembly,
    p: Array,
    track: Track,
    stepping: Stepping,
    noise: Array,
    jumps: Array | None = None,
    per_run: int = 1,
) -> Replay:
    """Run the model over the track; the sensor noise per channel (SI) weighs the start estimates.

    A run over a single window finds its start from the part that is not scored, a longer run from
    the whole of its first window, and so do windows of the track's lead-in. jumps: by what the
    states are known to have departed from what was carried over (windows x states); per_run: scored
    windows that a run covers.
    """
    runner = Runner(assembly, track, stepping)
    values = runner.parameters(p)
    memory = runner.memory(values)
    full_outputs, lead, finite = np.empty_like(track.y), track.lead, True
    windows = replay_windows(track.part(lead, len(track)))
    full_windows = (
        *(cut(lead, windows[0].stop) if lead else []),
        *(Window(w.start + lead, w.stop + lead) for w in windows),
    )
    carried, starts = np.empty((2, len(full_windows), runner.start_states))
    leading = len(full_windows) - len(windows)
    for k, window in enumerate(full_windows):
        ahead = window.start < lead
        carried[k] = starts[k] = memory.x[: runner.start_states]
        if ahead or (k - leading) % per_run == 0:
            whole = ahead or per_run > 1
            stop = window.stop if whole else window.start + warm_up(window)
            x, usable = WindowStart.of(
                runner,
                memory,
                Window(window.start, stop),
                values,
                1.0 / noise,
                carried[k] if jumps is None else carried[k] + jumps[k],
                track.jump if k else None,
            ).estimate()
            starts[k] = x if usable else carried[k]
            runner.enter(memory, starts[k])
        Y, _, fine = runner.run(memory, window, values, False)
        if not fine or not np.isfinite(memory.x).all():
            finite = finite and ahead
            Y = np.where(np.isfinite(Y), Y, 0.0)
            # memories of the effects have run away, too: they begin anew
            memory = runner.memory(values)
        full_outputs[window.start : window.stop] = Y
    return Replay(track, full_outputs, full_windows, carried, starts, finite, noise, per_run)


def run_windows(
    program: Executable,
    assembly: Assembly,
    p: Array,
    track: Track,
    windows: Sequence[Window],
    starts: Array,
    stepping: Stepping,
) -> Array:
    """Outputs of `program`, the assembly's equations with further outputs, over windows entered at
    these states (samples x outputs)."""
    values = Runner(assembly, track, stepping).parameters(p)
    memory = program.memory(assembly.start(values), stepping=stepping, period_s=track.period_s)
    runs = program.run_windows(
        memory, track.inputs, values, window_starts(track, windows, starts), stepping=stepping
    )
    return np.nan_to_num(np.concatenate([run.Y for run in runs]))


def noise_floor(
    assembly: Assembly, p: Array, done: Replay, stepping: Stepping, noise: Array, seed: int = 0
) -> Replay:
    """The same comparison where the model is the truth: its outputs plus white noise, replayed.
    This truth jumps between windows by as much as the fitted model's states had to."""
    random = np.random.default_rng(seed)
    y = done.full_outputs + noise * random.standard_normal(done.full_outputs.shape)
    y[:, ~done.seen] = np.nan
    return replay_track(
        assembly,
        p,
        replace(done.full_track, y=y),
        stepping,
        noise,
        done.starts - done.carried,
        done.per_run,
    )


def noise_floors(
    assembly: Assembly,
    p: Array,
    replays: Iterable[Replay],
    stepping: Stepping,
    noise: Array,
    seed: int,
) -> tuple[Replay, ...]:
    """The noise floor of each replay, with draws of its own."""
    return tuple(
        noise_floor(assembly, p, r, stepping, noise, seed + i) for i, r in enumerate(replays)
    )


def channel_mae(replays: list[Replay]) -> Array:
    """Mean absolute error per channel (SI) over all scored samples that have it."""
    errors = [np.where(r.seen, np.abs(r.residual[r.scored]), np.nan) for r in replays]
    return seen_mean(np.concatenate(errors))
