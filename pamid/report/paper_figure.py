"""Pictures of the first paper: angle errors of every model on the steps, at both inertias, and the
figures of the paper: responses, pressures, training, excitation, force surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from pamid.report.evidence_figures import power_of_ten
from pamid.report.style import (
    Drawing,
    Picture,
    colour,
    grid,
    label,
    legend_above,
    png_of,
    render,
)

Array = NDArray[np.float64]

#: colours of the models in the order they are drawn
LINE_ROLES = ("data_sheet", "with_network", "with_cause")


def steps_picture(
    time_s: Array, errors: Mapping[str, Mapping[str, Array]], notes: Sequence[str]
) -> Picture:
    """errors: model - measured (samples,), deg, by case and then by model (at most three); notes: a
    remark per case.

    The title states the mean absolute errors of the first and the last model in the last case.
    """
    case, last = list(errors.items())[-1]
    sizes = {model: float(np.abs(values).mean()) for model, values in last.items()}
    first, final = list(sizes)[0], list(sizes)[-1]
    title = (
        f"At {case}, the {first} is off by {sizes[first]:.2f} deg, the {final} by "
        f"{sizes[final]:.2f} deg"
    )

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(errors), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axis, (name, models), note in zip(axes, errors.items(), notes, strict=True):
            for role, (model, values) in zip(LINE_ROLES, models.items(), strict=False):
                axis.plot(time_s, values, color=colour(role), linewidth=1.1, label=model)
            axis.axhline(0.0, color=colour("ink"), linewidth=0.7)
            grid(axis, "y")
            axis.set_ylabel(f"{name}\nerror [deg]" if narrow else f"{name} ({note})\nerror [deg]")
        legend_above(axes[0], 1 if narrow else 3)
        axes[-1].set_xlabel("time [s]")

    return render(Drawing("steps", title, draw, 4.2, 4.2))


@dataclass(frozen=True, eq=False)
class StepResponse:
    """The joint on the steps at one inertia: name of the case, and by legend entry the angle
    (samples,), deg, of the reference, the measurement and the models."""

    case: str
    reference: Array
    measured: Array
    models: Mapping[str, Array]


def responses_picture(time_s: Array, responses: Sequence[StepResponse], title: str) -> bytes:
    """Figures 5, 6 and 9 of the paper: PNG of the angle over the reference, a panel per inertia."""
    styles = (("data_sheet", "--", 1.2), ("with_network", "-", 1.0))

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(responses), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axis, case in zip(axes, responses, strict=True):
            axis.plot(
                time_s, case.reference, color=colour("muted"), linewidth=0.8, label="reference"
            )
            axis.plot(
                time_s, case.measured, color=colour("noise_floor"), linewidth=2.8, label="measured"
            )
            for (role, style, width), (word, angle) in zip(
                styles, case.models.items(), strict=False
            ):
                shown = "ink" if role == "data_sheet" else role
                axis.plot(time_s, angle, style, color=colour(shown), linewidth=width, label=word)
            grid(axis, "y")
            axis.set_ylabel(f"{case.case}\nangle [deg]")
        legend_above(axes[0], 4)
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
                axis.plot(
                    time_s, measured, color=colour("noise_floor"), linewidth=2.4, label="measured"
                )
                axis.plot(
                    time_s, model, "--", color=colour("ink"), linewidth=0.9, label="analytic model"
                )
                grid(axis, "y")
                axis.set_title(label(f"{case}, {muscle}"), loc="right", color=colour("muted"))
            column[-1].set_xlabel("time [s]")
        for axis in axes[:, 0]:
            axis.set_ylabel("gauge pressure [kPa]")
        legend_above(axes[0, 0], 2)

    return png_of(Drawing("pressures", title, draw, 4.8, 4.8))


def training_picture(
    trace: Mapping[str, Array], published: Mapping[str, float], weights: int, title: str
) -> bytes:
    """Figure 8 and table I of the paper: PNG of MSE, gradient, mu and gamma over the iterations;
    published: end of the paper's training, by name of the trace."""
    panels = {
        "mse": "MSE of scaled signals",
        "gradient": "norm of the gradient",
        "mu": "damping mu",
        "gamma": "effective weights gamma",
    }

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(2, 2, sharex=True)
        for axis, (name, word) in zip(axes.flat, panels.items(), strict=True):
            axis.plot(trace["iteration"], trace[name], color=colour("with_network"), linewidth=1.2)
            if name == "gamma":
                axis.axhline(weights, color=colour("ink"), linewidth=0.8)
                axis.annotate(
                    f"all {weights} weights",
                    (1.0, weights),
                    xycoords=("axes fraction", "data"),
                    xytext=(-2, -3),
                    textcoords="offset points",
                    ha="right",
                    va="top",
                    fontsize=8.0,
                )
            else:
                axis.set_yscale("log")
                axis.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
                axis.minorticks_off()
            axis.axhline(published[name], color=colour("with_cause"), linewidth=0.9, linestyle="--")
            axis.annotate(
                f"the paper's end: {published[name]:.3g}",
                (1.0, published[name]),
                xycoords=("axes fraction", "data"),
                xytext=(-2, 3),
                textcoords="offset points",
                ha="right",
                va="bottom",
                color=colour("with_cause"),
                fontsize=8.0,
            )
            grid(axis, "y")
            axis.set_ylabel(word)
        for axis in axes[-1]:
            axis.set_xlabel("iteration")

    return png_of(Drawing("network-training", title, draw, 4.8, 4.8))


