"""The errors of a run in a row per channel, from any of its files, and the headline channel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.run_folder import FIT_FILE, NETWORK_FILE
from pamid.report.formatting import SPACE, channel_label, channel_unit, number
from pamid.report.load import Residual, RunData

#: field of ChannelErrors -> what people call it, in the order of the tables and bars
MODEL_NAMES = {
    "data_sheet": "data sheet",
    "refitted": "refitted",
    "with_network": "with network",
    "with_cause": "with cause",
    "noise_floor": "noise floor",
}
#: kind of a model's trace in residual.csv -> field of ChannelErrors, role of its colour
FIELDS = {
    "data_sheet": "data_sheet",
    "refitted": "refitted",
    "cause": "with_cause",
    "network": "with_network",
}
#: times the refitted error: a model that is off by more would hide the others in a plot
HIDES_OTHERS = 4.0
_AGREE = 0.02  # two files that agree on an MAE within this share are not worth a remark


@dataclass(frozen=True)
class ChannelErrors:
    """Held-out MAE (eq. 11) of a channel by model, in its unit; None if no file states it."""

    channel: str
    data_sheet: float | None = None
    refitted: float | None = None
    with_network: float | None = None
    with_cause: float | None = None
    noise_floor: float | None = None
    shrinkage: float | None = None
    low: float | None = None
    high: float | None = None

    def known(self) -> dict[str, float]:
        """The MAE that a file of the run states, by field."""
        errors = {name: getattr(self, name) for name in MODEL_NAMES}
        return {name: value for name, value in errors.items() if value is not None}


@dataclass(frozen=True)
class WorstWindow:
    """The scored window in which the refitted model errs most: its rows, and whether anything was
    held out at all."""

    rows: slice
    recording: int
    start_s: float
    end_s: float
    held_out: bool
    mae: dict[str, float]  # of the headline channel, by kind of model


def errors_of(run: RunData) -> tuple[ChannelErrors, ...]:
    """A row per channel. The diagnosis takes precedence over the fit, so that all its columns
    belong to the same set of windows."""
    fitted = run.fit.mae if run.fit is not None else {}
    reached = run.diagnosis.how_far if run.diagnosis is not None else {}
    names = list(run.fit.channels) if run.fit is not None else []
    names += [name for name in [*fitted, *reached] if name not in names]
    return tuple(_row(name, run) for name in names if name in fitted or name in reached)


def models_of(errors: Sequence[Mapping[str, float | None]]) -> list[str]:
    """The models that at least one row has an error of, in the order of the tables."""
    return [name for name in MODEL_NAMES if any(name in row for row in errors)]


def mae_text(rows: tuple[ChannelErrors, ...]) -> str:
    """Held-out MAE (eq. 11) per channel and model in plain text, columns aligned."""
    fields = models_of([row.known() for row in rows])
    lines = [["MAE, held out", *(MODEL_NAMES[name] for name in fields)]]
    for row in rows:
        name = f"{channel_label(row.channel)} [{channel_unit(row.channel) or '-'}]"
        lines.append([name, *(number(row.known().get(field)) for field in fields)])
    return aligned(lines, 1)


def aligned(lines: Sequence[Sequence[str]], left: int) -> str:
    """Rows of cells in plain text, columns aligned, the first ones to the left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = []
    for line in lines:
        cells = [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        texts.append("  ".join(cells).replace(SPACE, " ").rstrip())
    return "\n".join(texts)


def _row(name: str, run: RunData) -> ChannelErrors:
    fitted = run.fit.mae.get(name, {}) if run.fit is not None else {}
    reached = run.diagnosis.how_far.get(name) if run.diagnosis is not None else None
    network = run.network_errors(in_loop=False).get(name, {})
    errors = {
        "data_sheet": reached.mae_data_sheet if reached else None,
        "refitted": reached.mae_refitted if reached else None,
        "noise_floor": reached.noise_floor if reached else None,
    }
    stated = {k: fitted.get(k) if error is None else error for k, error in errors.items()}
    row = ChannelErrors(name, **stated, with_network=network.get("with_network"))
    # else there is no "with cause"
    if reached is None or run.diagnosis is None or not run.diagnosis.causes:
        return row
    return replace(
        row,
        with_cause=reached.mae_with_cause,
        shrinkage=reached.shrinkage,
        low=reached.low,
        high=reached.high,
    )


def disagreements(
    run: RunData, rows: tuple[ChannelErrors, ...]
) -> list[tuple[str, str, float, float]]:
    """Where another file scored the refitted model on other windows: (channel, file, its MAE, the
    MAE shown)."""
    differing = []
    replayed = run.network_errors(in_loop=False)
    others = {FIT_FILE: run.fit.mae if run.fit else {}, NETWORK_FILE: replayed}
    for row in rows:
        for file, mae in others.items():
            other = mae.get(row.channel, {}).get("refitted")
            shown = row.refitted
            if other is not None and shown is not None and abs(other - shown) > _AGREE * shown:
                differing.append((row.channel, file, other, shown))
    return differing


def headline(rows: tuple[ChannelErrors, ...]) -> ChannelErrors | None:
    """The channel that leads the report: the largest gain by the cause (else the largest refitted
    error) per noise floor."""

    def weight(row: ChannelErrors) -> float:
        if row.refitted is None:
            return -np.inf
        gain = row.refitted - row.with_cause if row.with_cause is not None else row.refitted
        scale = row.noise_floor or row.refitted
        return gain / scale if scale else 0.0

    return max(rows, key=weight, default=None)  # the first of equals: in the rig's order


def worst_window(residual: Residual, channel: str) -> WorstWindow | None:
    """The scored window with the largest refitted MAE, held out if any window is."""
    measured, refitted = residual.columns.get(channel), residual.of(channel, "refitted")
    if measured is None or refitted is None:
        return None
    part, window = residual.columns["part"], residual.columns["window"]
    scored = (window >= 0) & np.isfinite(refitted) & np.isfinite(measured)
    held_out = bool((scored & (part == 1)).any())
    scored &= part == (1 if held_out else 0)
    rows = np.flatnonzero(scored)
    if rows.size == 0:
        return None
    best = max(stretches(residual, rows), key=lambda item: _mae(measured[item], refitted[item]))
    return _window(residual, channel, best, held_out, FIELDS)


def _window(
    residual: Residual, channel: str, rows: slice, held_out: bool, kinds: Iterable[str]
) -> WorstWindow:
    """A window with the MAE of every model that was run there."""
    measured, time = residual.columns[channel], residual.columns["time_s"]
    traces = {kind: residual.of(channel, kind) for kind in kinds}
    mae = {kind: _mae(measured[rows], x[rows]) for kind, x in traces.items() if x is not None}
    return WorstWindow(
        rows,
        int(residual.columns["recording"][rows.start]),
        float(time[rows.start]),
        float(time[rows.stop - 1]),
        held_out,
        {kind: error for kind, error in mae.items() if np.isfinite(error)},
    )


def whole_recording(residual: Residual, channel: str, recording: int) -> WorstWindow | None:
    """The whole of a recording with the MAE of the free runs; None if there is none of the
    refitted model, as of an earlier version or where it became unstable."""
    rows = np.flatnonzero(residual.columns["recording"] == recording)
    if not rows.size:
        return None
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    whole = _window(residual, channel, part, False, ("free_run", "cause_free_run"))
    if "free_run" not in whole.mae:
        return None
    return replace(whole, mae={**whole.mae, "refitted": whole.mae["free_run"]})


def stretches(residual: Residual, rows: NDArray[np.intp]) -> list[slice]:
    """Runs of successive rows with the same recording and window, as slices."""
    if not rows.size:
        return []
    recording, window = residual.columns["recording"], residual.columns["window"]
    breaks = (np.diff(rows) > 1) | (np.diff(recording[rows]) != 0) | (np.diff(window[rows]) != 0)
    edges = np.flatnonzero(breaks)
    starts = rows[np.concatenate([[0], edges + 1])]
    ends = rows[np.concatenate([edges, [rows.size - 1]])]
    return [slice(int(start), int(end) + 1) for start, end in zip(starts, ends, strict=True)]


def _mae(measured: Array, model: Array) -> float:
    error = np.abs(measured - model)
    error = error[np.isfinite(error)]
    return float(error.mean()) if error.size else float("nan")
