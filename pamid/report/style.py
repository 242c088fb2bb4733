"""How the figures look, and how one drawing becomes a PNG file and two SVG texts that follow the
page's colours.

Colours are those of Okabe and Ito (2008), distinguishable with any colour vision; every bar and
line is named as well. In the SVG each colour is replaced by a variable of the page, so that one
picture serves light and dark.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any
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
from numpy.typing import NDArray
from PIL import Image

from pamid.recording.plot import NotebookFigure
from pamid.report.formatting import clean

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
_STYLE_ATTRIBUTE = re.compile(r'style="[^"]*"')
_NAMED_GROUP = re.compile(r'<g id="[A-Za-z]+[A-Za-z0-9_.]*">')
_EMPTY_GROUP = re.compile(r'<g id="[A-Za-z0-9_.]+"\s*/>')  # of a line without a point in view
_SVG_FONT = re.compile(r"'DejaVu Sans'(, [^;\"]*)?")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_SHEET = re.compile(r"<style[^>]*>.*?</style>", re.DOTALL)  # what page.css says for all drawings
_PATH = re.compile(r' d="[^"]*"')
_LONG_NUMBER = re.compile(r"\d+\.\d{3,}")
_SIZE = re.compile(r'<svg [^>]*viewBox="([^"]*)"[^>]*>')


@dataclass(frozen=True)
class Drawing:
    """Drawing and its size: `draw(figure, narrow)` fills an empty figure; heights in inches;
    `title` states a finding; own: SVG for pages, wide and narrow, drawn in place of the figure,
    with links in it; tips: tooltip of a group by its id; leads: the figure of the page that a click
    on a group shows."""

    name: str
    title: str
    draw: Callable[[Figure, bool], None]
    height: float
    narrow_height: float
    own: tuple[str, str] | None = None
    tips: tuple[tuple[str, str], ...] = ()
    leads: tuple[tuple[str, str], ...] = ()


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
    wide = _svg(drawing, narrow=False)
    narrow = "" if drawing.own else _svg(drawing, narrow=True)
    shown = drawing.own or (_for_page(wide, drawing), _for_page(narrow, drawing))
    return Picture(
        name=drawing.name,
        title=drawing.title,
        wide=shown[0],
        narrow=shown[1],
        png=png_of(drawing),
        linked=drawing.own is not None,
    )


def colour(role: str) -> str:
    """The colour of a role as the figures are drawn (light)."""
    return COLOURS[role][0]


def label(text: str, longest: int = 34) -> str:
    """Text for a figure: one line, not too long, only characters of the font."""
    known = _letters()
    shown = "".join(
        letter if letter in known else "\ufffd" for letter in clean(text).replace("\u00a0", " ")
    )
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def grid(axes: Axes, axis: str = "x") -> None:
    """Thin lines across the axis that is read."""
    axes.grid(visible=True, axis="x" if axis == "x" else "y")


def bare(axes: Axes) -> None:
    """Remove the line and the ticks at the names of bars."""
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0, labelcolor=colour("ink"))


def legend_above(axes: Axes, columns: int) -> None:
    """The legend between the title and the axes, where it hides nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        handlelength=1.8,
        columnspacing=1.2,
        borderaxespad=0.3,
        borderpad=0.0,
    )


def dots(x: NDArray[np.float64], y: NDArray[np.float64], length: float) -> PathPatch:
    """Round dots at these points as one path, a tenth of the size of as many markers. The axes are
    not scaled to them. length: across, too short to be seen; no renderer draws a line of none."""
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
    """Settings of matplotlib that override the user's matplotlibrc; salt: seed of the names in an
    SVG."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a matplotlibrc of the user's must not change the report
        matplotlib.rcParams.update({**DRAWING_SETTINGS, "svg.hashsalt": salt})
        yield


def page_svg(drawing: Drawing) -> str:
    """The narrow form alone, for a page."""
    return _for_page(_svg(drawing, narrow=True), drawing)


def _svg(drawing: Drawing, *, narrow: bool) -> str:
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
    text = buffer.getvalue()
    return text[text.index("<svg") :]


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
    """Drawings with their titles, one below the other, as a PNG file; the same drawings give the
    same bytes."""
    images = [_image(drawing) for drawing in drawings]
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


def _image(drawing: Drawing) -> Image.Image:
    with settings(drawing.name):
        buffer = io.BytesIO()
        figure_of(drawing).savefig(buffer, format="png", dpi=PNG_DPI, facecolor=colour("paper"))
    return Image.open(buffer).convert("RGB")


def _for_page(svg: str, drawing: Drawing) -> str:
    """SVG without comments, metadata, rules and repeated ids, with tooltips, and with colours and
    font of the page."""
    for group, tip in drawing.tips:
        head = f'<g id="{group}">'
        svg = svg.replace(head, f"{head}<title>{escape(tip)}</title>")
    for group, figure in drawing.leads:
        svg = svg.replace(f'<g id="{group}">', f'<g data-figure="{figure}">')
    svg = _SHEET.sub("", _METADATA.sub("", _COMMENT.sub("", svg)))
    svg = _NAMED_GROUP.sub("<g>", _EMPTY_GROUP.sub("", svg))
    svg = _STYLE_ATTRIBUTE.sub(lambda style: _page_style(style.group()), svg)
    svg = _SIZE.sub(
        r'<svg viewBox="\1" xmlns:xlink="http://www.w3.org/1999/xlink" aria-hidden="true">',
        svg,
        count=1,
    )
    svg = _PATH.sub(lambda path: _LONG_NUMBER.sub(_hundredths, path.group()), svg)
    return "\n".join(line.strip() for line in svg.splitlines() if line.strip())


def _hundredths(number: re.Match[str]) -> str:
    """A coordinate [pt] as exactly as a screen can show it."""
    return f"{float(number.group()):.2f}"


def _page_style(style: str) -> str:
    for role, (light, _) in COLOURS.items():
        style = style.replace(light, f"var(--{role.replace('_', '-')})")
    return _SVG_FONT.sub("var(--font)", style)


@lru_cache(maxsize=1)
def _letters() -> frozenset[str]:
    font = FT2Font(findfont(FontProperties(family="DejaVu Sans")))
    return frozenset(chr(code) for code in font.get_charmap())
