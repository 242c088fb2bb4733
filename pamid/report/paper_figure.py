"""Pictures of the reproduced papers. Of the first: angle errors of every model on the steps, at
both inertias, and the paper's figures: responses, pressures, training, excitation, force surface.
Of the second: every variable of the arm, measured over simulated, and the coupling of the joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from pamid.report.evidence_figures import power_of_ten
from pamid.report.style import (
    Drawing,
    Picture,
    annotate,
    colour,
    finish,
    label,
    level,
    line,
    png_of,
    render,
)

Array = NDArray[np.float64]

#: colours of the models in the order they are drawn
LINE_ROLES = ("data_sheet", "with_network", "with_cause")
# noise over range from which a measured line is drawn thin, and how thin
ROUGH_LINE, THIN_LINE = 0.05, 0.5
_PANELS = {
    "mse": "MSE of scaled signals",
    "gradient": "norm of the gradient",
    "mu": "damping mu",
    "gamma": "effective weights gamma",
}


# ---- the first paper -----------------------------------------------------------------------------


def steps_picture(
    time_s: Array, errors: Mapping[str, Mapping[str, Array]], notes: Sequence[str]
) -> Picture:
    """errors: model - measured (samples,), deg, by case and then by model (at most three); notes: a
    remark per case.

    The title states the mean absolute errors of the first and the last model in the last case.
    """
    case, last = list(errors.items())[-1]
    sizes = [f"the {m} is off by {np.abs(error).mean():.2f} deg" for m, error in last.items()]
    title = f"At {case}, {sizes[0]}, {sizes[-1].replace(' is off', '')}"

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(errors), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axis, (name, models), note in zip(axes, errors.items(), notes, strict=True):
            for role, (model, values) in zip(LINE_ROLES, models.items(), strict=False):
                line(axis, time_s, values, role, 1.1, label=model)
            level(axis, 0.0, "ink")
            finish(axis, "", f"{name}\nerror [deg]" if narrow else f"{name} ({note})\nerror [deg]")
        finish(axes[0], legend=1 if narrow else 3)
        axes[-1].set_xlabel("time [s]")

    return render(Drawing("steps", title, draw, 4.2, 4.2))


@dataclass(frozen=True, eq=False)
class StepResponse:
    """The joint on the steps at an inertia: name of the case, and by legend entry the angle
    (samples,), deg, of the reference, the measurement and the models."""

    case: str
    reference: Array
    measured: Array
    models: Mapping[str, Array]


def responses_picture(time_s: Array, responses: Sequence[StepResponse], title: str) -> bytes:
    """Figures 5, 6 and 9 of the paper: PNG of the angle over the reference, a panel per inertia."""
    looks = (("ink", 1.2, "--"), ("with_network", 1.0, "-"))

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(responses), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axis, case in zip(axes, responses, strict=True):
            line(axis, time_s, case.reference, "muted", 0.8, label="reference")
            line(axis, time_s, case.measured, "noise_floor", 2.8, label="measured")
            for look, (word, angle) in zip(looks, case.models.items(), strict=False):
                line(axis, time_s, angle, *look, label=word)
            finish(axis, "", f"{case.case}\nangle [deg]")
        finish(axes[0], legend=4)
        axes[-1].set_xlabel("time [s]")

    return png_of(Drawing("responses", title, draw, 5.4, 5.4))


def pressures_picture(
    time_s: Array, cases: Mapping[str, Mapping[str, tuple[Array, Array]]], title: str
) -> bytes:
    """PNG of both pressures on the steps. cases: by inertia and muscle, measured and of the model
    (samples,), kPa."""

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(2, len(cases), sharex=True, sharey=True, squeeze=False)
        for column, (case, muscles) in zip(axes.T, cases.items(), strict=True):
            for axis, (muscle, (measured, model)) in zip(column, muscles.items(), strict=True):
                line(axis, time_s, measured, "noise_floor", 2.4, label="measured")
                line(axis, time_s, model, "ink", 0.9, "--", label="analytic model")
                finish(axis)
                axis.set_title(label(f"{case}, {muscle}"), loc="right", color=colour("muted"))
            column[-1].set_xlabel("time [s]")
        for axis in axes[:, 0]:
            axis.set_ylabel("gauge pressure [kPa]")
        finish(axes[0, 0], legend=2)

    return png_of(Drawing("pressures", title, draw, 4.8, 4.8))


def training_picture(
    trace: Mapping[str, Array], published: Mapping[str, float], weights: int, title: str
) -> bytes:
    """Figure 8 and table I of the paper: PNG of MSE, gradient, mu and gamma over the iterations;
    published: end of the paper's training, by name of the trace."""

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(2, 2, sharex=True)
        at_right: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right"}
        for axis, (name, word) in zip(axes.flat, _PANELS.items(), strict=True):
            line(axis, trace["iteration"], trace[name], "with_network", 1.2)
            if name == "gamma":
                level(axis, weights, "ink", 0.8)
                words, place = f"all {weights} weights", (1.0, weights)
                annotate(axis, words, place, (-2, -3), "ink", 8.0, va="top", **at_right)
            else:
                axis.set_yscale("log")
                axis.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
                axis.minorticks_off()
            end = published[name]
            axis.axhline(end, color=colour("with_cause"), linewidth=0.9, linestyle="--")
            words, shape = f"the paper's end: {end:.3g}", {"va": "bottom", **at_right}
            annotate(axis, words, (1.0, end), (-2, 3), "with_cause", 8.0, **shape)
            finish(axis, "", word)
        for axis in axes[-1]:
            axis.set_xlabel("iteration")

    return png_of(Drawing("network-training", title, draw, 4.8, 4.8))


