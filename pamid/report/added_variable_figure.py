"""Added-variable plots: the residual of the refitted model over the contribution of an effect."""

from __future__ import annotations

import re

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pamid.report import formatting
from pamid.report.captions import added_title, added_words
from pamid.report.load import RunData
from pamid.report.markup import prose, tag
from pamid.report.style import Drawing, colour, dots, grid, label, page_svg
from pamid.schemas.added_variables_file import AddedVariable
from pamid.schemas.diagnosis_file import DiagnosisFile

MOST_LEADERS = 3
_MARGIN = 1.08
_ROLE = re.compile(r"var\(--([a-z-]+)\)")
ADDED_NOTE = (
    "Added-variable plots, on the recordings that were fitted. Up: measured less the refitted "
    "model. Across: what the effect adds to the channel at its refitted size. What the other "
    "parameters can make of either is projected out. A missing term is a narrow cloud along the "
    "line; slope 1 is the refitted size of the effect, 0 is no effect."
)


def added_leaders(run: RunData) -> list[AddedVariable]:
    """The plots shown at once: those of the causes, then of the best candidate of each further
    family, three in all."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return []
    plots = {
        (usable_plot.effect, bool(usable_plot.beside)): usable_plot
        for usable_plot in reversed(usable_plots(run))
    }
    families = {item.effect: item.family for item in diagnosis.ranking}
    families |= {item.effect: item.family for item in diagnosis.causes}
    together = any(company for _, company in plots)
    leaders = [
        plots[key]
        for cause in diagnosis.causes
        for key in [(cause.effect, together and diagnosis.verdict != "ambiguous")]
        if key in plots
    ]
    for candidate in diagnosis.ranking:
        seen = {families.get(leader.effect) for leader in leaders}
        plot = plots.get((candidate.effect, False))
        if plot is not None and candidate.family not in seen:
            leaders.append(plot)
    return leaders[:MOST_LEADERS]


def usable_plots(run: RunData) -> list[AddedVariable]:
    """Plots of a run with two points or more."""
    plots = run.added.plots if run.added is not None else ()
    return [
        plot for plot in plots if len(plot.added) == len(plot.residual) >= 2 and any(plot.added)
    ]


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

    title = added_title(leaders, run.diagnosis)
    return Drawing("added-variable", title, draw, 2.75, 2.55 * len(leaders))


def single_drawing(plot: AddedVariable, diagnosis: DiagnosisFile) -> Drawing:
    """The plot of one candidate."""

    def draw(figure: Figure, narrow: bool) -> None:
        _panel(figure.subplots(), plot, 0)

    return Drawing(added_place(plot.effect), added_title([plot], diagnosis), draw, 2.6, 2.6)


def added_panels(run: RunData) -> Markup:
    """A figure per candidate of the ranking, of which the page shows the one that is chosen."""
    if run.diagnosis is None:
        return Markup("")
    alone = [usable_plot for usable_plot in usable_plots(run) if not usable_plot.beside]
    figures = [
        tag(
            "figure",
            tag("figcaption", prose(drawing.title)),
            tag("div", Markup(page_svg(drawing)), role="img", aria_label=drawing.title),
            class_="added-panel",
            id=added_place(plot.effect),
            tabindex="-1",
        )
        for plot in alone
        for drawing in [single_drawing(plot, run.diagnosis)]
    ]
    hint = tag("p", "Choose a row of the ranking to see its added-variable plot.", class_="note")
    return tag("div", hint, figures, class_="added-panels") if figures else Markup("")


def added_places(run: RunData) -> dict[str, str]:
    """Place of each candidate's plot on the page, by effect."""
    return {
        usable_plot.effect: added_place(usable_plot.effect)
        for usable_plot in usable_plots(run)
        if not usable_plot.beside
    }


def added_place(effect: str) -> str:
    return f"added-{re.sub('[^a-z0-9]+', '-', effect.lower())}"


def card_svg(run: RunData) -> str:
    """Plot of the leading candidate for a notebook, in the text colour of its surroundings."""
    leaders = added_leaders(run)
    if not leaders or run.diagnosis is None:
        return ""
    drawing = single_drawing(leaders[0], run.diagnosis)
    svg = page_svg(drawing)
    plain = {"ink": "currentColor", "muted": "currentColor", "font": "sans-serif"}
    svg = _ROLE.sub(lambda m: plain.get(m[1]) or colour(m[1].replace("-", "_")), svg)
    title = tag("p", drawing.title)
    return str(tag("div", title, Markup(svg), style="max-width:26em;margin:.5em 0"))


def _panel(axes: Axes, plot: AddedVariable, letters: int) -> None:
    """letters: of the effect's name above the axes."""
    x, y = np.asarray(plot.added), np.asarray(plot.residual)
    wide = _MARGIN * float(np.abs(x).max())
    tall = _MARGIN * (float(np.abs(y).max()) or wide)
    axes.set_xlim(-wide, wide)
    axes.set_ylim(-tall, tall)
    axes.axhline(0.0, color=colour("muted"), linewidth=0.7)
    axes.axvline(0.0, color=colour("muted"), linewidth=0.7)
    axes.add_patch(dots(x, y, 4e-3 * wide))
    ends = np.array([-wide, wide])
    axes.plot(ends, plot.slope * ends, color=colour("with_cause"), linewidth=1.8)
    unit = label(formatting.channel_unit(plot.channel))
    what = label(formatting.channel_label(plot.channel), 22)
    if letters:
        axes.set_title(
            f"{label(formatting.effect_label(plot.effect), letters)}\n"
            f"{label(added_words(plot), 40)}",
            loc="left",
            fontsize=8.5,
        )
    axes.set_xlabel(formatting.axis_label("added by the effect", unit))
    axes.set_ylabel(formatting.axis_label(f"{what} residual", unit))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(6))
    grid(axes, "y")
