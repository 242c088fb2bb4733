"""Places in the samples that the answers speak of: worst windows, named windows, regimes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import runs_of
from pamid.base.schemas.diagnosis_file import Regime
from pamid.base.units import split_column
from pamid.diagnosis.verdict.localise import SMOOTHED
from pamid.recording.signal_filters import local_parabola
from pamid.report import formatting
from pamid.report.captions import regime_label
from pamid.report.formatting import channel_label, channel_unit
from pamid.report.load import Residual, RunData
from pamid.report.samples import Stretch, channels_of, inputs_of
from pamid.simulation.correlation_time import correlation_samples

WORST = 5
MOST_BANDS = 2000


@dataclass(frozen=True)
class Highlight:
    """Times [s] of a recording; answer: the question whose answer names it; bands: the times within
    the recording that are meant, where these are not simply the first and the last."""

    answer: str
    label: str
    recording: int
    begin: float
    end: float
    bands: tuple[tuple[float, float], ...] = ()


def highlights_of(
    run: RunData, residual: Residual, channel: str, stretches: Sequence[Stretch]
) -> list[Highlight]:
    """Stretches of a recording worth a look, for errors of this channel: windows and regimes of the
    diagnosis, then the windows in which the refitted model is off most, worst first."""
    refitted = residual.of(channel, "refitted")
    assert refitted is not None
    error, time = np.abs(residual.columns[channel] - refitted), residual.columns["time_s"]
    every = [(part, *window) for part in stretches for window in part.windows]
    held_out = any(held for *_, held in every)
    windows = [(part, first, last) for part, first, last, held in every if held == held_out]
    diagnosis = run.diagnosis
    where = diagnosis.where if diagnosis is not None else None
    places: list[Highlight | None] = []
    if where is not None and diagnosis is not None and diagnosis.verdict != "no-structural-gap":
        places += [_named(residual, error, stretches, span) for span in sorted(where.windows_s)]
        places += [_regime(residual, error, stretches, windows, item) for item in where.regimes]
    scored = [
        (float(np.nanmean(inside)), part, first, last)
        for part, first, last in windows
        if np.isfinite(inside := error[part.rows[first : last + 1]]).any()
    ]
    for size, part, first, last in sorted(scored, key=lambda each: -each[0])[:WORST]:
        begin, end = float(time[part.rows[first]]), float(time[part.rows[last]])
        label = (
            f"{formatting.span(begin, end, 's', 4)}{run.recording_words(part.recording)}: "
            f"{channel_label(channel)} off by "
            f"{formatting.with_unit_text(size, channel_unit(channel))}"
        )
        places.append(Highlight("how far", label, part.recording, begin, end))
    return [place for place in places if place is not None]


def _named(
    residual: Residual, error: Array, stretches: Sequence[Stretch], span: tuple[float, float]
) -> Highlight | None:
    """A window of the diagnosis, which does not name its recording: it is taken from the recording
    with the largest error."""
    sizes = {}
    for stretch in stretches:
        rows = stretch.rows
        time, scored = residual.columns["time_s"][rows], residual.columns["window"][rows] >= 0
        inside = error[rows[(time >= span[0]) & (time <= span[1]) & scored]]
        if inside.size and np.isfinite(inside).all():
            sizes[stretch.recording] = float(inside.sum())
    if not sizes:
        return None
    worst = max(sizes, key=lambda number: sizes[number])
    return Highlight("where", formatting.span(*span, "s", 4), worst, *span)


def _regime(
    residual: Residual,
    error: Array,
    stretches: Sequence[Stretch],
    windows: Sequence[tuple[Stretch, int, int]],
    regime: Regime,
) -> Highlight | None:
    """The window with most error within the regime; None if its signal is not recorded."""
    low = -np.inf if regime.low is None else regime.low
    high = np.inf if regime.high is None else regime.high
    inside = {}
    for stretch in stretches:
        values = signal_along(residual, regime.signal, stretch.rows)
        if values is None:
            return None
        inside[stretch.recording] = (values >= low) & (values <= high)

    def size(window: tuple[Stretch, int, int]) -> float:
        part, first, last = window
        counted = np.where(inside[part.recording], error[part.rows], 0.0)
        return float(np.nansum(counted[first : last + 1]))

    if not windows:
        return None
    part, first, last = max(windows, key=size)
    time = residual.columns["time_s"][part.rows]
    bands = tuple(
        (float(time[a]), float(time[b - 1]))
        for a, b in zip(*runs_of(inside[part.recording]), strict=True)
    )
    if not 0 < len(bands) <= MOST_BANDS:
        return None
    label, begin, end = regime_label(regime), float(time[first]), float(time[last])
    return Highlight("where", label, part.recording, begin, end, bands)


def signal_along(residual: Residual, name: str, rows: NDArray[np.int64]) -> Array | None:
    """A signal by the name that regimes give it, or the rate of a measured signal (per s)."""
    stems = {
        split_column(column)[0]: column for column in (*channels_of(residual), *inputs_of(residual))
    }
    if name in stems:
        return residual.columns[stems[name]][rows]
    of = name.removesuffix("_rate") if name.endswith("_rate") else ""
    if name == "velocity":
        of = "angle" if "angle" in stems else "position"
    if of not in stems:
        return None
    time, values = residual.columns["time_s"][rows], residual.columns[stems[of]][rows]
    period = float(np.median(np.diff(time)))
    if not np.isfinite(values).all():
        return None
    # as far as the diagnosis smooths it, by how long this signal remembers
    remembered, _ = correlation_samples(values)
    length = max(5, 2 * round(SMOOTHED * np.nan_to_num(remembered)) + 1)
    if values.size < length:
        return None
    return local_parabola(values, length, period, 1)