def excitation_picture(
    time_s: Array, reference: Array, error: Array, closer_s: tuple[float, float], title: str
) -> bytes:
    """Figure 7 of the paper: PNG of the reference and of the error that the network learns
    (samples,), each scaled into [-1, 1]; below, a stretch of them."""

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(2, 1, sharey=True)
        near = (time_s >= closer_s[0]) & (time_s < closer_s[1])
        for panel, rows, width in ((axes[0], slice(None), 0.6), (axes[1], near, 1.1)):
            for values, role, word in (
                (reference, "data_sheet", "reference"),
                (error, "with_cause", "error signal: measured - analytic model"),
            ):
                panel.plot(
                    time_s[rows], values[rows], color=colour(role), linewidth=width, label=word
                )
            grid(panel, "y")
            panel.set_ylabel("scaled [-]")
            panel.margins(x=0.01)
        legend_above(axes[0], 2)
        axes[-1].set_xlabel("time [s]")

    return png_of(Drawing("excitation", title, draw, 4.6, 4.6))


def force_surface_picture(
    contraction: Array, pressure_kpa: Array, force_n: Array, other_n: Array, title: str
) -> bytes:
    """Figure 2 of the paper: PNG of a force law over contraction and pressure, force_n
    (contractions, pressures), N, below zero for a slack muscle, and its curves over those of
    another law, other_n."""
    colours = colormaps["viridis_r"].resampled(256)

    def draw(figure: Figure, narrow: bool) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        levels = np.arange(0.0, force_n.max() + 100.0, 100.0)
        filled = left.contourf(
            100.0 * contraction, pressure_kpa, force_n.T, levels=levels, cmap=colours
        )
        left.text(0.95, 0.06, "slack", transform=left.transAxes, ha="right", fontsize=8.5)
        left.set_xlabel("contraction [%]")
        left.set_ylabel("gauge pressure [kPa]")
        bar = figure.colorbar(filled, ax=left, pad=0.02)
        bar.set_label("force [N]")
        bar.outline.set_visible(False)  # type: ignore[operator]
        shown = np.linspace(0, len(pressure_kpa) - 1, 7).round().astype(int)[1:]
        for k in shown:
            for law, role, style, width in (
                (force_n, "refitted", "-", 1.2),
                (other_n, "ink", "--", 0.8),
            ):
                pull = np.maximum(law[:, k], 0.0)
                right.plot(100.0 * contraction, pull, style, color=colour(role), linewidth=width)
            right.annotate(
                f"{pressure_kpa[k]:.0f} kPa",
                (0.0, force_n[0, k]),
                xytext=(-4, 0),
                textcoords="offset points",
                ha="right",
                va="center",
                fontsize=7.5,
                color=colour("muted"),
            )
        right.lines[0].set_label("polynomial of fifth order")
        right.lines[1].set_label("exponential law")
        right.legend(loc="upper right")
        right.set_xlim(-8.0, 26.0)
        right.set_ylim(top=1.2 * force_n.max())
        right.set_xticks(range(0, 26, 5))
        right.set_xlabel("contraction [%]")
        right.set_ylabel("force [N]")
        grid(right, "y")

    return png_of(Drawing("force-surface", title, draw, 3.4, 3.4))
