"""Which samples may be used for what: parameters are fitted on one part, effects chosen on a second, figures given
on a third that neither has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.errors import DataError, FileError
from pamid.recording import Recording, require_excited
from pamid.residuals import Replay
from pamid.rig import Rig
from pamid.simulation import measured_outputs, state_spread
from pamid.windows import Track, noise_level, track_of

Array = NDArray[np.float64]
FEWEST = 400           # samples of a recording
HELD_OUT_SHARE = 0.3
LEAD_S = 6.0           # before a held-out part, to find the state it begins in
DEPARTS = 0.01         # of a state's spread: what a model may be off by in a state that nothing measures, per window


@dataclass(frozen=True)
class Span:
    """Samples start..stop of a recording."""

    recording: Recording
    start: int
    stop: int


@dataclass(frozen=True)
class Evidence:
    """Recordings of one rig, divided. channels: outputs that all of them hold and that move in one of them; noise:
    their white noise (SI); jump: by what the rig's states may depart from what a window before has led to (SI)."""

    rig: Rig
    fit: tuple[Span, ...]
    held_out: tuple[Span, ...]
    channels: tuple[str, ...]
    noise: Array
    jump: Array

    def tracks(self, assembly: Assembly, held_out: bool = False) -> tuple[Track, ...]:
        """Tracks for this assembly; parameters the recordings know are held in each."""
        spans = self.held_out if held_out else self.fit
        return tuple(track_of(assembly, s.recording, self.channels, self.jump)
                     .part(s.start, s.stop, max(300, round(LEAD_S / s.recording.sampling_period_s)) if held_out else 0)
                     for s in spans)

    @property
    def recordings(self) -> list[Recording]:
        return list({id(s.recording): s.recording for s in (*self.fit, *self.held_out)}.values())


def gather(rig: Rig, recordings: list[Recording], held_out: list[Recording]) -> Evidence:
    """Divide the recordings; without `held_out` the last 30 % of every recording is held out.

    DataError where the recordings cannot answer: too short, or nothing was excited. A rig that can be recorded without
    being sent anything may have channels at rest, as long as another one moves.
    """
    plain = Assembly(rig)
    everything = [*recordings, *held_out]
    channels = tuple(c for c in rig.outputs if all(c in measured_outputs(plain, r) for r in everything))
    if not channels:
        raise FileError("the recordings share no measured output",
                        f"rig {rig.name!r} offers {', '.join(rig.outputs)}")
    moving: set[str] = set()
    for r in everything:
        moving |= _moving(r, (*(c for c in rig.inputs if r.has(c)), *channels))
        seconds = len(r) * r.sampling_period_s
        if len(r) < FEWEST:
            raise DataError(f"{r.path}: {len(r)} samples ({seconds:.2f} s) are too few to fit and judge a model",
                            f"at least {FEWEST} samples are needed; 20 s and more are sensible on a 3 ms rig")
    channels = tuple(c for c in channels if c in moving)
    if held_out:
        fit = [Span(r, 0, len(r)) for r in recordings]
        kept = [Span(r, 0, len(r)) for r in held_out]
    else:
        edges = [round((1.0 - HELD_OUT_SHARE) * len(r)) for r in recordings]
        fit = [Span(r, 0, e) for r, e in zip(recordings, edges, strict=True)]
        kept = [Span(r, e, len(r)) for r, e in zip(recordings, edges, strict=True)]
    order = sorted(range(len(fit)), key=lambda i: fit[i].recording.sha256)  # names and order must not matter
    by_content = sorted(everything, key=lambda r: r.sha256)     # a sum depends on its order in the last digit
    noise = np.sqrt(np.mean([noise_level(t.y) ** 2 for t in
                             (track_of(plain, r, channels) for r in by_content)], axis=0))
    return Evidence(rig, tuple(fit[i] for i in order),
                    tuple(sorted(kept, key=lambda s: (s.recording.sha256, s.start))), channels, noise,
                    DEPARTS * _usual([state_spread(plain, r) for r in by_content]))


def _moving(recording: Recording, channels: tuple[str, ...]) -> set[str]:
    """Channels that change in this recording; DataError where none does."""
    found = set()
    for channel in channels:
        try:
            require_excited(recording, channel)
        except DataError as error:
            still = error
        else:
            found.add(channel)
    if not found:
        raise still
    return found


def _usual(spreads: list[Array]) -> Array:
    """Root mean square of every state's spread over the recordings that say something of it; infinite where none
    does."""
    table = np.stack(spreads)
    said = np.isfinite(table)
    count = said.sum(axis=0)
    return np.where(count, np.sqrt((np.where(said, table, 0.0) ** 2).sum(axis=0) / np.maximum(count, 1)), np.inf)


def selection_part(replays: list[Replay]) -> NDArray[np.bool_]:
    """Which held-out windows choose the effect (True); the others only report. Alternating pairs of windows."""
    count = sum(len(r.windows) for r in replays)
    run = 2 if count >= 12 else 1
    return (np.arange(count) // run) % 2 == 0
