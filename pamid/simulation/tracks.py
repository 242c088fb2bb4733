"""Recordings as a model sees them: inputs and measured channels in SI, with what is known of each,
and the noise of their channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.units import NONE, column_size, size_to_si, split_column
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.noise import noise_level, sensor_noise
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.free_runs import known_values
from pamid.simulation.rig_data import Data


@dataclass(frozen=True)
class Track:
    """A recording as a fit uses it. SI throughout.

    u (samples x inputs); y (samples x channels; NaN where a channel was not recorded); known:
    places of parameters that are held for it; p: the data sheet with their values; jump: possible
    deviation of each of the rig's states, at a window start, from its prediction by the window
    before; timescale_s: correlation time of the recordings, the unit of window lengths; first:
    index of the first sample in the recording file (for time and reports); lead: samples at the
    beginning that only serve to estimate the state, and are never scored; share: of all samples in
    its role, fitted or held out.
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
    share: float = 1.0

    def __len__(self) -> int:
        return len(self.u)

    @property
    def inputs(self) -> SampledInputs:
        return SampledInputs(self.u, self.period_s, self.first * self.period_s)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Mask of the recorded channels."""
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
    recording: Data,
    channels: tuple[str, ...],
    jump: Array | None = None,
    timescale_s: float | None = None,
) -> Track:
    """The recording's inputs and measured channels for this assembly; without `jump` states depart
    as they like, without `timescale_s` it is that of this recording by itself."""
    p, known = known_values(assembly, recording.known)
    free = np.full(len(assembly.rig.states), np.inf)
    y, period_s = recording.outputs(channels), recording.sampling_period_s
    if timescale_s is None:
        timescale_s = timescale_of([(y, noise_level(y), period_s)])
    return Track(
        recording.name,
        recording.inputs(assembly),
        y,
        p,
        tuple(known),
        period_s,
        free if jump is None else jump,
        timescale_s,
    )


def stated_noise(rig: Rig, channels: Sequence[str]) -> Array:
    """Standard deviation per channel (SI) that the rig states for its sensors, 0 where it states
    none."""
    units = [split_column(name)[1] for name in channels]
    return np.array(
        [
            size_to_si(rig.noise.get(name, 0.0), unit)
            for name, unit in zip(channels, units, strict=True)
        ]
    )


def noise_of(tracks: Sequence[Track], stated: Array) -> Array:
    """Noise level per channel over all tracks that have it; NaN where none has. stated: see
    `sensor_noise`."""
    if all(t.seen.all() for t in tracks):
        return sensor_noise([t.y for t in tracks], stated, [t.u for t in tracks]).used
    noise = np.full(tracks[0].y.shape[1], np.nan)
    for c in range(noise.size):
        recorded = [t for t in tracks if t.seen[c]]
        if recorded:
            parts, inputs = [t.y[:, [c]] for t in recorded], [t.u for t in recorded]
            noise[c] = sensor_noise(parts, stated[[c]], inputs).used[0]
    return noise


@dataclass(frozen=True)
class NoiseRemark:
    """A channel whose noise in fits and floors differs from what its rig or its samples suggest.

    kind      "noise": the recordings contradict the stated noise; "clinging": readings stand still
              and leap
    channel   name of the output
    text      what was observed and which noise is used
    used      the noise used, in the unit of the channel
    """

    kind: str
    channel: str
    text: str
    used: float


def noise_remarks(
    rig: Rig, recordings: Sequence[Data], channels: Sequence[str]
) -> list[NoiseRemark]:
    """Remarks on the noise of these channels, each over the recordings that have it."""
    remarks = []
    for channel in channels:
        seen = [r for r in recordings if channel in r.values]
        inputs = [
            np.array([r.values[n] for n in rig.inputs if n in r.values]).reshape(-1, len(r)).T
            for r in seen
        ]
        parts = [r.outputs((channel,)) for r in seen]
        noise = sensor_noise(parts, stated_noise(rig, (channel,)), inputs)
        unit = split_column(channel)[1]
        symbol = "" if unit == NONE else f" {unit}"
        used, white, lag, stated = (
            column_size(channel, float(x[0]))
            for x in (noise.used, noise.white, noise.lag, noise.stated)
        )
        if noise.contradicts[0]:
            text = (
                f"{channel}: the rig states a noise of {stated:.2g}{symbol}, but the samples show "
                f"{white:.2g}{symbol}. The observed noise is used; correct the stated noise"
            )
            remarks.append(NoiseRemark("noise", channel, text, used))
        elif lag > 0.0:
            usage = (
                f"The stated noise of {used:.2g}{symbol} is used"
                if stated > 0.0
                else f"A noise of {used:.2g}{symbol} is used; state the error of the sensor as "
                "`noise` in the rig if it is known better"
            )
            text = (
                f"{channel} jumps between constant values while the machine moves, like a coarse "
                f"or slow sensor: its readings lag by {lag:.2g}{symbol} (rms). {usage}"
            )
            remarks.append(NoiseRemark("clinging", channel, text, used))
    return remarks
