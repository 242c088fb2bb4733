"""How the figures look, and how a drawing becomes a PNG file and two SVG texts that follow the
page's colours.

Colours are those of Okabe and Ito (2008), distinguishable with any colour vision; every bar and
line is named as well. In the SVG each colour is replaced by a variable of the page, so that a
single picture serves light and dark.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias
from xml.sax.saxutils import escape

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font
from matplotlib.patches import PathPatch
from matplotlib.path import Path as OutlinePath
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from pamid.recording.plot import NotebookFigure
from pamid.report.formatting import axis_label, channel_label, channel_unit, clean

#: role -> colour on a light and on a dark page
COLOURS = {
    "ink": ("#1b1f24", "#e6e8eb"),
    "muted": ("#59616b", "#a3abb5"),
    "line": ("#dfe3e8", "#343a42"),
    "paper": ("#ffffff", "#15181c"),
    "data_sheet": ("#8d959f", "#868e98"),
    "refitted": ("#0072b2", "#56b4e9"),
    "with_cause": ("#d55e00", "#f0883e"),
    "with_network": ("#009e73", "#2fc79a"),
    "noise_floor": ("#b9c0c8", "#5b636d"),
    "faint": ("#eef0f3", "#22272d"),
}
Look: TypeAlias = dict[str, Any]  # settings of an artist of matplotlib

WIDE_IN, NARROW_IN = 7.4, 3.7
PNG_DPI = 160
DRAWING_SETTINGS: dict[Any, Any] = {
    "text.parse_math": False,  # a name with dollar signs is a name
    "svg.fonttype": "none",
    "font.family": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.edgecolor": COLOURS["muted"][0],
    "axes.labelcolor": COLOURS["muted"][0],
    "axes.titlecolor": COLOURS["ink"][0],
    "axes.facecolor": "none",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "grid.color": COLOURS["line"][0],
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.labelcolor": COLOURS["ink"][0],
    "text.color": COLOURS["ink"][0],
    "xtick.color": COLOURS["muted"][0],
    "ytick.color": COLOURS["muted"][0],
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
}
_ROLE = re.compile(r"var\(--([a-z-]+)\)")
_STYLE_ATTRIBUTE = re.compile(r'style="[^"]*"')
_NAMED_GROUP = re.compile(r'<g id="[A-Za-z]+[A-Za-z0-9_.]*">')
_EMPTY_GROUP = re.compile(r'<g id="[A-Za-z0-9_.]+"\s*/>')  # of a line without a point in view
_SVG_FONT = re.compile(r"'DejaVu Sans'(, [^;\"]*)?")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_SHEET = re.compile(r"<style[^>]*>.*?</style>", re.DOTALL)  # page.css sets it for all drawings
_PATH = re.compile(r' d="[^"]*"')
_LONG_NUMBER = re.compile(r"\d+\.\d{3,}")
_SIZE = re.compile(r'<svg [^>]*viewBox="([^"]*)"[^>]*>')


@dataclass(frozen=True)
class Drawing:
    """Drawing and its size: `draw(figure, narrow)` fills an empty figure; heights in inches;
    `title` states a finding; tips: tooltip of a group by its id; leads: the figure of the page that
    a click on a group shows; linked: whether the SVG has links in it."""

    name: str
    title: str
    draw: Callable[[Figure, bool], None]
    height: float
    narrow_height: float
    tips: tuple[tuple[str, str], ...] = ()
    leads: tuple[tuple[str, str], ...] = ()
    linked: bool = False


@dataclass(frozen=True)
class Picture:
    """A drawing carried out. wide, narrow: SVG for pages, in their colours; png: with its title,
    for papers and slides; linked: whether parts of the SVG can be chosen."""

    name: str
    title: str
    wide: str
    narrow: str
    png: bytes
    linked: bool = False


def render(drawing: Drawing) -> Picture:
    """Carry out a drawing; the same drawing gives the same bytes."""
    return Picture(
        name=drawing.name,
        title=drawing.title,
        wide=page_svg(drawing, narrow=False),
        narrow=page_svg(drawing),
        png=png_of(drawing),
        linked=drawing.linked,
    )


def colour(role: str) -> str:
    """The colour of a role as the figures are drawn (light)."""
    return COLOURS[role][0]


def label(text: str, longest: int = 34) -> str:
    """Text for a figure: a line, not too long, only characters of the font."""
    known = _letters()
    shown = "".join(
        letter if letter in known else "\ufffd" for letter in clean(text).replace("\u00a0", " ")
    )
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def axis(what: str, unit_text: str, longest: int = 34) -> str:
    """ "angle [deg]"."""
    return axis_label(label(what, longest), label(unit_text))


def channel_axis(channel: str, after: str = "", longest: int = 34) -> str:
    """The axis of a column: "pressure 1 error [kPa]"; after: " error"."""
    what = label(channel_label(channel), longest)
    return axis_label(f"{what}{after}", label(channel_unit(channel)))


def finish(
    axes: Axes,
    x: str = "",
    y: str = "",
    *,
    lines: str = "y",
    legend: int = 0,
    ticks: int = 0,
) -> None:
    """Labels with units, thin lines across the axis that is read, and a legend where it hides
    nothing. legend: its columns; ticks: most of them along x."""
    if x:
        axes.set_xlabel(x)
    if y:
        axes.set_ylabel(y)
    if ticks:
        axes.xaxis.set_major_locator(MaxNLocator(ticks))
    if lines:
        axes.grid(visible=True, axis="x" if lines == "x" else "y")
    if legend:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=legend,
            handlelength=1.8,
            columnspacing=1.2,
            borderaxespad=0.3,
            borderpad=0.0,
        )


def line(
    axes: Axes, x: Any, y: Any, role: str, width: float = 1.5, dashes: Any = "-", **more: Any
) -> None:
    """A curve in the colour of a role."""
    axes.plot(x, y, color=colour(role), linewidth=width, linestyle=dashes, **more)


def dot(axes: Axes, x: Any, y: Any, role: str, size: float = 5.0, **more: Any) -> None:
    """A marker in the colour of a role."""
    shape: Look = {"marker": "o", "linestyle": "none"} | more
    axes.plot(x, y, markersize=size, color=colour(role), **shape)


def bar(axes: Axes, row: float, size: float, role: str, height: float = 0.6, **more: Any) -> None:
    """A bar to the right in the colour of a role."""
    axes.barh(row, size, height=height, color=colour(role), **{"linewidth": 0.0, **more})


def level(axes: Axes, y: float = 0.0, role: str = "muted", width: float = 0.7) -> None:
    """A thin line across the axes."""
    axes.axhline(y, color=colour(role), linewidth=width)


def upright(axes: Axes) -> None:
    """A thin line up the axes at 0."""
    axes.axvline(0.0, color=colour("muted"), linewidth=0.7)


def write(
    axes: Axes, x: float, y: float, words: str, role: str = "ink", size: float = 8.5, **more: Any
) -> None:
    """Text at a place of the axes, also outside them."""
    shape: Look = {"va": "center", "clip_on": False} | more
    axes.text(x, y, words, fontsize=size, color=colour(role), **shape)


def annotate(
    axes: Axes,
    words: str,
    place: tuple[float, float],
    shift: tuple[float, float],
    role: str = "ink",
    size: float = 8.5,
    **more: Any,
) -> None:
    """Text that is shifted by some points from a place of the axes."""
    shape: Look = {"va": "center", "textcoords": "offset points"} | more
    axes.annotate(words, place, xytext=shift, fontsize=size, color=colour(role), **shape)


def name_rows(axes: Axes, names: Sequence[str], longest: int = 34) -> None:
    """Names next to the rows 0, 1, ... from the top."""
    lines = ["\n".join(label(part, longest) for part in name.split("\n")) for name in names]
    axes.set_yticks(range(len(names)), lines)
    axes.set_ylim(len(names) - 0.4, -0.6)
    bare(axes)


def bare(axes: Axes) -> None:
    """Remove the line and the ticks at the names of bars."""
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0, labelcolor=colour("ink"))


def dots(x: NDArray[np.float64], y: NDArray[np.float64], length: float) -> PathPatch:
    """Round dots at these points as a single path, a tenth of the size of as many markers. The axes
    are not scaled to them. length: across, too short to be seen; no renderer draws a line of
    none."""
    half = 0.5 * length
    ends = np.stack([x - half, y, x + half, y], axis=1).reshape(-1, 2)
    path = OutlinePath(ends, np.tile([OutlinePath.MOVETO, OutlinePath.LINETO], len(x)))
    path.should_simplify = False  # which would drop lines as short as these
    return PathPatch(
        path,
        fill=False,
        edgecolor=colour("refitted"),
        linewidth=2.6,
        alpha=0.55,
        capstyle="round",
        snap=False,
    )


@contextmanager
def settings(salt: str) -> Iterator[None]:
    """Settings of matplotlib in place of the user's; salt: seed of the names in an SVG."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a matplotlibrc of the user's must not change the report
        matplotlib.rcParams.update({**DRAWING_SETTINGS, "svg.hashsalt": salt})
        yield


