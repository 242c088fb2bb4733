"""The pictures behind the answers: error over time and over a signal, background pulls,
correlations of the parameters, network training."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import adjusted_share, independent_samples
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.fit_file import FitFile, Posterior
from pamid.base.schemas.network_file import NetworkFile
from pamid.base.units import quotient, split_column
from pamid.report import formatting
from pamid.report.captions import causes_label
from pamid.report.figures import MODEL_LINES, binned
from pamid.report.formatting import capital, channel_label, channel_unit, percent, port_label
from pamid.report.highlights import signal_along
from pamid.report.load import Residual, RunData
from pamid.report.samples import channels_of, inputs_of, stretches_of
from pamid.report.style import (
    Drawing,
    Look,
    annotate,
    axis,
    bar,
    channel_axis,
    colour,
    dots,
    finish,
    label,
    level,
    line,
    name_rows,
    write,
)

LEAST_SIGNAL_SHARE = 0.1  # share of an error that a signal explains, to be named
_BINS = 160
_MOST_PULLS = 16
_PANELS = {"mse": ("MSE [-]", True), "gamma": ("gamma [-]", False), "mu": ("mu [-]", True)}
_SIGNAL_DOTS = 300
_ERROR_KINDS = {"refitted": "refitted", "cause": "with cause"}
_MOST, _FEWEST, _WRITTEN, _STRONG = 14, 3, 0.3, 0.9  # correlations
_BACKGROUND = "background."


# ---- the error over time -------------------------------------------------------------------------


def timeline_drawing(run: RunData, channel: str) -> Drawing | None:
    """Mean absolute error [channel's unit] along each recording [s], windows shaded."""
    number, curves = (0, {}) if run.residual is None else _longest_held_out(run.residual, channel)
    if not curves:
        return None
    where = run.diagnosis.where if run.diagnosis is not None else None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for count, (low, high) in enumerate(where.windows_s if where is not None else ()):
            name = "" if count else "named windows"
            axes.axvspan(low, high, color=colour("line"), linewidth=0.0, label=name)
        for kind, (time, error) in curves.items():
            line(axes, time, error, MODEL_LINES[kind][0], 1.4, label=_ERROR_KINDS[kind])
        first, last = curves["refitted"][0][[0, -1]]
        if last > first:
            axes.set_xlim(first, last)
        axes.set_ylim(bottom=0.0)
        unit_text = channel_unit(channel)
        finish(axes, "time [s]", axis("mean |error|", unit_text), legend=2 if narrow else 3)

    error = curves["refitted"][1]
    order = np.sort(error[np.isfinite(error)])[::-1]
    half = int(np.searchsorted(np.cumsum(order), 0.5 * order.sum())) + 1
    what = formatting.clean(f"{channel_label(channel)} error{run.recording_words(number)}")
    title = f"No refitted {what} is known in the time shown"
    if order.size:
        share = percent(half / order.size)
        title = f"Half of the refitted {what} lies in {share} of the time shown"
    return Drawing("timeline", title, draw, 2.3, 2.6)


def _longest_held_out(
    residual: Residual, channel: str
) -> tuple[int, dict[str, tuple[Array, Array]]]:
    """The recording with most held-out (else scored) rows, and its binned errors by model."""
    columns = residual.columns
    scored = scored_rows(residual, channel)
    if not scored.any():
        return 0, {}
    numbers, counts = np.unique(columns["recording"][scored], return_counts=True)
    number = int(numbers[np.argmax(counts)])
    rows = np.flatnonzero(scored & (columns["recording"] == number))
    curves = {}
    for kind in _ERROR_KINDS:
        trace = residual.of(channel, kind)
        if trace is not None and np.isfinite(trace[rows]).all():
            error = np.abs(columns[channel] - trace)
            parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            parts = [rows] if len(parts) > _BINS // 4 else parts
            curves[kind] = _curve(columns["time_s"], error, parts)
    return number, curves


def _curve(time: Array, error: Array, parts: list[NDArray[np.intp]]) -> tuple[Array, Array]:
    """Means of stretches of equal count; a nan breaks the line between distant parts."""
    times, errors, most = [], [], max(_BINS // len(parts), 1)
    for rows in parts:
        edges = np.linspace(0, rows.size, min(most, rows.size) + 1).astype(int)
        starts, sizes = edges[:-1], np.diff(edges)
        times.append(np.add.reduceat(time[rows], starts) / sizes)
        errors += [np.add.reduceat(error[rows], starts) / sizes, np.array([np.nan])]
        times.append(times[-1][-1:])
    return np.concatenate(times[:-1]), np.concatenate(errors[:-1])


def scored_rows(residual: Residual, channel: str) -> NDArray[np.bool_]:
    """Scored rows of a channel; only held-out ones, if there are any."""
    columns, refitted = residual.columns, residual.of(channel, "refitted")
    if refitted is None or channel not in columns:
        return np.zeros(columns["window"].size, bool)
    scored = (columns["window"] >= 0) & np.isfinite(columns[channel] - refitted)
    held_out = scored & (columns["part"] == 1)
    return held_out if held_out.any() else scored


# ---- the error over a signal ---------------------------------------------------------------------


@dataclass(frozen=True)
class ErrorOverSignal:
    """Scored samples: a signal (n,) in its unit, errors by model (measured less modelled) in the
    channel's unit, and the share of the variance of the refitted error between parts of the signal,
    beyond chance. A signal and an error that both drift agree by chance."""

    signal: str
    unit: str
    values: Array
    errors: dict[str, Array]
    share: float

    @property
    def removed(self) -> float | None:
        """Share of that part that the cause takes away."""
        if "cause" not in self.errors or not self.share > 0.0:
            return None
        before, left = (
            binned(self.values, error)[2] * float(error.var())
            for error in (self.errors["refitted"], self.errors["cause"])
        )
        return 1.0 - left / before


def error_over_signal(residual: Residual, channel: str) -> ErrorOverSignal | None:
    """The error of a channel over the measured or sent signal, or the rate of a measured signal,
    that explains most of its variance; None if no sample is scored."""
    scored = scored_rows(residual, channel)
    if scored.sum() < 2:
        return None
    errors = {
        kind: (residual.columns[channel] - trace)[scored]
        for kind in _ERROR_KINDS
        if (trace := residual.of(channel, kind)) is not None and np.isfinite(trace[scored]).all()
    }
    best: ErrorOverSignal | None = None
    for name, unit in _signals(residual).items():
        along = np.full(scored.size, np.nan)  # a rate is taken along each whole recording
        for stretch in stretches_of(residual, along.size):
            signal = signal_along(residual, name, stretch.rows)
            if signal is not None:
                along[stretch.rows] = signal
        values = along[scored]
        if not np.isfinite(values).all():
            continue
        centres, _, raw = binned(values, errors["refitted"])
        samples = independent_samples(values, errors["refitted"])
        share = adjusted_share(raw, centres.size, samples)
        if best is None or share > best.share:
            best = ErrorOverSignal(name, unit, values, errors, share)
    return best


def _signals(residual: Residual) -> dict[str, str]:
    """Names of signals, with their units."""
    measured = channels_of(residual)
    units = dict(split_column(column) for column in (*measured, *inputs_of(residual)))
    for column in measured:
        stem, unit = split_column(column)
        name = "velocity" if stem in ("angle", "position") else f"{stem}_rate"
        units.setdefault(name, quotient(unit, "s"))
    return units


def error_signal_drawing(run: RunData, channel: str) -> Drawing | None:
    """Points and medians: the error over the signal that explains most of it."""
    curve = error_over_signal(run.residual, channel) if run.residual is not None else None
    if curve is None:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        every = -(-curve.values.size // _SIGNAL_DOTS)
        x, y = curve.values[::every], curve.errors["refitted"][::every]
        wide = float(np.ptp(x)) or 1.0
        axes.set_xlim(float(x.min()) - 0.03 * wide, float(x.max()) + 0.03 * wide)
        tall = 1.08 * (float(np.abs(y).max()) or 1.0)
        axes.set_ylim(-tall, tall)
        axes.add_patch(dots(x, y, 6e-4 * wide))
        level(axes)
        for kind, error in curve.errors.items():
            centres, middles, _ = binned(curve.values, error)
            look = {"marker": "o", "markersize": 4.0, "label": f"median, {_ERROR_KINDS[kind]}"}
            line(axes, centres, middles, MODEL_LINES[kind][0], 1.8, **look)
        across = axis(port_label(curve.signal), formatting.unit_label(curve.unit))
        up = channel_axis(channel, " error", 22)
        finish(axes, across, up, legend=2, ticks=5 if narrow else 9)

    return Drawing("error-signal", _signal_title(curve, channel, run.diagnosis), draw, 2.8, 2.8)


def _signal_title(curve: ErrorOverSignal, channel: str, diagnosis: DiagnosisFile | None) -> str:
    """ "Velocity alone accounts for 62 % of the variance of the refitted angle error; Coulomb
    friction removes 97 % of that part"."""
    what = f"the variance of the refitted {channel_label(channel)} error"
    share, removed = percent(curve.share), curve.removed
    if curve.share <= 0.0:
        return f"No recorded signal alone accounts for more of {what} than chance does"
    if curve.share < LEAST_SIGNAL_SHARE:
        return f"No recorded signal alone accounts for more than {share} of {what}"
    text = capital(f"{port_label(curve.signal)} alone accounts for {share} of {what}")
    if removed is not None and removed > 0.0 and diagnosis is not None and diagnosis.causes:
        verb = "removes" if len(diagnosis.causes) == 1 else "remove"
        text += f"; {causes_label(diagnosis)} {verb} {percent(removed)} of that part"
    return text


# ---- parameters ----------------------------------------------------------------------------------


def pulls_drawing(run: RunData) -> Drawing | None:
    """Bars: each background correction of the diagnosis, else of the fit, over its tolerance [-];
    beyond 2 the map itself is wrong."""
    source = run.diagnosis if run.diagnosis is not None and run.diagnosis.background else run.fit
    pulls = {name: term.pull for name, term in source.background.items()} if source else {}
    if not pulls:
        return None
    shown = sorted(pulls.items(), key=lambda item: -abs(item[1]))[:_MOST_PULLS]
    reach = max(2.6, *(1.25 * abs(pull) for _, pull in shown))

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.axvspan(-1.0, 1.0, color=colour("faint"), linewidth=0.0)
        for row, (_, pull) in enumerate(shown):
            bar(axes, row, pull, "with_cause" if abs(pull) > 2.0 else "refitted")
            value, shift = formatting.short(pull, 2), 4 if pull >= 0 else -4
            annotate(axes, value, (pull, row), (shift, 0), ha="left" if pull >= 0 else "right")
        for edge in (-2.0, 0.0, 2.0):
            dashes = "-" if edge == 0 else (0, (3, 2))
            axes.axvline(edge, color=colour("muted"), linewidth=0.7, linestyle=dashes)
        name_rows(axes, [port_label(name) for name, _ in shown], 24)
        axes.set_xlim(-reach, reach)
        axes.xaxis.set_major_locator(MaxNLocator(7 if narrow else 9, integer=True))
        finish(axes, "fitted correction / its tolerance [-]", lines="")

    worst = f"{port_label(shown[0][0])} with {formatting.short(shown[0][1], 2)}"
    title = f"The tolerance terms stay within twice their limits; the largest is {worst}"
    beyond = sum(abs(pull) > 2.0 for pull in pulls.values())
    if beyond:
        many = "term lies" if beyond == 1 else "terms lie"
        title = f"{beyond} tolerance {many} beyond twice the limit, the farthest {worst}"
    height = 0.62 + 0.27 * len(shown)
    return Drawing("background", title, draw, height, height)


def correlation_drawing(fit: FitFile | None) -> Drawing | None:
    """Cells: the correlation of two fitted parameters [-], written where it is 0.3 or more; None
    where fewer than three were fitted, or none is as large. Background terms are left out, and of
    many parameters those stay that are correlated most."""
    posterior = fit.posterior if fit is not None else None
    if posterior is None:
        return None
    names, correlations = _correlations(posterior)
    if len(names) < _FEWEST or np.abs(np.tril(correlations, -1)).max() < _WRITTEN:
        return None  # the sentence is enough
    count = len(names)

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row in range(1, count):
            for column in range(row):
                value = float(correlations[row, column])
                look: Look = {
                    "facecolor": colour("with_cause" if value > 0.0 else "refitted"),
                    "alpha": 0.75 * abs(value),
                    "linewidth": 0.0,
                }
                axes.add_patch(Rectangle((column - 0.47, row - 0.47), 0.94, 0.94, **look))
                if abs(value) >= _WRITTEN:
                    size = 6.0 if narrow or count > 9 else 8.0
                    write(axes, column, row, _two_digits(value), size=size, ha="center")
        shown = [label(port_label(name), 22) for name in names]
        axes.set_yticks(range(1, count), shown[1:])
        turned: Look = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
        axes.set_xticks(range(count - 1), shown[:-1], **turned)
        axes.set_xlim(-0.5, count - 1.5)
        axes.set_ylim(count - 0.5, 0.5)
        axes.tick_params(length=0, labelsize=7.5 if narrow else 8.5)
        for side in ("left", "bottom"):
            axes.spines[side].set_visible(False)

    tall = 1.2 + 0.3 * count
    return Drawing("correlation", _correlation_title(names, correlations), draw, tall, tall + 0.3)


def correlation_note(fit: FitFile | None) -> str:
    """Sentence in place of a picture that would be a single cell, or empty cells."""
    if fit is None or fit.posterior is None or correlation_drawing(fit) is not None:
        return ""
    names, correlations = _correlations(fit.posterior)
    return f"{_correlation_title(names, correlations)}." if len(names) > 1 else ""


def _correlation_title(names: list[str], correlations: Array) -> str:
    apart = np.abs(np.tril(correlations, -1))
    row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
    value = _two_digits(correlations[row, column])
    pair = f"{port_label(names[row])} and {port_label(names[column])}"
    if apart.max() >= _STRONG:
        return f"{pair} are hard to tell apart: correlation {value}"
    return f"No two parameters are tied: the largest correlation is {value}, of {pair}"


def _two_digits(value: float) -> str:
    return f"{value:.2f}".replace("-", formatting.MINUS)


def _correlations(posterior: Posterior) -> tuple[list[str], Array]:
    """Names and correlations (n, n) of the rig's parameters; empty if both do not fit."""
    size = len(posterior.keys)
    if [len(row) for row in posterior.covariance] != list(range(1, size + 1)):
        return [], np.zeros((0, 0))
    lower = np.zeros((size, size))
    for k, row in enumerate(posterior.covariance):
        lower[k, : k + 1] = row
    spread = np.sqrt(np.maximum(np.diag(lower), 0.0))
    indices = [
        k
        for k, name in enumerate(posterior.keys)
        if not name.startswith(_BACKGROUND) and spread[k] > 0.0
    ]
    if len(indices) < 2:
        return [], np.zeros((0, 0))
    whole, scale = lower + np.tril(lower, -1).T, np.where(spread > 0.0, spread, 1.0)
    correlations = np.clip(((whole / scale).T / scale)[np.ix_(indices, indices)], -1.0, 1.0)
    strength = np.sort(np.abs(correlations - np.eye(len(indices))), axis=1)[:, -1]
    strongest = sorted(np.argsort(-strength, kind="stable")[:_MOST].tolist())
    names = [posterior.keys[indices[k]] for k in strongest]
    return names, correlations[np.ix_(strongest, strongest)]


# ---- training ------------------------------------------------------------------------------------


def training_drawing(trace: dict[str, Array], network: NetworkFile | None) -> Drawing | None:
    """MSE of the scaled output, effective number of parameters and damping over the iteration."""
    panels = [name for name in _PANELS if name in trace and np.isfinite(trace[name]).any()]
    if not panels:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        stack = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name in zip(stack, panels, strict=True):
            axis_text, logarithmic = _PANELS[name]
            line(axes, trace["iteration"], trace[name], "with_network")
            if logarithmic and (trace[name] > 0).all():
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
            axes.margins(x=0.01)
            axes.minorticks_off()
            finish(axes, "", axis_text)
        stack[-1].set_xlabel("iteration [-]")
        stack[-1].xaxis.set_major_locator(MaxNLocator(6, integer=True))
        figure.align_ylabels(list(stack))

    title = (
        f"Training ends at iteration {formatting.count(float(trace['iteration'][-1]))} with an MSE "
        f"of {formatting.short(float(trace['mse'][-1]))}"
    )
    gamma = trace.get("gamma")
    if gamma is not None and np.isfinite(gamma[-1]):
        weights = network.n_weights if network is not None else None
        of = f" of {formatting.count(weights)}" if weights is not None else ""
        title += f", using {formatting.short(float(gamma[-1]))}{of} parameters"
    return Drawing("training", title, draw, 0.45 + 1.15 * len(panels), 0.45 + 1.15 * len(panels))


def power_of_ten(value: float, _: int | None = None) -> str:
    """The label of a tick on a logarithmic axis: 100 -> 10²."""
    return f"10{formatting.superscript(round(math.log10(value)))}"
