"""The error of the refitted model over the recorded signal that explains most of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pamid.base.metrics import adjusted_share, independent_samples
from pamid.base.units import quotient, split_column
from pamid.report import formatting
from pamid.report.captions import error_signal_title
from pamid.report.figures import MODEL_LINES, binned
from pamid.report.highlights import signal_along
from pamid.report.load import Residual, RunData
from pamid.report.reading import FloatArray
from pamid.report.samples import channels_of, inputs_of, stretches_of
from pamid.report.style import Drawing, colour, dots, grid, label, legend_above

_SIGNAL_DOTS = 300
_ERROR_KINDS = {"refitted": "refitted", "cause": "with cause"}


@dataclass(frozen=True)
class ErrorOverSignal:
    """Scored samples: a signal (n,) in its unit, errors by model (measured less modelled) in the
    channel's unit, and the share of the variance of the refitted error between parts of the signal,
    beyond chance. A signal and an error that both drift agree by chance."""

    signal: str
    unit: str
    values: FloatArray
    errors: dict[str, FloatArray]
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
    """The error of a channel over the measured or sent signal, or the rate of a measured one, that
    explains most of its variance; None if no sample is scored."""
    scored = _scored(residual, channel)
    if scored.sum() < 2:
        return None
    errors = {
        kind: (residual.columns[channel] - trace)[scored]
        for kind in _ERROR_KINDS
        if (trace := residual.of(channel, kind)) is not None and np.isfinite(trace[scored]).all()
    }
    best: ErrorOverSignal | None = None
    for name, unit in _signals(residual).items():
        values = _along(residual, name)[scored]
        if not np.isfinite(values).all():
            continue
        centres, _, raw = binned(values, errors["refitted"])
        samples = independent_samples(values, errors["refitted"])
        share = adjusted_share(raw, centres.size, samples)
        if best is None or share > best.share:
            best = ErrorOverSignal(name, unit, values, errors, share)
    return best


def _scored(residual: Residual, channel: str) -> NDArray[np.bool_]:
    """Scored rows; only held-out ones, if there are any."""
    columns, refitted = residual.columns, residual.of(channel, "refitted")
    if refitted is None or channel not in columns:
        return np.zeros(columns["window"].size, bool)
    scored = (columns["window"] >= 0) & np.isfinite(columns[channel] - refitted)
    held_out = scored & (columns["part"] == 1)
    return held_out if held_out.any() else scored


def _along(residual: Residual, name: str) -> FloatArray:
    """A signal at every row, a rate along each whole recording; nan where it is not known."""
    values = np.full(residual.columns["time_s"].size, np.nan)
    for stretch in stretches_of(residual, values.size):
        signal = signal_along(residual, name, stretch.rows)
        if signal is not None:
            values[stretch.rows] = signal
    return values


def _signals(residual: Residual) -> dict[str, str]:
    """Names of signals, with their units."""
    measured, units = channels_of(residual), {}
    for column in (*measured, *inputs_of(residual)):
        stem, unit = split_column(column)
        units[stem] = unit
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
        axes.axhline(0.0, color=colour("muted"), linewidth=0.7)
        for kind, error in curve.errors.items():
            centres, middles, _ = binned(curve.values, error)
            role = colour(MODEL_LINES[kind][0])
            axes.plot(
                centres,
                middles,
                color=role,
                linewidth=1.8,
                marker="o",
                markersize=4.0,
                label=f"median, {_ERROR_KINDS[kind]}",
            )
        unit = label(formatting.unit_label(curve.unit))
        axes.set_xlabel(formatting.axis_label(label(formatting.port_label(curve.signal)), unit))
        what = f"{label(formatting.channel_label(channel), 22)} error"
        axes.set_ylabel(formatting.axis_label(what, label(formatting.channel_unit(channel))))
        axes.xaxis.set_major_locator(MaxNLocator(5 if narrow else 9))
        grid(axes, "y")
        legend_above(axes, 2)

    title = error_signal_title(channel, curve.signal, curve.share, curve.removed, run.diagnosis)
    return Drawing("error-signal", title, draw, 2.8, 2.8)
