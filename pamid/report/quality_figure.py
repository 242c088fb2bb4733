"""Picture of a recording's quality: every channel over time with the places of each finding, and an
enlarged part in which noise and quantisation are visible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import blended_transform_factory

from pamid.base.arrays import Array
from pamid.intake.checks.findings import QualityIssue
from pamid.recording.file_checks import HUGE
from pamid.recording.recording import Recording
from pamid.report import formatting
from pamid.report.style import Drawing, Look, colour, finish, label, line

BUCKETS = 700  # of which each shows its lowest and highest sample
MOST_CHANNELS = 24
NARROWEST = 0.004  # of the time axis: a single sample must be seen, too
CLOSE = 60  # samples in the panel for noise and step
SPELT_OUT = 3  # findings named in the title
ROW_IN, REST_IN = 0.72, 0.45


def quality_drawing(
    recording: Recording,
    issues: Sequence[QualityIssue],
    channels: Mapping[str, Mapping[str, float]],
    others: Sequence[str] = (),
) -> Drawing:
    """The quality card; channels: step and noise per column
    (`quality.channels` of the check); others: further faults, as a missing column
    of the rig."""
    # the columns in their order: all of them, or where there are too many, those with findings
    named = {column for issue in issues for column in issue.columns}
    chosen = sorted(recording.columns, key=lambda name: name not in named)[:MOST_CHANNELS]
    rows = [name for name in recording.columns if name in chosen]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(rows), 2, squeeze=False, width_ratios=[5.0, 1.0], sharex="col")
        for (full, close), name in zip(axes, rows, strict=True):
            _over_time(full, recording, name, [issue for issue in issues if name in issue.columns])
            _close_up(close, recording, name, channels[name])
        head: Look = {"fontsize": 8.0, "pad": 3.0, "color": colour("muted")}
        axes[0, 1].set_title(f"{CLOSE} quiet samples", loc="left", **head)
        axes[-1, 0].set_xlabel("time [s]")
        axes[-1, 1].set_xlabel(f"time [{_close_unit(recording)[1]}]")
        figure.align_ylabels(axes[:, 0])

    height = REST_IN + ROW_IN * len(rows)
    return Drawing("quality", card_title(recording, issues, others), draw, height, height)


def card_title(
    recording: Recording, issues: Sequence[QualityIssue], others: Sequence[str] = ()
) -> str:
    """How many problems and notes there are, as `check` counts them, and the first."""
    wrong = [*others, *(issue.message for issue in issues if issue.severity == "wrong")]
    notes = [issue.message for issue in issues if issue.severity != "wrong"]
    if not wrong:
        length = len(recording) * recording.sampling_period_s
        counted = f"nothing is wrong with {len(recording.columns)} channels over {length:.4g} s"
        counted = f"{recording.name}: {counted}" + (f"; {_many(notes, 'note')}" if notes else "")
    else:
        counted = " and ".join(
            _many(findings, word)
            for findings, word in ((wrong, "problem"), (notes, "note"))
            if findings
        )
        counted = f"{counted} in {recording.name}"
    findings = [*wrong, *notes]
    more = f"; and {len(findings) - SPELT_OUT} more" if len(findings) > SPELT_OUT else ""
    return f"{counted}: {'; '.join(findings[:SPELT_OUT])}{more}" if findings else counted


def _many(findings: Sequence[str], word: str) -> str:
    return f"{len(findings)} {word}{'' if len(findings) == 1 else 's'}"


def _over_time(axes: Axes, recording: Recording, name: str, issues: Sequence[QualityIssue]) -> None:
    time, values = recording.time, _drawable(recording, name)
    wrong = any(issue.severity == "wrong" for issue in issues)
    line(axes, *envelope(time, values), "refitted" if not wrong else "with_cause", 0.8)
    across = blended_transform_factory(axes.transData, axes.transAxes)
    least = NARROWEST * (time[-1] - time[0])
    for begin, end in joined([window for issue in issues for window in issue.windows_s], least):
        axes.axvspan(begin, end, color=colour("with_cause"), alpha=0.22, linewidth=0.0)
        look = {"transform": across, "solid_capstyle": "butt", "clip_on": False}
        line(axes, [begin, end], [1.0, 1.0], "with_cause", 2.0, **look)
    kinds = list(dict.fromkeys(issue.kind.replace("-", " ") for issue in issues))
    axes.set_title(
        label(name, 60) + (f":  {', '.join(kinds)}" if kinds else ""),
        loc="left",
        fontsize=8.0,
        pad=3.0,
        color=colour("with_cause" if kinds else "ink"),
        fontweight="bold" if kinds else "normal",
    )
    axes.set_xlim(time[0], time[-1])
    axes.margins(y=0.08)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.tick_params(labelsize=7.5)
    finish(axes, "", f"[{label(formatting.channel_unit(name), 12) or '-'}]")


def _close_unit(recording: Recording) -> tuple[float, str]:
    """Unit of time of the close-up, with the factor from seconds."""
    return (1.0, "s") if CLOSE * recording.sampling_period_s > 10.0 else (1e3, "ms")


def _close_up(axes: Axes, recording: Recording, name: str, channel: Mapping[str, float]) -> None:
    """The stretch in which the channel moves least without standing still, sample by sample."""
    values = _drawable(recording, name)
    start = quietest(values)
    part = values[start : start + CLOSE]
    axes.plot(
        _close_unit(recording)[0] * recording.sampling_period_s * np.arange(part.size),
        part - np.median(part),
        color=colour("muted"),
        linewidth=0.5,
        marker="o",
        markersize=1.6,
        markeredgewidth=0.0,
        markerfacecolor=colour("ink"),
    )
    figures = [
        f"{what} {formatting.number(channel[what], 2)}"
        for what in ("noise", "step")
        if channel[what] > 0.0
    ]
    axes.set_ylabel(
        "\n".join(figures) or "no noise\nto be seen",
        fontsize=7.0,
        rotation=0,
        ha="left",
        va="center",
    )
    axes.yaxis.set_label_position("right")
    axes.yaxis.set_major_locator(MaxNLocator(2))
    axes.tick_params(labelsize=7.0)
    half = max(
        1.3 * float(np.abs(part - np.median(part)).max()),
        3.0 * channel["noise"],
        1.5 * channel["step"],
    )
    axes.set_ylim(-(half or 1.0), half or 1.0)


def _drawable(recording: Recording, name: str) -> Array:
    """A column clipped to the range that the axes support."""
    return np.clip(recording.columns[name], -HUGE, HUGE)


def quietest(values: Array) -> int:
    """First sample of the stretch of 60 that moves least, among those that show most of the noise:
    whose samples repeat each other least often."""
    starts = np.arange(0, max(1, values.size - CLOSE), CLOSE // 2)
    parts = [values[a : a + CLOSE] for a in starts]
    repeats = np.array([np.mean(np.diff(part) == 0.0) for part in parts])
    usual = np.flatnonzero(repeats <= np.quantile(repeats, 0.25))
    return int(starts[usual[np.argmin([np.ptp(parts[k]) for k in usual])]])


def joined(windows: Sequence[tuple[float, float]], least: float) -> list[tuple[float, float]]:
    """Windows widened to at least `least` and joined where they then overlap."""
    spans: list[tuple[float, float]] = []
    for begin, end in sorted(windows):
        spare = max(0.0, 0.5 * (least - (end - begin)))
        begin, end = begin - spare, end + spare
        if spans and begin <= spans[-1][1]:
            begin, end = spans[-1][0], max(spans.pop()[1], end)
        spans.append((begin, end))
    return spans


def envelope(time: Array, values: Array) -> tuple[Array, Array]:
    """The lowest and highest sample of each of at most 700 stretches, so that spikes show."""
    if values.size <= 2 * BUCKETS:
        return time, values
    starts = np.linspace(0, values.size, BUCKETS, endpoint=False).astype(np.intp)
    both = np.stack(
        [np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)], axis=1
    )
    return np.repeat(time[starts], 2), both.ravel()
