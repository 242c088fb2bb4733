"""A motion on the page: an SVG that stands still without scripts and in print, and plays with a few
lines of script.

Every moving line carries its points of all frames, whole numbers of a drawing a thousand units
wide; the script shows those of a single frame, or those since a while ago. Nothing is loaded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.model.rig import Rig
from pamid.report import formatting
from pamid.report.load import RunData
from pamid.report.motion import (
    MEASURED,
    NO_POSE,
    TRAIL_S,
    Motion,
    gap_label,
    motion_of,
    rig_of_run,
    scale_of,
)
from pamid.report.page import rendered

PLAYER_HZ = 30  # frames per second
# units: width of the drawing; of the strips, their right and left, their head
_WIDE, _RIGHT, _LEFT, _ABOVE = 1000, 488, 44, 24


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
    # the frame with the largest error of the models
    gaps = [np.abs(gap) for kinds in motion.gaps.values() for gap in kinds.values()]
    still = int(np.argmax(np.max(gaps, axis=0)))
    several = motion.recording and len(run.recordings) > 1
    when = formatting.span(float(motion.time[0]), float(motion.time[-1]), "s")
    return rendered(
        "motion.html",
        title=motion.title,
        frames=motion.time.size,
        rate=PLAYER_HZ,
        still=still,
        start=f"{motion.time[0]:.3f}",
        legend=[(_class(motion, kind), motion.names[kind]) for kind in motion.lines],
        note=f"{when}{f' in recording {motion.recording}' if several else ''}; the gaps are "
        "drawn as they are unless they are enlarged ten times below. "
        "At the marks on the time axis the models were set to the measured state again.",
        **_pose(motion, still),
        **_strips(motion, still),
    )


def _class(motion: Motion, kind: str) -> str:
    """Classes of a line: measured, or the rank and the kind of a model."""
    return kind if kind == MEASURED else f"{motion.rank(kind)} {kind.replace('_', '-')}"


def _pose(motion: Motion, still: int) -> dict[str, Any]:
    """The polylines, measured below, with the paths of the tip, pivots and a scale."""
    low, high = motion.box
    unit = float((high - low).max()) / _WIDE
    wide, tall = (int(size) for size in np.ceil((high - low) / unit))
    length = scale_of(float((high - low).max()))

    def drawn(points: Array) -> Array:
        return np.rint((points - [low[0], high[1]]) / [unit, -unit])

    def moving(shape: str, kind: str, points: Array, tail: int) -> tuple[str, str, str, int]:
        """Points (frames, points, 2); tail: how many frames before are shown too."""
        first = points[max(0, still - tail) : still + 1]
        return f"{shape} {_class(motion, kind)}", _numbers(first), _numbers(points), tail

    trails = [
        moving("trail", kind, drawn(motion.tip(kind))[:, None], round(TRAIL_S * PLAYER_HZ))
        for kind in (MEASURED, motion.best)
    ]
    arms = [
        moving("arm", kind, drawn(line), 0)
        for kind, lines in motion.lines.items()
        for line in lines
    ]
    return {
        "wide": wide,
        "tall": tall,
        "pivots": [(f"{x:.0f}", f"{y:.0f}") for x, y in drawn(motion.pivots)],
        "lines": [*trails, *arms],
        "scale": f"{length:g} m",
        "scale_end": 20 + round(length / unit),
    }


def _numbers(points: Array) -> str:
    return " ".join(f"{value:.0f}" for value in points.ravel())


def _strips(motion: Motion, still: int) -> dict[str, Any]:
    """Gaps of every channel over time, stacked, with a cursor."""
    count, time = len(motion.gaps), motion.time
    across = _LEFT + (_RIGHT - _LEFT) * (time - time[0]) / float(np.ptp(time))
    tall = max(60, 200 // count - _ABOVE)
    pitch = tall + _ABOVE + 12
    bottom = pitch * count - 8
    restarts = np.interp(motion.restarts, time, across)
    # about five round times
    first, last = float(time[0]), float(time[-1])
    step = scale_of(6.0 * (last - first) / 4.0)
    ticks = np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step
    return {
        "left": _LEFT,
        "right": _RIGHT,
        "bottom": bottom,
        "cursor": f"{across[still]:.1f}",
        "restarts": "".join(f"M{x:.1f} {bottom - 4}v8" for x in restarts),
        "ticks": [(f"{np.interp(t, time, across):.1f}", f"{t:g}") for t in ticks],
        "strips": [
            _strip(motion, channel, across, pitch * k, tall)
            for k, channel in enumerate(motion.gaps)
        ],
    }


def _strip(motion: Motion, channel: str, across: Array, top: int, tall: int) -> dict[str, Any]:
    """Curves of a channel, with the smallest and the largest gap as labels."""
    gaps = motion.gaps[channel]
    low = min(0.0, *(float(gap.min()) for gap in gaps.values()))
    high = max(0.0, *(float(gap.max()) for gap in gaps.values()))
    reach = max(high - low, 1e-12)

    def down(gap: Array | float) -> Array:
        return np.asarray(top + _ABOVE + tall * (high - np.asarray(gap)) / reach)

    def curve(gap: Array) -> str:
        return " ".join(f"{x:.1f} {y:.1f}" for x, y in zip(across, down(gap), strict=True))

    edges = {value for value in (low, high, 0.0) if value == 0.0 or abs(value) > 0.2 * reach}
    return {
        "label": formatting.axis_label(gap_label(channel), formatting.channel_unit(channel)),
        "top": top,
        "zero": f"{float(down(0.0)):.1f}",
        "curves": [(_class(motion, kind), curve(gap)) for kind, gap in gaps.items()],
        "marks": [
            (f"{float(down(value)) + 4:.1f}", formatting.short(value, 2)) for value in sorted(edges)
        ],
    }
