"""A motion on the page: an SVG that stands still without scripts and in print, and plays with a few
lines of script.

Every moving line carries its points of all frames, whole numbers of a drawing a thousand units
wide; the script shows those of one frame, or those since a while ago. Nothing is loaded.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from markupsafe import Markup

from pamid.base.errors import PamidError
from pamid.model.rig import Rig
from pamid.report import formatting
from pamid.report.load import RunData
from pamid.report.markup import joined, prose, tag
from pamid.report.motion import (
    MEASURED,
    NO_POSE,
    Motion,
    gap_label,
    motion_of,
    rig_of_run,
    scale_of,
)
from pamid.report.page import asset
from pamid.report.reading import FloatArray

PLAYER_HZ = 30  # frames per second
TRAIL_S = 1.0
# units: width of the drawing; of the strips, their left, their head
_WIDE, _STRIP, _LEFT, _ABOVE = 1000, 500, 44, 24


def player_script() -> str:
    """Script that plays the figures of a page."""
    return asset("player.js")


def player_html(run: RunData, rig: Rig | None = None) -> Markup:
    """HTML of the figure; empty if the rig of the run is not in the catalogue, has no pose, or the
    run has too few columns for it. rig: a rig given by the caller, for which PamidError states the
    reason."""
    try:
        motion = motion_of(run, rig or rig_of_run(run), 1.0 / PLAYER_HZ)
    except PamidError as error:
        if rig is not None and error.code != NO_POSE:
            raise
        return Markup("")
    still = _widest(motion)
    several = motion.recording and run.fit is not None and len(run.fit.recordings) > 1
    when = formatting.span(float(motion.time[0]), float(motion.time[-1]), "s")
    note = (
        f"{when}{f' in recording {motion.recording}' if several else ''}; the gaps are "
        "drawn as they are unless they are enlarged ten times below. "
        "At the marks on the time axis the models were set to the measured state again."
    )
    return tag(
        "figure",
        tag("figcaption", prose(motion.title)),
        _legend(motion),
        tag(
            "div",
            _arm(motion, still),
            _strips(motion, still),
            class_="stage",
            role="img",
            aria_label=motion.title,
        ),
        tag("small", prose(note)),
        class_="motion",
        id="motion",
        data_frames=str(motion.time.size),
        data_rate=str(PLAYER_HZ),
        data_still=str(still),
        data_start=f"{motion.time[0]:.3f}",
    )


def _widest(motion: Motion) -> int:
    """Frame with the largest error of the models."""
    gaps = [np.abs(gap) for kinds in motion.gaps.values() for gap in kinds.values()]
    return int(np.argmax(np.max(gaps, axis=0)))


def _class(motion: Motion, kind: str) -> str:
    """Role of a line for its colour: measured, or the index of a model."""
    kinds = list(motion.lines)
    return (
        kind
        if kind == MEASURED
        else f"{'best' if kind == kinds[-1] else 'before'} {kind.replace('_', '-')}"
    )


def _legend(motion: Motion) -> Markup:
    keys = [
        tag(
            "span",
            tag(
                "svg",
                tag("line", x1="2", y1="5", x2="30", y2="5"),
                viewBox="0 0 32 10",
                aria_hidden="true",
                class_=_class(motion, kind),
            ),
            motion.names[kind],
        )
        for kind in motion.lines
    ]
    return tag("div", keys, class_="legend")


def _arm(motion: Motion, still: int) -> Markup:
    """The polylines, measured below, with the paths of the tip, pivots and a scale."""
    low, high = motion.box
    unit = float((high - low).max()) / _WIDE
    wide, tall = np.ceil((high - low) / unit).astype(int)

    def drawn(points: FloatArray) -> FloatArray:
        return np.rint((points - [low[0], high[1]]) / [unit, -unit])

    best = list(motion.lines)[-1]
    pins = [
        tag("circle", cx=f"{x:.0f}", cy=f"{y:.0f}", r="24", class_="pivot")
        for x, y in drawn(motion.pivots)
    ]
    trails = [
        _moving(
            drawn(motion.tip(kind))[:, None],
            still,
            f"trail {_class(motion, kind)}",
            round(TRAIL_S * PLAYER_HZ),
        )
        for kind in (MEASURED, best)
    ]
    arms = [
        _moving(drawn(line), still, f"arm {_class(motion, kind)}")
        for kind, lines in motion.lines.items()
        for line in lines
    ]
    length = scale_of(float((high - low).max()))
    ends = 20 + round(length / unit)
    scale = [
        tag("path", d=f"M20 {tall - 14}H{ends}", class_="scale"),
        tag("text", f"{length:g} m", x="20", y=str(tall - 26), class_="mark"),
    ]
    return tag(
        "svg",
        pins,
        trails,
        arms,
        scale,
        viewBox=f"0 0 {wide} {tall}",
        class_="pose",
        aria_hidden="true",
    )


def _moving(points: FloatArray, still: int, class_: str, tail: int = 0) -> Markup:
    """A polyline with its points (frames, points, 2) of every frame; `tail`: how many frames before
    are shown too."""
    return tag(
        "polyline",
        points=_numbers(points[max(0, still - tail) : still + 1]),
        class_=class_,
        data_points=_numbers(points),
        data_tail=str(tail),
    )


def _numbers(points: FloatArray) -> str:
    return " ".join(f"{value:.0f}" for value in points.ravel())


def _strips(motion: Motion, still: int) -> Markup:
    """Gaps of every channel over time, one below the other, with a cursor."""
    right, count = _STRIP - 12, len(motion.gaps)
    across = _LEFT + (right - _LEFT) * (motion.time - motion.time[0]) / float(np.ptp(motion.time))
    tall = max(60, 200 // count - _ABOVE)
    pitch = tall + _ABOVE + 12
    parts = [
        _strip(motion, channel, across, pitch * k, tall) for k, channel in enumerate(motion.gaps)
    ]
    bottom = pitch * count - 8
    restarts = "".join(
        f"M{x:.1f} {bottom - 4}v8" for x in np.interp(motion.restarts, motion.time, across)
    )
    ticks = [(np.interp(t, motion.time, across), f"{t:g}") for t in _round_times(motion.time)]
    axis = [
        tag("path", d=f"M{_LEFT} {bottom}H{right}{restarts}", class_="axis"),
        [
            tag("text", text, x=f"{x:.1f}", y=str(bottom + 18), class_="mark", text_anchor="middle")
            for x, text in ticks
        ],
        tag("text", "time [s]", x=str(right), y=str(bottom + 34), class_="mark", text_anchor="end"),
    ]
    cursor = tag(
        "path",
        d=f"M0 16V{bottom}",
        class_="cursor",
        transform=f"translate({across[still]:.1f} 0)",
        data_left=str(_LEFT),
        data_right=str(right),
    )
    return tag(
        "svg",
        parts,
        axis,
        cursor,
        viewBox=f"0 0 {_STRIP} {bottom + 40}",
        class_="strips",
        aria_hidden="true",
    )


def _strip(motion: Motion, channel: str, across: FloatArray, top: int, tall: int) -> Markup:
    """Curves of one channel, with the smallest and the largest gap as labels."""
    gaps = motion.gaps[channel]
    low = min(0.0, *(float(gap.min()) for gap in gaps.values()))
    high = max(0.0, *(float(gap.max()) for gap in gaps.values()))
    reach = max(high - low, 1e-12)

    def down(gap: FloatArray | float) -> FloatArray:
        return np.asarray(top + _ABOVE + tall * (high - np.asarray(gap)) / reach)

    curves = [
        tag(
            "polyline",
            points=" ".join(f"{x:.1f} {y:.1f}" for x, y in zip(across, down(gap), strict=True)),
            class_=f"gap {_class(motion, kind)}",
        )
        for kind, gap in gaps.items()
    ]
    what = formatting.axis_label(gap_label(channel), formatting.channel_unit(channel))
    edges: Iterable[tuple[float, str]] = (
        (value, formatting.short(value, 2))
        for value in {low, high, 0.0}
        if value == 0.0 or abs(value) > 0.2 * reach
    )
    marks = [
        tag(
            "text",
            text,
            x=str(_LEFT - 6),
            y=f"{float(down(value)) + 4:.1f}",
            class_="mark",
            text_anchor="end",
        )
        for value, text in sorted(edges)
    ]
    zero = tag("path", d=f"M{_LEFT} {float(down(0.0)):.1f}H{_STRIP - 12}", class_="zero")
    return joined(
        [tag("text", what, x=str(_LEFT), y=str(top + 14), class_="mark"), zero, *curves, *marks]
    )


def _round_times(time: FloatArray) -> FloatArray:
    """About five round times within these."""
    first, last = float(time[0]), float(time[-1])
    step = scale_of(6.0 * (last - first) / 4.0)
    return np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step
