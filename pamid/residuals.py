"""What a model leaves over: recorded-command replay in short windows, and the noise floor of that comparison.

A window starts from a state estimated on its first part, which is not scored; then the model runs freely on the
recorded command. What effects remember runs on from window to window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.engine.program import Stepping
from pamid.windows import Runner, Track, Window, cut, estimate_start

Array = NDArray[np.float64]

WINDOW_S, SHORTEST_S, WARM_UP = 2.3, 1.0, 0.15   # s, s; share of a window that only serves to find its start
ENOUGH = 16                                     # windows wanted: verdicts are resampled over them


def replay_windows(track: Track) -> list[Window]:
    """2.3 s windows, shorter (to 1 s) where the record would not give 16; at least 150 samples on slow rigs."""
    total = len(track) * track.period_s
    length = max(round(min(WINDOW_S, max(SHORTEST_S, total / ENOUGH)) / track.period_s), 150)
    return cut(len(track), max(40, min(length, len(track) // 4)))


@dataclass(frozen=True)
class Replay:
    """model (samples x channels, SI), scored (samples), windows; unusable windows count as lost."""

    track: Track
    model: Array
    scored: NDArray[np.bool_]
    windows: tuple[Window, ...]
    finite: bool
    with_lead: Array         # model over the whole track, lead-in included
    led: Track               # that track

    @property
    def residual(self) -> Array:
        """measured - model, samples x channels."""
        return self.track.y - self.model

    def losses(self, power: int = 1) -> Array:
        """Mean |residual|^power per window and channel over the scored part (windows x channels)."""
        r = np.abs(self.residual) ** power
        return np.array([r[w.start : w.stop][self.scored[w.start : w.stop]].mean(axis=0) for w in self.windows])


def replay(assembly: Assembly, p: Array, track: Track, stepping: Stepping, noise: Array) -> Replay:
    """Run the model over the track window by window; the sensor noise per channel (SI) weighs the start estimates.

    Windows of the track's lead-in find their start from all of their samples; the result no longer holds them.
    """
    runner = Runner(assembly, track, stepping)
    values = runner.parameters(p)
    memory = runner.memory(values)
    model, scored = np.empty_like(track.y), np.zeros(len(track), bool)
    lead, finite = track.lead, True
    windows = replay_windows(track.part(lead, len(track)))
    ahead = cut(lead, windows[0].stop) if lead else []
    shifted = [Window(w.start + lead, w.stop + lead) for w in windows]
    for window in [*ahead, *shifted]:
        length = window.stop - window.start
        warm = length if window.start < lead else max(10, round(WARM_UP * length))
        carried = memory.x[: runner.rig_states].copy()
        x, _, usable = estimate_start(runner, memory, Window(window.start, window.start + warm), values, 1.0 / noise,
                                      carried)
        if usable:
            runner.enter(memory, x)
        Y, _, fine = runner.run(memory, window, values, False)
        if not fine or not np.isfinite(memory.x).all():
            finite = finite and window.start < lead
            Y = np.where(np.isfinite(Y), Y, 0.0)
            memory = runner.memory(values)
        model[window.start : window.stop] = Y
        scored[window.start + warm : window.stop] = True
    return Replay(track.part(lead, len(track)), model[lead:], scored[lead:], tuple(windows), finite, model, track)


def noise_floor(assembly: Assembly, p: Array, done: Replay, stepping: Stepping, noise: Array, seed: int = 0) -> Replay:
    """The same comparison where the model is the truth: its own outputs plus white noise, replayed."""
    random = np.random.default_rng(seed)
    t = done.led
    y = done.with_lead + noise * random.standard_normal(done.with_lead.shape)
    return replay(assembly, p, Track(t.name, t.u, y, t.p, t.known, t.period_s, t.first, t.lead), stepping, noise)


def channel_mae(replays: list[Replay]) -> Array:
    """Mean absolute error per channel (SI) over all scored samples."""
    errors = [np.abs(r.residual[r.scored]) for r in replays]
    return np.concatenate(errors).mean(axis=0)
