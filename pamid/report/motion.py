"""How the rig moved in a run: the measured pose and those of the models, as polylines to be
drawn.

The rig comes from the catalogue by its name, or from whoever calls; nothing in a run is executed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError, join_words, nearest
from pamid.base.result_file import REMEDY
from pamid.base.units import split_column, to_si
from pamid.model.registry import catalogue_rig, rig_named, rigs
from pamid.model.rig import Rig
from pamid.model.trace import Names
from pamid.report import formatting
from pamid.report.captions import causes_label
from pamid.report.channel_errors import FIELDS, MODEL_NAMES, WorstWindow, worst_window
from pamid.report.load import Residual, RunData

LONGEST_SHOWN_S = 12.0  # shown where no times are given
MEASURED = "measured"
TRAIL_S = 1.0  # of the tip's path that is drawn
NO_POSE = "no-pose"  # code of the error where a rig does not describe its pose


@dataclass(frozen=True)
class Motion:
    """Poses over time.

    time      of every frame in its recording (n,), s
    lines     "measured", then up to two kinds of models, the best last -> polylines, each
              (n, points, 2), m
    gaps      channel the pose follows from -> kind -> model - measured (n,), channel's unit
    restarts  times at which the models were set to the measured state again, s
    names     kind -> name in a legend
    title     states the finding: mean |gap| over the scored samples between the first and the last
              frame
    """

    recording: str
    time: Array
    lines: dict[str, tuple[Array, ...]]
    gaps: dict[str, dict[str, Array]]
    restarts: Array
    names: dict[str, str]
    means: dict[str, dict[str, float]]
    title: str

    @property
    def box(self) -> tuple[Array, Array]:
        """Lower left and upper right corner of all that is drawn, with a margin, m."""
        points = np.concatenate(
            [line.reshape(-1, 2) for lines in self.lines.values() for line in lines]
        )
        low, high = points.min(axis=0), points.max(axis=0)
        size = float(max(*(high - low), 1e-6))
        middle, half = 0.5 * (low + high), 0.5 * np.maximum(high - low, 0.3 * size) + 0.08 * size
        return middle - half, middle + half

    @property
    def pivots(self) -> Array:
        """Points that never move, (points, 2), m."""
        points = np.concatenate(self.lines[MEASURED], axis=1)
        still = np.ptp(points, axis=0).max(axis=1) < 1e-9
        return np.unique(points[0, still], axis=0)

    @property
    def best(self) -> str:
        """Kind of the best model."""
        return list(self.lines)[-1]

    def rank(self, kind: str) -> str:
        """ "measured", "best" or "before", of the model before the best."""
        return kind if kind == MEASURED else "best" if kind == self.best else "before"

    def tip(self, kind: str) -> Array:
        """The last point of the first polyline (n, 2), m."""
        return self.lines[kind][0][:, -1]


def rig_of_run(run: RunData, named: str | None = None) -> Rig:
    """The rig that draws a run: `named` by the caller (a rig file is run), else the catalogue's of
    the run's name.

    FileError if there is none, it is another rig, or it has no pose.
    """
    if named is None and run.rig not in rigs():
        raise FileError(
            f"The run is of the rig {run.rig!r}, which is not in the catalogue.",
            "A rig file is code, which pamid runs only if you name it: add --rig FILE.",
            code="rig",
        )
    rig = rig_named(named) if named is not None else catalogue_rig(run.rig)
    if rig.name != run.rig:
        raise FileError(
            f"The run is of the rig {run.rig!r}, {named} is {rig.name!r}.",
            "Give the rig of the run.",
            code="rig",
        )
    if type(rig).pose is Rig.pose:
        hint = (
            "A model file states none: leave --rig out."
            if named is not None and Path(named).suffix not in ("", ".py")
            else "Give the rig a method pose(self, y, p) that returns its polylines in metres."
        )
        raise FileError(f"The rig {rig.name!r} has no pose to draw.", hint, code=NO_POSE)
    return rig


def motion_of(
    run: RunData, rig: Rig, step_s: float, begin: float | None = None, end: float | None = None
) -> Motion:
    """Poses every `step_s` of the recording whose held-out window is the worst: between two times
    [s], or without them over at most 12 s of the held-out part around that window.

    DataError if the run does not hold what the pose needs or has nothing at these times.
    """
    if run.residual is None:
        raise DataError(
            "The run has no residual.csv, so there is no motion to draw.",
            "`pamid fit` writes it.",
            code="no-residual",
        )
    residual, parameters = run.residual, _parameters(run, rig)
    channels = _channels(residual, rig, parameters)
    kinds = _kinds(run, residual, channels)
    traces = {MEASURED: {name: residual.columns[name] for name in channels}}
    for kind in kinds:
        traces[kind] = {n: x for n in channels if (x := residual.of(n, kind)) is not None}
    windows = [w for name in channels if (w := worst_window(residual, name)) is not None]
    if not windows:
        raise DataError("No window of residual.csv is scored.", REMEDY, code="no-window")
    window = max(windows, key=lambda w: w.mae["refitted"])
    rows = _rows(residual, traces, window, begin, end)
    clock = residual.columns["time_s"][rows]
    first, last = _span(clock, window, begin, end, step_s)
    time = first + step_s * np.arange(int((last - first) / step_s + 1e-9) + 1, dtype=np.float64)
    shown = {
        kind: {name: np.interp(time, clock, trace[rows]) for name, trace in of.items()}
        for kind, of in traces.items()
    }
    rows = rows[(clock >= first) & (clock <= last)]
    number_of_window = residual.columns["window"][rows]
    restarts = np.flatnonzero((np.diff(number_of_window) != 0) & (number_of_window[:-1] >= 0)) + 1
    if not rows.size:
        raise DataError(
            "The run has no sample at these times.",
            f"Its samples begin at {clock[0]:g} s and end at {clock[-1]:g} s.",
            code="times",
        )
    names = {kind: MODEL_NAMES[FIELDS[kind]] for kind in kinds}
    if "cause" in kinds and run.diagnosis is not None and len(run.diagnosis.causes) == 1:
        names["cause"] = f"with {causes_label(run.diagnosis)}"
    # mean |gap| over the scored rows, or over all of them where none is scored
    scored = rows[residual.columns["window"][rows] >= 0]
    scored = scored if scored.size else rows
    means = {
        name: {
            kind: float(np.abs(traces[kind][name] - measured)[scored].mean())
            for kind in traces
            if kind != MEASURED
        }
        for name, measured in traces[MEASURED].items()
    }
    return Motion(
        recording=formatting.clean(run.recording_name(window.recording)),
        time=time,
        lines={kind: _posed(rig, _Outputs(rig, of), parameters) for kind, of in shown.items()},
        gaps={
            name: {kind: shown[kind][name] - shown[MEASURED][name] for kind in kinds}
            for name in channels
        },
        restarts=residual.columns["time_s"][rows[restarts]],
        names={MEASURED: MEASURED, **names},
        means=means,
        title=motion_title(means, names),
    )


def _channels(residual: Residual, rig: Rig, parameters: Names) -> list[str]:
    """The outputs that the pose reads."""
    outputs = _Outputs(
        rig, {name: residual.columns[name][:1] for name in rig.outputs if name in residual.columns}
    )
    if not outputs:
        raise DataError(
            f"residual.csv has no output of the rig {rig.name!r}.", REMEDY, code="no-output"
        )
    _posed(rig, outputs, parameters)
    return [name for name in rig.outputs if name in outputs.read]


def motion_title(means: dict[str, dict[str, float]], names: dict[str, str]) -> str:
    """ "The refitted model follows the angle to 0.06 deg on average (data sheet: 2.4 deg)"."""
    *before, best = names
    units = [formatting.channel_unit(channel) for channel in means]
    # a common unit is named once
    shown = units if len(set(units)) > 1 else [*[""] * (len(units) - 1), units[-1]]

    def mean_texts(kind: str) -> list[str]:
        return [
            formatting.with_unit_text(of[kind], unit, 2)
            for of, unit in zip(means.values(), shown, strict=True)
        ]

    article = "the " if len(means) == 1 else ""
    follows = join_words(
        f"{article}{formatting.channel_label(channel)} to {value}"
        for channel, value in zip(means, mean_texts(best), strict=True)
    )
    model = f"model {names[best]}" if best == "cause" else f"{names[best]} model"
    others = "".join(f" ({names[kind]}: {join_words(mean_texts(kind))})" for kind in before)
    return f"The {model} follows {follows} on average{others}"


def scale_of(extent: float) -> float:
    """A round length of about a sixth of the extent: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(extent / 6.0))
    return max(
        step * power for step in (1.0, 2.0, 5.0) if step * power <= extent / 6.0 * (1.0 + 1e-9)
    )


