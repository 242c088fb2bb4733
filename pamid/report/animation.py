"""A motion as an animated GIF: the arm above, its gaps with a moving cursor below.

The still parts are drawn once; per frame only the moving parts are drawn over them. All frames
share a palette, so that the file stays small.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from pamid.base.errors import DataError
from pamid.report import formatting
from pamid.report.channel_errors import FIELDS
from pamid.report.motion import MEASURED, TRAIL_S, Motion, gap_label, scale_of
from pamid.report.style import (
    Look,
    annotate,
    axis,
    colour,
    dot,
    finish,
    label,
    line,
    settings,
)

ANIMATION_HZ = 25  # frames per second: 4 hundredths of a second each, which every viewer keeps
MOST_FRAMES = 1500
WIDTH_IN, ARM_IN, STRIP_IN = 4.8, (1.3, 3.6), 0.62
COLOURS_KEPT = 32
_MARGIN_IN = 0.62  # left of the strips
TRACE_LINES: dict[str, tuple[float, Any]] = {  # width in points, dashes
    MEASURED: (6.0, "-"),
    "before": (2.2, (0, (3, 1.6))),
    "best": (2.4, "-"),
}


def gif_of(
    motion: Motion,
    width_px: int = 480,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> bytes:
    """The GIF at 25 frames per second, a frame per time of the motion; the same motion gives the
    same bytes.

    DataError above 1500 frames.
    """
    count = motion.time.size
    if count > MOST_FRAMES:
        raise DataError(
            f"{count} frames are too many for a GIF; the limit is {MOST_FRAMES}.",
            "Show a shorter part (--from, --to) or a faster animation (--speed).",
            code="frames",
        )
    with settings("motion"):
        canvas, arm, strips = _stage(motion, width_px)
        draw = _moving(motion, canvas, arm, strips)
        canvas.draw()
        still: Any = canvas.copy_from_bbox(canvas.figure.bbox)
        # a common palette for all frames
        samples = [np.asarray(draw(k, still)) for k in np.linspace(0, count - 1, 4).astype(int)]
        palette = Image.fromarray(np.concatenate(samples)).quantize(
            COLOURS_KEPT, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
        )
        frames = []
        for k in range(count):
            frames.append(draw(k, still).quantize(palette=palette, dither=Image.Dither.NONE))
            progress(k + 1, count)
    buffer = io.BytesIO()
    frames[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=1000 // ANIMATION_HZ,
        loop=0,
        optimize=False,
        disposal=1,
    )
    return buffer.getvalue()


def size_px(gif: bytes) -> tuple[int, int]:
    """Width and height of a picture."""
    with Image.open(io.BytesIO(gif)) as picture:
        return picture.size


def _stage(motion: Motion, width_px: int) -> tuple[FigureCanvasAgg, Axes, list[Axes]]:
    """The picture with its static parts, the panel of the arm, and strips with their curves."""
    low, high = motion.box
    wide, tall = high - low
    arm_in = float(np.clip(WIDTH_IN * tall / wide, *ARM_IN))
    title = textwrap.wrap(label(formatting.clean(motion.title), 300), 62)
    top_in, strips_in = (
        0.12 + 0.18 * len(title) + 0.26,
        0.3 * len(motion.gaps) + STRIP_IN * len(motion.gaps) + 0.42,
    )
    height_in = top_in + arm_in + strips_in
    figure = Figure(
        figsize=(WIDTH_IN, height_in), dpi=width_px / WIDTH_IN, facecolor=colour("paper")
    )
    canvas = FigureCanvasAgg(figure)
    head: Look = {"va": "top", "fontsize": 9.0, "fontweight": "bold", "linespacing": 1.25}
    figure.text(0.1 / WIDTH_IN, 1.0 - 0.08 / height_in, "\n".join(title), **head)
    arm = figure.add_axes((0.0, strips_in / height_in, 1.0, arm_in / height_in))
    _arm(arm, motion, WIDTH_IN / arm_in)
    handles = [Line2D([], [], **_style(motion, kind, 0.6)) for kind in motion.lines]
    figure.legend(
        handles,
        [label(motion.names[kind]) for kind in motion.lines],
        loc="upper left",
        ncols=len(handles),
        bbox_to_anchor=(0.06 / WIDTH_IN, 1.0 - (top_in - 0.3) / height_in),
        borderaxespad=0.0,
        borderpad=0.0,
        handlelength=2.0,
        columnspacing=1.4,
    )
    strips = []
    for k, channel in enumerate(motion.gaps):
        bottom = 0.42 + (len(motion.gaps) - 1 - k) * (STRIP_IN + 0.3)
        place = (
            _MARGIN_IN / WIDTH_IN,
            bottom / height_in,
            1.0 - (_MARGIN_IN + 0.15) / WIDTH_IN,
            STRIP_IN / height_in,
        )
        strips.append(
            _strip(figure.add_axes(place), motion, channel, last=k == len(motion.gaps) - 1)
        )
    return canvas, arm, strips


def _arm(axes: Axes, motion: Motion, aspect: float) -> None:
    """Pivots and a scale; the box widened to the panel's aspect (width over height)."""
    low, high = motion.box
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    half = np.maximum(half, [half[1] * aspect, half[0] / aspect])
    axes.set_axis_off()
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    pivot: Look = {"markeredgecolor": colour("muted"), "markeredgewidth": 0.8, "zorder": 0}
    dot(axes, motion.pivots[:, 0], motion.pivots[:, 1], "line", 11.0, **pivot)
    length = scale_of(2.0 * float(half.max()))
    x, y = middle + half * np.array([-0.94, -0.9])
    line(axes, [x, x + length], [y, y], "muted", 1.6, solid_capstyle="butt")
    annotate(axes, f"{length:g} m", (x, y), (0, 3), "muted", 8.0, va="baseline")


