"""The figures of a run: those of its report, each separately."""

from __future__ import annotations

from collections.abc import Callable

from pamid.base.errors import DataError, UsageError, nearest
from pamid.recording.plot import NotebookFigure
from pamid.report.added_variable_figure import added_drawing, single_drawing, usable_plots
from pamid.report.channel_errors import errors_of, headline, worst_window
from pamid.report.evidence_figures import training_drawing
from pamid.report.figures import budget_drawing, ports_drawing, ranking_drawing, window_drawing
from pamid.report.load import RunData
from pamid.report.rig_figure import rig_drawing
from pamid.report.style import Drawing, figure_of, png_of

PLOTTED_MODELS = ("data_sheet", "refitted", "cause", "network")
#: content of a figure -> its drawing, None where the run does not hold it
_DRAWINGS: dict[str, Callable[[RunData], Drawing | None]] = {
    "held-out errors": lambda run: budget_drawing(errors_of(run), run.diagnosis),
    "ports of its rig": lambda run: rig_drawing(run.diagnosis),
    "added-variable plots": added_drawing,
    "shares of ports": lambda run: ports_drawing(run.diagnosis) if run.diagnosis else None,
    "candidates that were refitted": lambda run: (
        ranking_drawing(run.diagnosis) if run.diagnosis else None
    ),
    "course of a training": lambda run: (
        training_drawing(run.trace, run.network) if run.trace is not None else None
    ),
}


def figure(run: RunData, content: str) -> NotebookFigure:
    """Figure of a run; DataError where the run does not hold its content."""
    return figure_of(_drawing(run, content))


def png(run: RunData, content: str) -> bytes:
    """The same as a PNG file."""
    return png_of(_drawing(run, content))


def _drawing(run: RunData, content: str) -> Drawing:
    drawing = _DRAWINGS[content](run)
    if drawing is None:
        raise DataError(
            f"This run contains no {content}.", "`pamid.report` shows all results of the run."
        )
    return drawing


def overview_png(run: RunData) -> bytes:
    """The rig's diagram, and below it the added-variable plots where the run holds them."""
    rig, added = _drawing(run, "ports of its rig"), added_drawing(run)
    return png_of(rig, added) if added is not None else png_of(rig)


def worst_window_figure(run: RunData, channel: str | None = None) -> NotebookFigure:
    """UsageError for a channel that the run does not have, DataError where no window was scored."""
    row = headline(errors_of(run))
    known = run.fit.channels if run.fit is not None else ()
    chosen = channel or (row.channel if row is not None else "")
    if channel is not None and channel not in known:
        raise UsageError(
            f"The run has no channel {channel!r}.",
            nearest(channel, known) or f"There are {', '.join(known)}.",
        )
    window = worst_window(run.residual, chosen) if run.residual is not None else None
    if run.residual is None or window is None:
        raise DataError(
            "No window of this run was scored.", "See the scored samples in residual.csv."
        )
    kinds = tuple(kind for kind in PLOTTED_MODELS if run.residual.of(chosen, kind) is not None)
    return figure_of(window_drawing(run, run.residual, chosen, window, kinds))


def added_variable_figure(run: RunData, effect: str | None = None) -> NotebookFigure:
    """The plots of the leading candidates, or that of a named effect; UsageError for an effect that
    the run holds none of."""
    plots = {usable_plot.effect: usable_plot for usable_plot in usable_plots(run)}
    at_ports = [name for name in plots if name.partition("@")[0] == effect]
    if effect not in plots and len(at_ports) == 1:
        (effect,) = at_ports
    if effect is not None and plots and effect not in plots:
        raise UsageError(
            f"The run has no added-variable plot of {effect!r}.",
            nearest(effect, plots) or f"There are {', '.join(plots)}.",
        )
    if effect is None or run.diagnosis is None or effect not in plots:
        return figure(run, "added-variable plots")
    return figure_of(single_drawing(plots[effect], run.diagnosis))