def gap_label(channel: str) -> str:
    """ "angle 1: model - measured"."""
    return f"{formatting.channel_label(channel)}: model {formatting.MINUS} measured"


class _Outputs(Mapping[str, Array]):
    """Outputs by name in SI, from the columns of a run; `read` collects those that a pose used."""

    def __init__(self, rig: Rig, columns: Mapping[str, Array]) -> None:
        self._rig, self._columns, self.read = rig, columns, set[str]()

    def __getitem__(self, name: str) -> Array:
        if name not in self._columns:
            known = name in self._rig.outputs
            hint = "Record that channel." if known else nearest(name, list(self._rig.outputs))
            raise DataError(
                f"The pose of the rig {self._rig.name!r} needs {name!r}, which is not in the run.",
                hint,
            )
        self.read.add(name)
        values: Array = to_si(self._columns[name], split_column(name)[1])
        return values

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def _parameters(run: RunData, rig: Rig) -> Names:
    """The rig's parameters by name (SI): fitted where they were, else from the data sheet."""
    fitted = run.fit.parameters if run.fit is not None else {}
    values = {
        p.name: p.factor * (fitted[p.outside_name].value if p.outside_name in fitted else p.value)
        for p in rig.parameters
    }
    return Names(values, "parameter")


def _posed(rig: Rig, outputs: _Outputs, parameters: Names) -> tuple[Array, ...]:
    """The polylines of a pose, checked; they may come from a user's file."""
    pose = rig.pose(outputs, parameters)
    size = len(next(iter(outputs.values())))
    if not pose:
        raise FileError(f"The rig {rig.name!r} has no pose to draw.", code="rig")
    lines = {name: np.asarray(line, dtype=float) for name, line in pose.items()}
    for name, line in lines.items():
        if line.ndim != 3 or line.shape[0] != size or line.shape[1] < 2 or line.shape[2] != 2:
            raise FileError(
                f"The pose of the rig {rig.name!r}: {name!r} has the shape {line.shape}, expected "
                f"({size}, points, 2).",
                "Return a row per sample and at least two points.",
                code="rig",
            )
        if not np.isfinite(line).all():
            raise DataError(
                f"The pose of the rig {rig.name!r}: {name!r} is not finite.", code="not-finite"
            )
    return tuple(lines.values())


