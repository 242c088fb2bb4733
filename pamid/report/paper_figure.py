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
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from pamid.base.arrays import Array
from pamid.report.evidence_figures import power_of_ten
from pamid.report.style import (
    Drawing,
    annotate,
    colour,
    finish,
    label,
    level,
    line,
    png_of,
)

# noise over range from which a measured line is drawn thin, and how thin
ROUGH_LINE, THIN_LINE = 0.05, 0.5
_PANELS = {
    "mse": "MSE of scaled signals",
    "gradient": "norm of the gradient",
    "mu": "damping mu",
    "gamma": "effective weights gamma",
}


@dataclass(frozen=True, eq=False)
class Panel:
    """A panel of lines (samples,) over time_s (samples,), by legend entry; its label ends with
    their unit."""

    label: str
    time_s: Array
    lines: Mapping[str, Array]


def _stacked(
    name: str,
    title: str,
    panels: Sequence[Panel],
    looks: Sequence[Sequence[Any]],
    height: float,
    *,
    shared: bool = True,
    zero: bool = False,
) -> bytes:
    """PNG of panels below each other. looks: role, width and dashes of the lines, in their order;
    shared: the panels have the same scales; zero: with a line at 0."""

    def draw(figure: Figure, _: bool) -> None:
        axes = figure.subplots(len(panels), 1, sharex=shared, sharey=shared, squeeze=False)[:, 0]
        for axis, panel in zip(axes, panels, strict=True):
            for look, (word, values) in zip(looks, panel.lines.items(), strict=False):
                line(axis, panel.time_s, values, *look, label=word)
            if zero:
                level(axis, 0.0, "ink")
            finish(axis, "", panel.label)
        finish(axes[0], legend=len(looks))
        axes[-1].set_xlabel("time [s]")

    return png_of(Drawing(name, title, draw, height, height))


# ---- the first paper -----------------------------------------------------------------------------


def steps_picture(
    time_s: Array, errors: Mapping[str, Mapping[str, Array]], notes: Sequence[str]
) -> bytes:
    """errors: model - measured (samples,), deg, by case and then by model (at most three); notes: a
    remark per case.

    The title states the mean absolute errors of the first and the last model in the last case.
    """
    case, last = list(errors.items())[-1]
    sizes = [f"the {m} is off by {np.abs(error).mean():.2f} deg" for m, error in last.items()]
    title = f"At {case}, {sizes[0]}, {sizes[-1].replace(' is off', '')}"
    panels = [
        Panel(f"{name} ({note})\nerror [deg]", time_s, models)
        for (name, models), note in zip(errors.items(), notes, strict=True)
    ]
    looks = [(role, 1.1) for role in ("data_sheet", "with_network", "with_cause")]
    return _stacked("steps", title, panels, looks, 4.2, zero=True)


def responses_picture(responses: Sequence[Panel], title: str) -> bytes:
    """Figures 5, 6 and 9 of the paper: the joint on the steps at each inertia, by legend entry the
    angle of the reference, the measurement and the models."""
    looks = (
        ("muted", 0.8),
        ("noise_floor", 2.8),
        ("ink", 1.2, "--"),
        ("with_network", 1.0),
    )
    return _stacked("responses", title, responses, looks, 5.4)


def pressures_picture(
    time_s: Array, cases: Mapping[str, Mapping[str, tuple[Array, Array]]], title: str
) -> bytes:
    """PNG of both pressures on the steps. cases: by inertia and muscle, measured and of the model
    (samples,), kPa."""

    def draw(figure: Figure, _: bool) -> None:
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

    def draw(figure: Figure, _: bool) -> None:
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

    def draw(figure: Figure, _: bool) -> None:
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

    def draw(figure: Figure, _: bool) -> None:
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


def arm_picture(name: str, title: str, panels: Sequence[Panel]) -> bytes:
    """A panel per variable, two in a row; over the measured line lie those of the data sheet and
    the fitted model."""

    def draw(figure: Figure, _: bool) -> None:
        axes = figure.subplots(-(-len(panels) // 2), 2, sharex=True, squeeze=False)
        for axis, panel in zip(axes.flat, panels, strict=True):
            measured = next(iter(panel.lines.values()))
            rough = np.std(np.diff(measured)) > ROUGH_LINE * np.ptp(measured)
            looks: tuple[tuple[Any, ...], ...] = (
                ("noise_floor", THIN_LINE if rough else 2.6),
                ("ink", 0.8, "--"),
                ("with_cause", 1.0),
            )
            for look, (word, values) in zip(looks, panel.lines.items(), strict=True):
                line(axis, panel.time_s, values, *look, label=word)
            finish(axis, "", panel.label)
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        handles = axes[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower left", ncols=len(looks))

    return png_of(Drawing(name, title, draw, 8.4, 8.4))


def coupling_picture(title: str, swings: Sequence[Panel]) -> bytes:
    """A panel per joint that is swung by pulses on the other, its valves shut: the angle measured,
    fitted without the coupling terms, and fitted."""
    looks = (("noise_floor", 2.6), ("ink", 0.9, "--"), ("with_cause", 1.1))
    return _stacked("coupling", title, swings, looks, 4.4, shared=False)
