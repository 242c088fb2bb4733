"""Added-variable plots: the residual of the refitted model over the contribution of an effect."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pamid.base.schemas.added_variables_file import AddedVariable
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.report.captions import added_leaders, added_line, slope_text, usable_plots
from pamid.report.formatting import capital, channel_label, channel_unit, effect_label, percent
from pamid.report.load import RunData
from pamid.report.markup import prose, tag
from pamid.report.style import (
    Drawing,
    axis,
    channel_axis,
    dots,
    finish,
    label,
    level,
    line,
    notebook_svg,
    page_svg,
    upright,
)

_MARGIN = 1.08
ADDED_NOTE = (
    "Added-variable plots, on the recordings that were fitted. Up: measured less the refitted "
    "model. Across: what the effect adds to the channel at its refitted size. What the other "
    "parameters can make of either is projected out. A missing term is a narrow cloud along the "
    "line; slope 1 is the refitted size of the effect, 0 is no effect."
)


def added_drawing(run: RunData) -> Drawing | None:
    """Points and a line per leading candidate: residual over the contribution of the candidate, in
    the unit of the channel."""
    leaders = added_leaders(run)
    if not leaders or run.diagnosis is None:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        shape = (len(leaders), 1) if narrow else (1, len(leaders))
        panels = figure.subplots(*shape, squeeze=False).flat
        for axes, leader in zip(panels, leaders, strict=True):
            _panel(axes, leader, 44 if narrow else 26)

    title = _title(leaders, run.diagnosis)
    return Drawing("added-variable", title, draw, 2.75, 2.55 * len(leaders))


def single_drawing(plot: AddedVariable, diagnosis: DiagnosisFile) -> Drawing:
    """The plot of a candidate."""

    def draw(figure: Figure, narrow: bool) -> None:
        _panel(figure.subplots(), plot, 0)

    return Drawing(added_place(plot.effect), _title([plot], diagnosis), draw, 2.6, 2.6)


def _title(plots: Sequence[AddedVariable], diagnosis: DiagnosisFile) -> str:
    """ "Coulomb friction explains 98 % of the angle residual, slope 1.00 ± 0.04; offset explains
    1 %, slope 6 ± 5"."""
    first, *others = plots
    text = f"{effect_label(first.effect)} {added_line(first)}"
    for other in others:
        of = "" if other.channel == first.channel else f" of that of {channel_label(other.channel)}"
        text += f"; {effect_label(other.effect)} {percent(other.share)}{of}"
    if len(plots) == 1 and first.effect in {cause.effect for cause in diagnosis.causes}:
        text += "; it is named"
    return capital(text)


def added_panels(run: RunData) -> Markup:
    """A figure per candidate of the ranking; the page shows the chosen candidate."""
    if run.diagnosis is None:
        return Markup("")
    figures = []
    for plot in usable_plots(run):
        if not plot.beside:
            drawing = single_drawing(plot, run.diagnosis)
            svg = tag("div", Markup(page_svg(drawing)), role="img", aria_label=drawing.title)
            look = {"class_": "added-panel", "id": drawing.name, "tabindex": "-1"}
            figures.append(tag("figure", tag("figcaption", prose(drawing.title)), svg, **look))
    hint = tag("p", "Choose a row of the ranking to see its added-variable plot.", class_="note")
    return tag("div", hint, figures, class_="added-panels") if figures else Markup("")


def added_places(run: RunData) -> dict[str, str]:
    """Place of each candidate's plot on the page, by effect."""
    return {plot.effect: added_place(plot.effect) for plot in usable_plots(run) if not plot.beside}


def added_place(effect: str) -> str:
    return f"added-{re.sub('[^a-z0-9]+', '-', effect.lower())}"


def card_svg(run: RunData) -> str:
    """Plot of the leading candidate for a notebook."""
    leaders = added_leaders(run)
    if not leaders or run.diagnosis is None:
        return ""
    drawing = single_drawing(leaders[0], run.diagnosis)
    svg = Markup(notebook_svg(page_svg(drawing)))
    return str(tag("div", tag("p", drawing.title), svg, style="max-width:26em;margin:.5em 0"))


def _panel(axes: Axes, plot: AddedVariable, letters: int) -> None:
    """letters: of the effect's name above the axes."""
    x, y = np.asarray(plot.added), np.asarray(plot.residual)
    wide = _MARGIN * float(np.abs(x).max())
    tall = _MARGIN * (float(np.abs(y).max()) or wide)
    axes.set_xlim(-wide, wide)
    axes.set_ylim(-tall, tall)
    level(axes)
    upright(axes)
    axes.add_patch(dots(x, y, 4e-3 * wide))
    ends = np.array([-wide, wide])
    line(axes, ends, plot.slope * ends, "with_cause", 1.8)
    if letters:
        words = f"{percent(plot.share)}, {slope_text(plot)}"
        title = f"{label(effect_label(plot.effect), letters)}\n{label(words, 40)}"
        axes.set_title(title, loc="left", fontsize=8.5)
    across = axis("added by the effect", channel_unit(plot.channel))
    finish(axes, across, channel_axis(plot.channel, " residual", 22), ticks=5)
    axes.yaxis.set_major_locator(MaxNLocator(6))