def excitation_picture(
    time_s: Array, reference: Array, error: Array, closer_s: tuple[float, float], title: str
) -> bytes:
    """Figure 7 of the paper: PNG of the reference and of the error that the network learns
    (samples,), each scaled into [-1, 1]; below, a stretch of them."""
    name = "error signal: measured - analytic model"

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(2, 1, sharey=True)
        near = (time_s >= closer_s[0]) & (time_s < closer_s[1])
        for panel, rows, width in ((axes[0], slice(None), 0.6), (axes[1], near, 1.1)):
            line(panel, time_s[rows], reference[rows], "data_sheet", width, label="reference")
            line(panel, time_s[rows], error[rows], "with_cause", width, label=name)
            finish(panel, "", "scaled [-]")
            panel.margins(x=0.01)
        finish(axes[0], legend=2)
        axes[-1].set_xlabel("time [s]")

    return png_of(Drawing("excitation", title, draw, 4.6, 4.6))


def force_surface_picture(
    contraction: Array, pressure_kpa: Array, force_n: Array, other_n: Array, title: str
) -> bytes:
    """Figure 2 of the paper: PNG of a force law over contraction and pressure, force_n
    (contractions, pressures), N, below zero for a slack muscle, and its curves over those of
    another law, other_n."""
    colours = colormaps["viridis_r"].resampled(256)
    across = 100.0 * contraction

    def draw(figure: Figure, narrow: bool) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        levels = np.arange(0.0, force_n.max() + 100.0, 100.0)
        filled = left.contourf(across, pressure_kpa, force_n.T, levels=levels, cmap=colours)
        left.text(0.95, 0.06, "slack", transform=left.transAxes, ha="right", fontsize=8.5)
        finish(left, "contraction [%]", "gauge pressure [kPa]", lines="")
        bar = figure.colorbar(filled, ax=left, pad=0.02)
        bar.set_label("force [N]")
        bar.outline.set_visible(False)  # type: ignore[operator]
        for k in np.linspace(0, len(pressure_kpa) - 1, 7).round().astype(int)[1:]:
            line(right, across, np.maximum(force_n[:, k], 0.0), "refitted", 1.2)
            line(right, across, np.maximum(other_n[:, k], 0.0), "ink", 0.8, "--")
            words, place = f"{pressure_kpa[k]:.0f} kPa", (0.0, float(force_n[0, k]))
            annotate(right, words, place, (-4, 0), "muted", 7.5, ha="right")
        right.lines[0].set_label("polynomial of fifth order")
        right.lines[1].set_label("exponential law")
        right.legend(loc="upper right")
        right.set_xlim(-8.0, 26.0)
        right.set_ylim(top=1.2 * force_n.max())
        right.set_xticks(range(0, 26, 5))
        finish(right, "contraction [%]", "force [N]")

    return png_of(Drawing("force-surface", title, draw, 3.4, 3.4))


# ---- the second paper ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Panel:
    """A variable (samples,) in the unit that its label ends with."""

    label: str
    measured: Array
    data_sheet: Array
    fitted: Array


def arm_picture(name: str, title: str, time_s: Array, panels: Sequence[Panel]) -> Picture:
    """A panel per variable, two in a row; the simulated lines lie over the measured line."""

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(-(-len(panels) // 2), 2, sharex=True, squeeze=False)
        for axis, panel in zip(axes.flat, panels, strict=True):
            rough = np.std(np.diff(panel.measured)) > ROUGH_LINE * np.ptp(panel.measured)
            _measured(axis, time_s, panel, THIN_LINE if rough else 2.6)
            line(axis, time_s, panel.data_sheet, "ink", 0.8, "--", label="data sheet")
            line(axis, time_s, panel.fitted, "with_cause", 1.0, label="fitted, ANFIS law")
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        handles = axes[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower left", ncols=1 if narrow else 3)

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
    """A panel per joint that is swung by pulses on the other."""
    name = "fitted, coupling terms left out"

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(swings), 1, squeeze=False)[:, 0]
        for axis, swing in zip(axes, swings, strict=True):
            _measured(axis, swing.time_s, swing, 2.6)
            line(axis, swing.time_s, swing.without_coupling, "ink", 0.9, "--", label=name)
            line(axis, swing.time_s, swing.fitted, "with_cause", 1.1, label="fitted")
        finish(axes[0], legend=1 if narrow else 3)
        axes[-1].set_xlabel("time [s]")

    return render(Drawing("coupling", title, draw, 4.4, 4.6))


def _measured(axes: Axes, time_s: Array, shown: Panel | JointSwing, width: float) -> None:
    line(axes, time_s, shown.measured, "noise_floor", width, label="measured")
    finish(axes, "", shown.label)
