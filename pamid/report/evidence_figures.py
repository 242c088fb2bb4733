"""The pictures behind the answers: error over time, parameter strain, background pulls, network
training."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from pamid.report import formatting
from pamid.report.captions import pulls_title, timeline_title, training_title
from pamid.report.load import Residual, RunData
from pamid.report.reading import FloatArray
from pamid.report.style import Drawing, bare, colour, grid, label, legend_above
from pamid.schemas.diagnosis_file import DiagnosisFile
from pamid.schemas.network_file import NetworkFile

_BINS = 160
_PANELS = {"mse": ("MSE [-]", True), "gamma": ("gamma [-]", False), "mu": ("mu [-]", True)}


def pulls_drawing(pulls: dict[str, float]) -> Drawing | None:
    """Bars: each background correction over its tolerance [-]; beyond 2 the map itself is wrong."""
    if not pulls:
        return None
    shown = sorted(pulls.items(), key=lambda item: -abs(item[1]))[:16]
    reach = max(2.6, *(1.25 * abs(pull) for _, pull in shown))

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.axvspan(-1.0, 1.0, color=colour("faint"), linewidth=0.0)
        for row, (_, pull) in enumerate(shown):
            large = abs(pull) > 2.0
            axes.barh(
                row,
                pull,
                height=0.6,
                color=colour("with_cause" if large else "refitted"),
                linewidth=0.0,
            )
            axes.annotate(
                formatting.short(pull, 2),
                (pull, row),
                xytext=(4 if pull >= 0 else -4, 0),
                textcoords="offset points",
                va="center",
                ha="left" if pull >= 0 else "right",
                fontsize=8.5,
                color=colour("ink"),
            )
        for edge in (-2.0, 0.0, 2.0):
            axes.axvline(
                edge,
                color=colour("muted"),
                linewidth=0.7,
                linestyle="-" if edge == 0 else (0, (3, 2)),
            )
        axes.set_yticks(
            range(len(shown)), [label(formatting.port_label(name), 24) for name, _ in shown]
        )
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_xlim(-reach, reach)
        axes.xaxis.set_major_locator(MaxNLocator(7 if narrow else 9, integer=True))
        axes.set_xlabel("fitted correction / its tolerance [-]")
        bare(axes)

    height = 0.62 + 0.27 * len(shown)
    return Drawing("background", pulls_title(pulls), draw, height, height)


def training_drawing(trace: dict[str, FloatArray], network: NetworkFile | None) -> Drawing | None:
    """MSE of the scaled output, effective number of parameters and damping over the iteration."""
    panels = [name for name in _PANELS if name in trace and np.isfinite(trace[name]).any()]
    if not panels:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        stack = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name in zip(stack, panels, strict=True):
            axis_text, logarithmic = _PANELS[name]
            axes.plot(trace["iteration"], trace[name], color=colour("with_network"), linewidth=1.5)
            if logarithmic and (trace[name] > 0).all():
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
            axes.set_ylabel(axis_text)
            axes.margins(x=0.01)
            axes.minorticks_off()
            grid(axes, "y")
        stack[-1].set_xlabel("iteration [-]")
        stack[-1].xaxis.set_major_locator(MaxNLocator(6, integer=True))
        figure.align_ylabels(list(stack))

    height = 0.45 + 1.15 * len(panels)
    return Drawing("training", training_title(trace, network), draw, height, height)


def power_of_ten(value: float, _: int | None = None) -> str:
    """The label of a tick on a logarithmic axis: 100 -> 10²."""
    return f"10{formatting.superscript(round(math.log10(value)))}"


def timeline_drawing(run: RunData, channel: str) -> Drawing | None:
    """Mean absolute error over short stretches of each recording [channel's unit] over time [s],
    windows shaded."""
    residual = run.residual
    if (
        residual is None
        or residual.of(channel, "refitted") is None
        or channel not in residual.columns
    ):
        return None
    number, curves = _longest_held_out(residual, channel)
    if not curves:
        return None
    diagnosis = run.diagnosis
    shaded = (
        diagnosis.where.windows_s if diagnosis is not None and diagnosis.where is not None else ()
    )

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for count, (low, high) in enumerate(shaded):
            axes.axvspan(
                low,
                high,
                color=colour("line"),
                linewidth=0.0,
                label="" if count else "named windows",
            )
        for kind, (time, error) in curves.items():
            role = {"cause": "with_cause"}.get(kind, kind)
            name = {"refitted": "refitted", "cause": "with cause"}[kind]
            axes.plot(time, error, color=colour(role), linewidth=1.4, label=name)
        first, last = curves["refitted"][0][[0, -1]]
        if last > first:
            axes.set_xlim(first, last)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(
            formatting.axis_label("mean |error|", label(formatting.channel_unit(channel)))
        )
        axes.set_xlabel("time [s]")
        grid(axes, "y")
        legend_above(axes, 2 if narrow else 3)

    title = timeline_title(channel, run, number, curves)
    return Drawing("timeline", title, draw, 2.3, 2.6)


def _longest_held_out(
    residual: Residual, channel: str
) -> tuple[int, dict[str, tuple[FloatArray, FloatArray]]]:
    """The recording with most scored held-out rows (else scored rows), and its binned errors by
    model."""
    columns, refitted = residual.columns, residual.of(channel, "refitted")
    assert refitted is not None
    scored = (columns["window"] >= 0) & np.isfinite(refitted)
    if (scored & (columns["part"] == 1)).any():
        scored &= columns["part"] == 1
    if not scored.any():
        return 0, {}
    numbers, counts = np.unique(columns["recording"][scored], return_counts=True)
    number = int(numbers[np.argmax(counts)])
    rows = np.flatnonzero(scored & (columns["recording"] == number))
    curves = {}
    for kind in ("refitted", "cause"):
        trace = residual.of(channel, kind)
        if trace is not None and np.isfinite(trace[rows]).all():
            error = np.abs(columns[channel] - trace)
            parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            curves[kind] = _curve(
                columns["time_s"], error, [rows] if len(parts) > _BINS // 4 else parts
            )
    return number, curves


def _curve(
    time: FloatArray, error: FloatArray, parts: list[NDArray[np.intp]]
) -> tuple[FloatArray, FloatArray]:
    """Binned errors; between parts that are apart in time the line is broken by a nan."""
    bins = max(_BINS // len(parts), 1)
    pieces = [_binned(time[rows], error[rows], bins) for rows in parts]
    gap = np.array([np.nan])
    times = [piece for moments, _ in pieces for piece in (moments, moments[-1:])]
    errors = [piece for _, values in pieces for piece in (values, gap)]
    return np.concatenate(times[:-1]), np.concatenate(errors[:-1])


def _binned(time: FloatArray, error: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Means of at most `most` stretches of equal count."""
    bins = min(most, time.size)
    edges = np.linspace(0, time.size, bins + 1).astype(int)
    sizes = np.diff(edges)
    return np.add.reduceat(time, edges[:-1]) / sizes, np.add.reduceat(error, edges[:-1]) / sizes


def pulls_of(run: RunData) -> dict[str, float]:
    """The background corrections of the diagnosis, else those of the fit."""
    diagnosis: DiagnosisFile | None = run.diagnosis
    if diagnosis is not None and diagnosis.background:
        return {name: term.pull for name, term in diagnosis.background.items()}
    return {k: term.pull for k, term in run.fit.background.items()} if run.fit is not None else {}
