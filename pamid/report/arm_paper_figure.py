"""The picture of the second paper's validation: every variable of the arm, measured over
simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pamid.report.style import Drawing, Picture, colour, grid, legend_above, render

Array = NDArray[np.float64]
Line = tuple[str, str, str, float, str]  # attribute, word, colour's role, width, style

# noise over range from which a measured line is drawn thin, and how thin
ROUGH_LINE, THIN_LINE = 0.05, 0.5


@dataclass(frozen=True, eq=False)
class Panel:
    """A variable (samples,) in the unit that its label ends with."""

    label: str
    measured: Array
    data_sheet: Array
    fitted: Array


def arm_picture(name: str, title: str, time_s: Array, panels: Sequence[Panel]) -> Picture:
    """One panel per variable against time, two in a row; the simulated lines lie over the broad
    measured one."""
    lines = (
        ("measured", "measured", "noise_floor", 2.6, "-"),
        ("data_sheet", "data sheet", "ink", 0.8, "--"),
        ("fitted", "fitted, ANFIS law", "with_cause", 1.0, "-"),
    )

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(-(-len(panels) // 2), 2, sharex=True, squeeze=False)
        for axis, panel in zip(axes.flat, panels, strict=True):
            rough = np.std(np.diff(panel.measured)) > ROUGH_LINE * np.ptp(panel.measured)
            _against_time(axis, time_s, panel, lines, thin=bool(rough))
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        figure.legend(
            *axes[0, 0].get_legend_handles_labels(),
            loc="outside lower left",
            ncols=1 if narrow else 3,
        )

    return render(Drawing(name, title, draw, 8.4, 8.4))


@dataclass(frozen=True, eq=False)
class JointSwing:
    """An angle (samples,), deg, at a joint whose valves stay shut, over time_s (samples,)."""

    label: str
    time_s: Array
    measured: Array
    fitted: Array
    without_coupling: Array


def coupling_picture(title: str, swings: Sequence[JointSwing]) -> Picture:
    """One panel per joint that is swung by pulses on the other one."""
    lines = (
        ("measured", "measured", "noise_floor", 2.6, "-"),
        ("without_coupling", "fitted, coupling terms left out", "ink", 0.9, "--"),
        ("fitted", "fitted", "with_cause", 1.1, "-"),
    )

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(swings), 1, squeeze=False)[:, 0]
        for axis, swing in zip(axes, swings, strict=True):
            _against_time(axis, swing.time_s, swing, lines)
        legend_above(axes[0], 1 if narrow else 3)
        axes[-1].set_xlabel("time [s]")

    return render(Drawing("coupling", title, draw, 4.4, 4.6))


def _against_time(
    axes: Axes,
    time_s: Array,
    shown: Panel | JointSwing,
    lines: Sequence[Line],
    *,
    thin: bool = False,
) -> None:
    """The lines of a panel; thin: the measured one."""
    for part, word, role, width, style in lines:
        axes.plot(
            time_s,
            getattr(shown, part),
            style,
            color=colour(role),
            linewidth=THIN_LINE if thin and part == "measured" else width,
            label=word,
        )
    grid(axes, "y")
    axes.set_ylabel(shown.label)