def _kinds(run: RunData, residual: Residual, channels: list[str]) -> tuple[str, ...]:
    """The best model that was run on every channel, and the model before it."""
    causes = run.diagnosis is not None and bool(run.diagnosis.causes)
    complete = [
        kind
        for kind in FIELDS
        if (causes or kind != "cause")
        and kind != "network"
        and all(residual.of(name, kind) is not None for name in channels)
    ]
    if not complete:
        raise DataError(
            "residual.csv has no model of the columns that the pose needs.", REMEDY, code="no-model"
        )
    return tuple(complete[-2:])


def _rows(
    residual: Residual,
    columns: dict[str, dict[str, Array]],
    window: WorstWindow,
    begin: float | None,
    end: float | None,
) -> NDArray[np.intp]:
    """Rows of the window's recording by time; without given times of its held-out part only."""
    table = residual.columns
    usable = (table["recording"] == window.recording) & np.isfinite(table["time_s"])
    if begin is None and end is None:
        usable &= table["part"] == (1 if window.held_out else 0)
    for traces in columns.values():
        for trace in traces.values():
            usable &= np.isfinite(trace)
    rows = np.flatnonzero(usable)
    return rows[np.unique(table["time_s"][rows], return_index=True)[1]]


def _span(
    clock: Array, window: WorstWindow, begin: float | None, end: float | None, step_s: float
) -> tuple[float, float]:
    """First and last time shown; a nan is refused with all else that leaves nothing."""
    if clock.size < 2:
        raise DataError(
            "The run has too few of the columns that the pose needs.", REMEDY, code="times"
        )
    first, last = float(clock[0]), float(clock[-1])
    if begin is None and end is None:
        middle = 0.5 * (window.start_s + window.end_s)
        begin = min(middle - 0.5 * LONGEST_SHOWN_S, last - LONGEST_SHOWN_S)
    elif begin is None and end is not None:
        begin = end - LONGEST_SHOWN_S
    low = first if begin is None else max(begin, first)
    high = min(low + LONGEST_SHOWN_S if end is None else end, last)
    if not high - low >= step_s:
        raise DataError(
            "The run has no samples at these times.",
            f"Its recording spans {first:g} to {last:g} s.",
            code="times",
        )
    return low, high
