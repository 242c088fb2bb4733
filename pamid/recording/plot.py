"""A plot of signals over time, a panel per signal, as a Figure that a notebook shows."""

from __future__ import annotations

import io
from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from pamid.base.arrays import Array
from pamid.base.units import NONE, split_column

POINTS = 4000  # of a panel; more cannot be seen
PLOT_WIDTH_IN, PANEL_IN = 8.0, 1.15


class NotebookFigure(Figure):
    """A figure that is shown where it is the value of a notebook's cell, without pyplot, whose
    windows and list of open figures a library has no business with."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        # names out of a file are no formulas, however many dollar signs they hold
        with matplotlib.rc_context({"text.parse_math": False}):
            self.savefig(buffer, format="png", dpi=110, facecolor="white")
        return buffer.getvalue()


def plot_signals(title: str, time: Array, signals: Mapping[str, Array]) -> NotebookFigure:
    """Every signal (n,) in a separate panel over time (n,) in s; the unit is the end of its
    name."""
    with matplotlib.rc_context({"text.parse_math": False}):
        figure = NotebookFigure(
            figsize=(PLOT_WIDTH_IN, 0.8 + PANEL_IN * len(signals)), layout="constrained"
        )
        panels = figure.subplots(len(signals), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, values) in zip(panels, signals.items(), strict=True):
            stem, unit = split_column(name)
            axes.plot(*_thinned(time, values), linewidth=0.9)
            axes.set_title(stem.replace("_", " "), loc="left", fontsize=9.0, pad=2.0)
            axes.set_ylabel(f"[{unit if unit != NONE else '-'}]")
            axes.grid(alpha=0.3)
            axes.margins(x=0.0)
        panels[-1].set_xlabel("time [s]")
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def _thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Lowest and highest sample of every stretch, in the order of time, so that no spike is
    lost."""
    stretch = -(-values.size // (POINTS // 2))
    if stretch <= 2:
        return time, values
    starts = np.arange(0, values.size - stretch + 1, stretch)
    parts = values[: starts.size * stretch].reshape(starts.size, stretch)
    ends = np.stack([parts.argmin(axis=1), parts.argmax(axis=1)], axis=1)
    rows = np.unique(np.concatenate([(starts[:, None] + np.sort(ends)).ravel(), [values.size - 1]]))
    return time[rows], values[rows]
