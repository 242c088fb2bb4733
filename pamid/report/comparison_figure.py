"""The comparison behind a verdict: losses of the best models, window by window."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from pamid.report import formatting
from pamid.report.formatting import effect_label, percent
from pamid.report.style import Drawing, colour, grid, legend_above
from pamid.schemas.diagnosis_file import ComparisonStep, DiagnosisFile

MOST_CURVES = 4  # that a reader can tell apart by colour and line
_DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (4, 1.5, 1, 1.5)))


def comparison_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Lines over the held-out windows: the loss of the reference and of the confidence set [noise
    floors] of the first step that has one."""
    step = next((candidate for candidate in diagnosis.comparison if candidate.tied), None)
    if step is None or len(step.reference_losses) < 2:
        return None
    shown = step.tied[:MOST_CURVES]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        windows = range(1, len(step.reference_losses) + 1)
        axes.semilogy(
            windows,
            step.reference_losses,
            color=colour("refitted"),
            marker="o",
            markersize=3.5,
            linewidth=1.6,
            label="refitted model" if step.reference == "baseline" else step.reference,
        )
        for entry, dashes in zip(shown, _DASHES, strict=False):
            axes.semilogy(
                windows,
                entry.losses,
                color=colour("with_cause"),
                linestyle=dashes,
                marker="o",
                markersize=3.0,
                linewidth=1.4,
                label=effect_label(entry.effect),
            )
        axes.xaxis.set_major_locator(MaxNLocator(6 if narrow else 12, integer=True))
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: formatting.short(value, 1)))
        axes.set_xlabel("held-out window [-]")
        axes.set_ylabel("error [noise floors]")
        legend_above(axes, 2 if narrow else 3)
        grid(axes, "y")

    return Drawing("comparison", _title(step), draw, 2.6, 2.9)


def _title(step: ComparisonStep) -> str:
    """Title: number of windows in which the first model of the set has the smaller error, and the
    models tied with it."""
    first = step.tied[0]
    fewer = sum(a < b for a, b in zip(first.losses, step.reference_losses, strict=True))
    text = (
        f"{effect_label(first.effect)} lowers the error in {fewer} of {len(first.losses)} held-out "
        f"windows, by {percent(first.removes.share)} of the gap"
    )
    others = [effect_label(candidate.effect) for candidate in step.tied[1:]]
    tied = f"; {formatting.join(others)} cannot be separated from it" if others else ""
    return formatting.sentence(f"{text}{tied}").removesuffix(".")
