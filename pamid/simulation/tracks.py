"""Recordings as a model sees them: inputs and measured channels in SI, with what is known of each,
and the noise of their channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.units import size_to_si, split_column
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.noise import noise_level, sensor_noise
from pamid.recording.recording import Recording
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.free_runs import input_table, known_values, output_table

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """One recording as a fit sees it. SI throughout.

    u (samples x inputs), y (samples x channels; NaN where a channel was not recorded), known:
    places of parameters that are held for it, p their values put into the data sheet's; jump: by
    what each of the rig's states may depart, where a window begins, from what the window before has
    led to; timescale_s: correlation time of the recordings, of which windows are multiples; first:
    index in the recording file of the first sample (for time and reports); lead: samples at the
    beginning that only serve to find the state, and are never scored.
    """

    name: str
    u: Array
    y: Array
    p: Array
    known: tuple[int, ...]
    period_s: float
    jump: Array
    timescale_s: float
    first: int = 0
    lead: int = 0

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Which channels were recorded."""
        return np.logical_not(np.isnan(self.y).any(axis=0))

    def part(self, start: int, stop: int, lead: int = 0) -> Track:
        """Samples start..stop, led in by up to `lead` samples before them."""
        begin = max(0, start - lead)
        return replace(
            self,
            u=self.u[begin:stop],
            y=self.y[begin:stop],
            first=self.first + begin,
            lead=start - begin,
        )


def track_of(
    assembly: Assembly,
    recording: Recording,
    channels: tuple[str, ...],
    jump: Array | None = None,
    timescale_s: float | None = None,
) -> Track:
    """The recording's inputs and measured channels for this assembly; without `jump` states depart
    as they like, without `timescale_s` it is that of this recording by itself."""
    p, known = known_values(assembly, recording.known)
    free = np.full(len(assembly.rig.states), np.inf)
    y, period_s = _measured(channels, recording), recording.sampling_period_s
    if timescale_s is None:
        timescale_s = timescale_of([(y, noise_level(y), period_s)])
    return Track(
        recording.name,
        input_table(assembly, recording),
        y,
        p,
        tuple(known),
        period_s,
        free if jump is None else jump,
        timescale_s,
    )


def stated_noise(rig: Rig, channels: Sequence[str]) -> Array:
    """What the rig says of its sensors: standard deviation per channel (SI), 0 where it says
    nothing."""
    units = [split_column(name)[1] for name in channels]
    return np.array(
        [
            size_to_si(rig.noise.get(name, 0.0), unit)
            for name, unit in zip(channels, units, strict=True)
        ]
    )


def _measured(channels: tuple[str, ...], recording: Recording) -> Array:
    """The channels, NaN those that were not recorded."""
    seen = tuple(c for c in channels if recording.has(c))
    if seen == channels:
        return output_table(channels, recording)
    y = np.full((len(recording), len(channels)), np.nan)
    y[:, [channels.index(c) for c in seen]] = output_table(seen, recording)
    return y


def noise_of(tracks: Sequence[Track], stated: Array) -> Array:
    """Noise level per channel over all tracks that have it; NaN where none has. stated: see
    `sensor_noise`."""
    if all(t.seen.all() for t in tracks):
        return sensor_noise([t.y for t in tracks], stated)
    noise = np.full(tracks[0].y.shape[1], np.nan)
    for c in range(noise.size):
        own = [t.y[:, [c]] for t in tracks if t.seen[c]]
        noise[c] = sensor_noise(own, stated[[c]])[0] if own else np.nan
    return noise
