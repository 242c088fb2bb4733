"""All samples of a run as the page carries them: which columns are drawn, in which order, and
numbers packed into text.

A trace is quantised to 65535 levels over its span; whole numbers are stored as their differences,
byte by byte, deflated, in base64. The page unpacks what it draws, when it draws it.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.run_files import RESIDUAL_KEYS
from pamid.base.units import split_column
from pamid.report.channel_errors import stretches
from pamid.report.load import Residual

SAMPLE_LEVELS, MISSING_SAMPLE = 65534, -1
# about 20 MB of page; beyond it recordings are cut short, those held out last
MOST_VALUES = 16_000_000
FREE_RUNS = ("free_run", "cause_free_run")  # over whole recordings, each from an estimated state
TRACE_KINDS = ("data_sheet", "refitted", "cause", "network", "loop", "loop_network", *FREE_RUNS)
_TICKS = 30_000  # per sampling period: times are whole numbers of them

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Packed:
    """Values offset + step * k with k from `text`; k = -1 for a missing value."""

    offset: float
    step: float
    text: str


@dataclass(frozen=True)
class Stretch:
    """A recording's rows of residual.csv in order of time; windows: (first, last place among them,
    is it held out)."""

    recording: int
    rows: IntArray
    windows: tuple[tuple[int, int, bool], ...]
    cut: bool  # there was more of it than a page can hold


def packed(values: Array) -> Packed:
    """Values quantised to 65535 levels between the smallest and the largest; values that are
    not finite are missing."""
    usable = np.isfinite(values)
    if not usable.any():
        return Packed(0.0, 1.0, text_of(np.full(values.size, MISSING_SAMPLE)))
    low, high = float(values[usable].min()), float(values[usable].max())
    step = (high - low) / SAMPLE_LEVELS or 1.0
    places = np.full(values.size, MISSING_SAMPLE, np.int64)
    places[usable] = np.rint((values[usable] - low) / step)
    return Packed(low, step, text_of(places))


def packed_times(time: Array) -> Packed:
    """Rising times [s], to a thirty-thousandth of the sampling period."""
    step = (float(np.median(np.diff(time))) if time.size > 1 else 1.0) / _TICKS
    ticks = np.rint((time - time[0]) / step).astype(np.int64)
    return Packed(float(time[0]), step, text_of(np.diff(ticks, prepend=0)))


def text_of(numbers: IntArray) -> str:
    """Whole numbers below 2**30: differences, least bytes first, deflated, base64."""
    steps = np.diff(numbers, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4")
    planes = folded.view(np.uint8).reshape(-1, 4).T.tobytes()
    return base64.b64encode(zlib.compress(planes, 6)).decode()


def channels_of(residual: Residual) -> list[str]:
    """Measured columns for which there is a refitted model."""
    return [
        name
        for name, values in residual.columns.items()
        if np.isfinite(values).any() and has(residual, name, "refitted")
    ]


def has(residual: Residual, channel: str, kind: str) -> bool:
    """Is there anything of this model's trace?"""
    values = residual.of(channel, kind)
    return values is not None and bool(np.isfinite(values).any())


def inputs_of(residual: Residual) -> list[str]:
    """Commands and references that vary: neither measured nor modelled."""
    channels = channels_of(residual)
    stems = {f"{split_column(name)[0]}_{kind}" for name in channels for kind in TRACE_KINDS}
    return [
        name
        for name, values in residual.columns.items()
        if name not in (*RESIDUAL_KEYS, *channels)
        and (stem := split_column(name)[0]) not in stems
        and not stem.endswith("_loop")
        and np.isfinite(values).any()
        and np.nanmin(values) < np.nanmax(values)
    ]


def stretches_of(residual: Residual, most_rows: int) -> list[Stretch]:
    """Every recording in order of time, without repeated times. Beyond `most_rows` rows in total
    the last recordings are left out, fitted ones before held-out ones."""
    columns = residual.columns
    usable = np.flatnonzero(np.isfinite(columns["time_s"]))
    chosen = usable[np.argsort(columns["part"][usable] != 1, kind="stable")][:most_rows]
    allowed = np.zeros(columns["time_s"].size, bool)
    allowed[chosen] = True
    windows = stretches(residual, np.flatnonzero(allowed & (columns["window"] >= 0)))
    plotted = []
    for number in np.unique(columns["recording"][usable]):
        recorded = usable[columns["recording"][usable] == number]
        rows = recorded[allowed[recorded]]
        rows = rows[np.unique(columns["time_s"][rows], return_index=True)[1]]
        if rows.size < 2:
            continue
        place = np.full(columns["time_s"].size, -1)
        place[rows] = np.arange(rows.size)
        inside = [
            (int(place[w.start]), int(place[w.stop - 1]), bool(columns["part"][w.start] == 1))
            for w in windows
            if columns["recording"][w.start] == number
        ]
        plotted.append(
            Stretch(
                int(number),
                rows,
                tuple(sorted(window for window in inside if 0 <= window[0] < window[1])),
                rows.size < recorded.size,
            )
        )
    return plotted
