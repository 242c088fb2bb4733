"""Picture of an excitation: its columns, and what they cover or miss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from pamid.base.arrays import Array
from pamid.base.units import NONE
from pamid.report.style import Drawing, colour, finish, label, line, png_of
from pamid.simulation.excitation.aprbs import BINS, CELLS, Changes, Coverage, spectrum

MOST_CHANGES = 60  # changes that can be distinguished in a panel
MOST_TICKS = 5
DEEPEST_DB = -60.0
DASHED = (0, (4, 2))


@dataclass(frozen=True, eq=False)
class ExcitedColumn:
    """A column to draw: samples (n,) of its excited part, their coverage, the requested band and
    the rate limit."""

    column: str
    unit: str
    period_s: float
    samples: Array
    covers: Coverage
    band_hz: tuple[float, float] | None = None
    rate_limit: float | None = None

    @property
    def axis(self) -> str:
        name = label(self.column)
        return name if self.unit == NONE else f"{name} [{label(self.unit)}]"

    @property
    def reach(self) -> str:
        """Band with its power; frequencies below the spectrum's resolution count as covered."""
        low, high = self.covers.band_20db_hz
        lowest = spectrum(self.samples, self.period_s)[0][0]
        return f"up to {high:.2g} Hz" if low <= lowest else f"{low:.2g} to {high:.2g} Hz"


def richness_picture(shown: Sequence[ExcitedColumn]) -> bytes:
    """PNG of the signal, the amplitudes, the spectrum and the changes of each column; the title is
    about the column with the least coverage."""

    def draw(figure: Figure, _: bool) -> None:
        parts = figure.subfigures(len(shown), 1, squeeze=False)[:, 0]
        for part, entry in zip(parts, shown, strict=True):
            layout = [["signal"] * 3, ["levels", "power", "changes"]]
            axes = part.subplot_mosaic(layout, height_ratios=[1.0, 1.25])
            _signal(axes["signal"], entry)
            _levels(axes["levels"], entry)
            _power(axes["power"], entry)
            _changes(axes["changes"], entry)

    height = 4.6 * len(shown)
    return png_of(Drawing("richness", finding(shown), draw, height, height))


def finding(shown: Sequence[ExcitedColumn]) -> str:
    """Coverage of the column that covers least, and its first blind spot."""
    poorest = max(shown, key=lambda item: len(item.covers.blind_spots()))
    least = "" if len(shown) == 1 else "Least covered: "
    return (
        f"{least}{poorest.column} visits {poorest.covers.visited:.0%} of its range, with power "
        f"{poorest.reach}. {poorest.covers.blind_spots()[0]}"
    )


def _signal(axes: Axes, shown: ExcitedColumn) -> None:
    """The signal as it is held, or so much of its beginning that changes can be distinguished."""
    changes, count = shown.covers.changes, len(shown.samples)
    if changes is not None and changes.pace_hz.size > 2 * MOST_CHANGES:
        count = round(float(np.sum(0.5 / changes.pace_hz[:MOST_CHANGES])) / shown.period_s)
    time = shown.period_s * np.arange(count)
    line(axes, time, shown.samples[:count], "refitted", 0.9, drawstyle="steps-post")
    axes.set_xlim(0.0, count * shown.period_s)
    total = len(shown.samples)
    part = (
        f", first {count * shown.period_s:.3g} of {total * shown.period_s:.3g} s"
        if count < total
        else ""
    )
    axes.set_title(f"what is sent{part}", loc="left")
    finish(axes, "time [s]", shown.axis)


def _levels(axes: Axes, shown: ExcitedColumn) -> None:
    edges = np.linspace(shown.covers.low, shown.covers.high, BINS + 1)
    axes.bar(
        edges[:-1],
        100.0 * np.array(shown.covers.histogram),
        np.diff(edges),
        align="edge",
        color=colour("refitted"),
        edgecolor=colour("paper"),
        linewidth=0.5,
    )
    axes.axhline(100.0 / BINS, color=colour("with_cause"), linewidth=1.0, linestyle=DASHED)
    axes.set_title(f"{shown.covers.visited:.0%} visited", loc="left")
    _name_dashed_line(axes, "even")
    finish(axes, shown.axis, "share of time [%]", lines="")


def _power(axes: Axes, shown: ExcitedColumn) -> None:
    frequency, power = spectrum(shown.samples, shown.period_s)
    axes.axvspan(*shown.covers.band_20db_hz, color=colour("faint"), linewidth=0.0)
    decibels = 10.0 * np.log10(np.maximum(power / power.max(), 1e-12))
    axes.semilogx(frequency, decibels, color=colour("refitted"), linewidth=1.0)
    for edge in shown.band_hz or ():
        axes.axvline(edge, color=colour("with_cause"), linewidth=1.0, linestyle=DASHED)
    axes.set_ylim(DEEPEST_DB, 3.0)
    _frequencies(axes, float(frequency[0]), float(frequency[-1]))
    axes.set_title(shown.reach, loc="left")
    if shown.band_hz:
        _name_dashed_line(axes, "requested band")
    finish(axes, "frequency [Hz]", "power [dB]")


def _changes(axes: Axes, shown: ExcitedColumn) -> None:
    changes = shown.covers.changes
    finish(axes, "pace 1/(2 time) [Hz]", "size of change [% of range]", lines="")
    if changes is None:
        axes.set_title("fewer than two changes", loc="left")
        return
    slowest = 0.9 * float(min(changes.pace_hz.min(), changes.edges_hz[0]))
    fastest = 1.1 * float(max(changes.pace_hz.max(), changes.edges_hz[-1]))
    _cells(axes, changes, np.array([slowest, *changes.edges_hz[1:-1], fastest]))
    axes.scatter(
        changes.pace_hz,
        100.0 * changes.size,
        s=7.0 if changes.size.size > MOST_CHANGES else 18.0,
        color=colour("refitted"),
        alpha=0.45,
        linewidths=0.0,
        zorder=3,
        clip_on=False,
    )
    axes.set_xscale("log")
    axes.set_ylim(0.0, 104.0)
    _frequencies(axes, slowest, fastest)
    axes.set_title(f"{np.count_nonzero(changes.share)} of {CELLS**2} kinds", loc="left")
    # no change is larger than the rate limit lets it grow in its time
    if shown.rate_limit is not None:
        pace = np.geomspace(slowest, fastest, 100)
        size = 50.0 * shown.rate_limit / pace / (shown.covers.high - shown.covers.low)
        line(axes, pace, size, "with_cause", 1.0, DASHED)
        _name_dashed_line(axes, "rate limit")


def _name_dashed_line(axes: Axes, words: str) -> None:
    """The name of a dashed line: the request."""
    axes.set_title(words, loc="right", fontsize=8.0, color=colour("with_cause"))


def _cells(axes: Axes, changes: Changes, edges: Array) -> None:
    """Kinds of changes that occur lie on grey."""
    for (row, column), share in np.ndenumerate(changes.share):
        axes.fill_between(
            edges[column : column + 2],
            100.0 * row / CELLS,
            100.0 * (row + 1) / CELLS,
            linewidth=0.6,
            edgecolor=colour("line"),
            facecolor=colour("faint") if share > 0.0 else colour("paper"),
        )


def _frequencies(axes: Axes, low: float, high: float) -> None:
    """Up to five plain numbers along a logarithmic axis."""
    axes.set_xlim(low, high)
    for digits in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        ticks = np.outer(10.0 ** np.arange(-6.0, 7.0), digits).ravel()
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        if ticks.size <= MOST_TICKS:
            break
    axes.xaxis.set_major_locator(FixedLocator(ticks.tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
