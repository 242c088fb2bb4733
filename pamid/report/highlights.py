"""Places in the samples that the answers speak of: the worst windows, the windows and the regimes
of the diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import runs_of
from pamid.base.units import split_column
from pamid.recording.signal_filters import local_parabola
from pamid.report import formatting
from pamid.report.captions import regime_label
from pamid.report.formatting import channel_label, channel_unit
from pamid.report.load import Residual, RunData
from pamid.report.reading import FloatArray
from pamid.report.samples import Stretch, channels_of, inputs_of
from pamid.schemas.diagnosis_file import Regime
from pamid.simulation.correlation_time import correlation_samples
from pamid.verdict.localise import SMOOTHED

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
    """Stretches of a recording worth a look, for errors of this channel."""
    error = np.abs(residual.columns[channel] - _refitted(residual, channel))
    worst = _worst(residual, channel, error, stretches, run)
    where = run.diagnosis.where if run.diagnosis is not None else None
    if where is None or (
        run.diagnosis is not None and run.diagnosis.verdict == "no-structural-gap"
    ):
        return worst
    named = [_named(residual, error, stretches, span) for span in sorted(where.windows_s)]
    regimes = [_regime(residual, error, stretches, regime) for regime in where.regimes]
    return [*(name for name in (*named, *regimes) if name is not None), *worst]


def _refitted(residual: Residual, channel: str) -> FloatArray:
    values = residual.of(channel, "refitted")
    assert values is not None
    return values


def _scored_windows(stretches: Sequence[Stretch]) -> list[tuple[Stretch, int, int]]:
    """Windows as (stretch, first, last); only held-out ones, if there are any."""
    every = [(stretch, *window) for stretch in stretches for window in stretch.windows]
    held_out = any(window[3] for window in every)
    return [(part, first, last) for part, first, last, held in every if held == held_out]


def _worst(
    residual: Residual, channel: str, error: FloatArray, stretches: Sequence[Stretch], run: RunData
) -> list[Highlight]:
    """The windows in which the refitted model is off most, worst first."""
    scored = [
        (float(np.nanmean(error[stretch.rows[first : last + 1]])), stretch, first, last)
        for stretch, first, last in _scored_windows(stretches)
        if np.isfinite(error[stretch.rows[first : last + 1]]).any()
    ]
    time, places = residual.columns["time_s"], []
    for size, stretch, first, last in sorted(scored, key=lambda each: -each[0])[:WORST]:
        begin, end = float(time[stretch.rows[first]]), float(time[stretch.rows[last]])
        off = formatting.with_unit_text(size, channel_unit(channel))
        label = (
            f"{formatting.span(begin, end, 's', 4)}{run.recording_words(stretch.recording)}: "
            f"{channel_label(channel)} off by"
        )
        places.append(Highlight("how far", f"{label} {off}", stretch.recording, begin, end))
    return places


def _named(
    residual: Residual, error: FloatArray, stretches: Sequence[Stretch], span: tuple[float, float]
) -> Highlight | None:
    """A window of the diagnosis, which does not say of which recording: the one with most error
    there."""
    best: tuple[float, Stretch] | None = None
    for stretch in stretches:
        time = residual.columns["time_s"][stretch.rows]
        inside = error[
            stretch.rows[
                (time >= span[0])
                & (time <= span[1])
                & (residual.columns["window"][stretch.rows] >= 0)
            ]
        ]
        size = float(inside.sum()) if inside.size and np.isfinite(inside).all() else -1.0
        if size >= 0.0 and (best is None or size > best[0]):
            best = size, stretch
    return (
        None
        if best is None
        else Highlight("where", formatting.span(*span, "s", 4), best[1].recording, *span)
    )


def _regime(
    residual: Residual, error: FloatArray, stretches: Sequence[Stretch], regime: Regime
) -> Highlight | None:
    """The window with most error within the regime; None if its signal does not stand in
    residual.csv."""
    low = -np.inf if regime.low is None else regime.low
    high = np.inf if regime.high is None else regime.high
    inside = {}
    for stretch in stretches:
        values = signal_along(residual, regime.signal, stretch.rows)
        if values is None:
            return None
        inside[stretch.recording] = (values >= low) & (values <= high)
    counted = {number: np.where(mask, 1.0, 0.0) for number, mask in inside.items()}
    scored = [
        (
            float(np.nansum((error[part.rows] * counted[part.recording])[first : last + 1])),
            part,
            first,
            last,
        )
        for part, first, last in _scored_windows(stretches)
    ]
    if not scored:
        return None
    _, stretch, first, last = max(scored, key=lambda each: each[0])
    time = residual.columns["time_s"][stretch.rows]
    bands = _bands(time, inside[stretch.recording])
    if not 0 < len(bands) <= MOST_BANDS:
        return None
    return Highlight(
        "where",
        regime_label(regime),
        stretch.recording,
        float(time[first]),
        float(time[last]),
        bands,
    )


def signal_along(residual: Residual, name: str, rows: NDArray[np.int64]) -> FloatArray | None:
    """A measured or sent signal by the name that regimes give it, or the rate of a measured one
    (per s)."""
    stems = {
        split_column(column)[0]: column for column in (*channels_of(residual), *inputs_of(residual))
    }
    if name in stems:
        return residual.columns[stems[name]][rows]
    of = (
        name.removesuffix("_rate")
        if name.endswith("_rate")
        else {"velocity": "angle"}.get(name, "")
    )
    of = "position" if name == "velocity" and of not in stems else of
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


def _bands(time: FloatArray, inside: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Intervals of time in which the mask is true."""
    return tuple(
        (float(time[a]), float(time[b - 1])) for a, b in zip(*runs_of(inside), strict=True)
    )