def notebook_svg(svg: str) -> str:
    """A drawing of a page in the text colour of its surroundings."""
    plain = {"ink": "currentColor", "muted": "currentColor", "font": "sans-serif"}
    return _ROLE.sub(lambda m: plain.get(m[1]) or colour(m[1].replace("-", "_")), svg)


def page_svg(drawing: Drawing, *, narrow: bool = True) -> str:
    """The drawing for a page: SVG without comments, metadata, rules and repeated ids, with
    tooltips, and with colours and font of the page."""
    with settings(f"{drawing.name}-{'narrow' if narrow else 'wide'}"):
        size = (NARROW_IN, drawing.narrow_height) if narrow else (WIDE_IN, drawing.height)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        drawing.draw(figure, narrow)
        buffer = io.StringIO()
        figure.savefig(
            buffer,
            format="svg",
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    for group, tip in drawing.tips:
        head = f'<g id="{group}">'
        svg = svg.replace(head, f"{head}<title>{escape(tip)}</title>")
    for group, figure_place in drawing.leads:
        svg = svg.replace(f'<g id="{group}">', f'<g data-figure="{figure_place}">')
    svg = _SHEET.sub("", _METADATA.sub("", _COMMENT.sub("", svg)))
    svg = _NAMED_GROUP.sub("<g>", _EMPTY_GROUP.sub("", svg))
    svg = _STYLE_ATTRIBUTE.sub(lambda style: _page_style(style.group()), svg)
    hidden = "" if drawing.linked else ' aria-hidden="true"'
    head = rf'<svg viewBox="\1" xmlns:xlink="http://www.w3.org/1999/xlink"{hidden}>'
    svg = _PATH.sub(
        # as exactly as a screen can show a coordinate [pt]
        lambda path: _LONG_NUMBER.sub(lambda x: f"{float(x.group()):.2f}", path.group()),
        _SIZE.sub(head, svg, 1),
    )
    return "\n".join(line.strip() for line in svg.splitlines() if line.strip())


def figure_of(drawing: Drawing) -> NotebookFigure:
    """The drawing as a separate figure with its title."""
    with settings(drawing.name):
        lines = textwrap.wrap(label(drawing.title, 400), 88)
        figure = NotebookFigure(
            figsize=(WIDE_IN, drawing.height + 0.2 + 0.19 * len(lines)), layout="constrained"
        )
        drawing.draw(figure, False)
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def png_of(*drawings: Drawing) -> bytes:
    """Drawings with their titles, stacked, as a PNG file; the same ones give the same bytes."""
    images = []
    for drawing in drawings:
        with settings(drawing.name):
            file = io.BytesIO()
            figure_of(drawing).savefig(file, format="png", dpi=PNG_DPI, facecolor=colour("paper"))
        images.append(Image.open(file).convert("RGB"))
    size = max(item.width for item in images), sum(item.height for item in images)
    sheet, top = Image.new("RGB", size, colour("paper")), 0
    for image in images:
        sheet.paste(image, (0, top))
        top += image.height
    # a third of the size; an octree keeps rare colours, which a median cut would mix
    palette = sheet.quantize(method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    palette.save(buffer, format="png", optimize=True, dpi=(PNG_DPI, PNG_DPI))
    return buffer.getvalue()


def _page_style(style: str) -> str:
    for role, (light, _) in COLOURS.items():
        style = style.replace(light, f"var(--{role.replace('_', '-')})")
    return _SVG_FONT.sub("var(--font)", style)


@lru_cache(maxsize=1)
def _letters() -> frozenset[str]:
    font = FT2Font(findfont(FontProperties(family="DejaVu Sans")))
    return frozenset(chr(code) for code in font.get_charmap())