def _strip(axes: Axes, motion: Motion, channel: str, last: bool) -> Axes:
    """The gaps of a channel over time; strokes where the models were set to the measured state."""
    for kind, gap in motion.gaps[channel].items():
        axes.plot(motion.time, gap, **_style(motion, kind, 0.5))
    axes.axhline(0.0, color=colour("muted"), linewidth=0.7, zorder=0)
    axes.margins(x=0.0, y=0.12)
    on_axis: Look = {"transform": axes.get_xaxis_transform(), "marker": "|", "clip_on": False}
    dot(axes, motion.restarts, np.zeros(motion.restarts.size), "muted", 5.0, **on_axis)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.tick_params(labelsize=7.5, labelbottom=last)
    finish(axes)
    what = axis(gap_label(channel), formatting.channel_unit(channel), 44)
    axes.set_title(what, loc="left", fontsize=8.0, color=colour("muted"), pad=3.0)
    if last:
        words = "time [s]; at the marks the models were set to the measured state"
        axes.set_xlabel(words, fontsize=8.0, labelpad=1.0)
    return axes


def _style(motion: Motion, kind: str, slim: float = 1.0) -> dict[str, Any]:
    """Colour, width and dashes of a kind's lines."""
    width, dashes = TRACE_LINES[motion.rank(kind)]
    return {
        "linewidth": slim * width,
        "linestyle": dashes,
        "color": colour(FIELDS.get(kind, "ink")),
        "solid_capstyle": "round",
        "solid_joinstyle": "round",
        "dash_capstyle": "butt",
    }


def _moving(
    motion: Motion, canvas: FigureCanvasAgg, arm: Axes, strips: list[Axes]
) -> Callable[[int, Any], Image.Image]:
    """Create the moving artists; return a function that draws a frame over the still picture."""
    tips = {kind: motion.tip(kind) for kind in (MEASURED, motion.best)}
    trails, arms = {}, []
    for kind in tips:
        look: Look = {"color": _style(motion, kind)["color"], "linewidth": 1.0, "alpha": 0.55}
        (trails[kind],) = arm.plot([], [], animated=True, **look)
    for kind, lines in motion.lines.items():
        look = {"marker": "o" if kind == MEASURED else "", "markersize": 7.0}
        for points in lines:
            (artist,) = arm.plot([], [], animated=True, **look, **_style(motion, kind))
            arms.append((points, artist))
    cursors = [
        axes.axvline(motion.time[0], color=colour("ink"), linewidth=0.9, animated=True)
        for axes in strips
    ]
    clock = arm.text(
        0.98, 0.04, "", transform=arm.transAxes, ha="right", fontsize=9.0, animated=True
    )
    every: list[tuple[Axes, Artist]] = [
        *((arm, item) for item in (*trails.values(), *(a for _, a in arms), clock)),
        *zip(strips, cursors, strict=True),
    ]
    back = np.searchsorted(motion.time, motion.time - TRAIL_S)

    def draw(k: int, still: Any) -> Image.Image:
        canvas.restore_region(still)  # type: ignore[no-untyped-call]
        for kind, trail in trails.items():
            trail.set_data(*tips[kind][back[k] : k + 1].T)
        for points, artist in arms:
            artist.set_data(*points[k].T)
        for cursor in cursors:
            cursor.set_xdata([motion.time[k]] * 2)
        clock.set_text(f"{motion.time[k]:.2f} s")
        for axes, drawn in every:
            axes.draw_artist(drawn)
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())

    return draw
