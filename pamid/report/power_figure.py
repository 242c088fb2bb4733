"""The picture of an experiment's power: effects by size, and from when on each of them shows."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from pamid.base.schemas.command_files import PowerFile
from pamid.report.style import Drawing, colour, label

EFFECT_ROW_IN, HEAD_IN = 0.2, 1.2
PLAINEST = 100.0  # error over the noise floor at which the colours end
MARKS = (2.0, 5.0, 10.0, 20.0, 50.0, PLAINEST)


def power_drawing(power: PowerFile, title: str) -> Drawing:
    """A row per effect (most visible first), a column per size; the colour is the error of the
    refitted model over the noise floor, and undetectable sizes are white."""
    shown = [e for e in power.effects if e.visible]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        table = np.array([e.visible for e in shown])
        seen = np.ma.masked_less(np.minimum(table, PLAINEST), power.seen)
        image = axes.imshow(
            seen,
            aspect="auto",
            cmap=colormaps["viridis_r"],
            norm=LogNorm(power.seen, PLAINEST),
        )
        axes.set_yticks(range(len(shown)), [label(e.effect) for e in shown], fontsize=7.0)
        axes.set_xticks(range(len(power.sizes)), [f"{s:g}" for s in power.sizes])
        axes.set_xlabel("size [usual sizes]")
        for i, e in enumerate(shown):
            for j, v in enumerate(e.visible):
                if v < power.seen:
                    axes.text(
                        j, i, "-", ha="center", va="center", fontsize=7.0, color=colour("muted")
                    )
        marks = [power.seen, *(m for m in MARKS if m > power.seen)]
        bar = figure.colorbar(
            image, ax=axes, pad=0.02, aspect=40, ticks=marks, format=lambda v, _: f"{v:g}"
        )
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.set_label("error over the noise floor [-]")

    height = HEAD_IN + EFFECT_ROW_IN * len(shown)
    return Drawing("power", title, draw, height, height)
