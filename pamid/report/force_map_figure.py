"""Picture of a measured force map: points over the curves of two laws, and both errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pamid.base.arrays import Array
from pamid.report.style import Drawing, colour, finish, label, level, png_of

LIGHTEST = 0.9  # of the colour scale: its yellow end does not show on white


@dataclass(frozen=True, eq=False)
class Side:
    """A law: its curves (levels, steps), N, and its errors on the points held out (points,), N."""

    title: str
    curves: Array
    errors: Array


def force_map_picture(
    contraction: Array,
    pressure_kpa: Array,
    force_n: Array,
    steps: Array,
    levels: Array,
    sides: Sequence[Side],
    title: str,
) -> bytes:
    """PNG of measured points (points,) over each law's force-contraction curves, and below them its
    errors.

    steps: contractions of the curves; levels: their pressures, kPa. Colour is pressure, everywhere
    the same.
    """
    colours = colormaps["viridis_r"].resampled(256)
    low, high = float(pressure_kpa.min()), float(pressure_kpa.max())
    shades = Normalize(low - (1.0 - LIGHTEST) / LIGHTEST * (high - low), high)

    def draw(figure: Figure, _: bool) -> None:
        axes = figure.subplots(
            2, len(sides), sharex=True, sharey="row", squeeze=False, height_ratios=(2.0, 1.0)
        )
        for (above, below), side in zip(axes.T, sides, strict=True):
            for pressure, curve in zip(levels, side.curves, strict=True):
                above.plot(steps, curve, color=colours(shades(pressure)), linewidth=1.1)
            for panel, values in ((above, force_n), (below, side.errors)):
                panel.scatter(
                    contraction,
                    values,
                    s=9.0,
                    c=colours(shades(pressure_kpa)),
                    edgecolors=colour("ink"),
                    linewidths=0.3,
                    zorder=3,
                )
                finish(panel)
            level(below, 0.0, "ink")
            above.set_title(label(side.title), loc="left")
            below.set_xlabel("contraction [-]")
        axes[0, 0].set_ylabel("force [N]")
        axes[1, 0].set_ylabel("held-out error [N]")
        bar = figure.colorbar(
            ScalarMappable(shades, colours),
            ax=axes,
            boundaries=np.linspace(low, high, 256),
            aspect=30,
            pad=0.02,
        )
        bar.set_label("gauge pressure [kPa]")
        bar.set_ticks(
            [float(level) for level in levels], labels=[f"{level:.0f}" for level in levels]
        )
        bar.outline.set_visible(False)  # type: ignore[operator]

    return png_of(Drawing("force-map", title, draw, 4.6, 4.6))
