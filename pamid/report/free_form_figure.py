"""The curve of an effect outside the catalogue, as the free form of its family draws it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pamid.report import formatting
from pamid.report.captions import free_form_title
from pamid.report.style import Drawing, colour, grid, label, legend_above
from pamid.schemas.diagnosis_file import DiagnosisFile


def free_form_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Nonparametric curve of the first family over its signal, with the 95 % band."""
    forms = diagnosis.unknown.free_forms if diagnosis.unknown is not None else ()
    curve = forms[0].curve if forms else None
    if curve is None or not curve.x:
        return None
    if not len(curve.x) == len(curve.y) == len(curve.low) == len(curve.high):
        return None  # of a file that was changed
    x, y, low, high = (np.asarray(v) for v in (curve.x, curve.y, curve.low, curve.high))
    turn = int(np.argmax(x)) + 1  # where a loop has come to its upper end

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for k, rows in enumerate((slice(0, turn), slice(turn, None))):
            axes.fill_between(
                x[rows],
                low[rows],
                high[rows],
                color=colour("with_cause"),
                alpha=0.18,
                linewidth=0.0,
                label="" if k else formatting.INTERVAL,
            )
        axes.plot(x, y, color=colour("with_cause"), linewidth=1.8, label=label(curve.shown))
        axes.axhline(0.0, color=colour("muted"), linewidth=0.7)
        over = "time since the step" if curve.signal == "time" else curve.signal
        for put, what, unit in (
            (axes.set_xlabel, formatting.port_label(over), curve.signal_unit),
            (axes.set_ylabel, curve.shown, curve.unit),
        ):
            put(formatting.axis_label(label(what), label(formatting.unit_label(unit))))
        axes.xaxis.set_major_locator(MaxNLocator(5 if narrow else 9))
        grid(axes, "y")
        legend_above(axes, 2)

    return Drawing("free-form", free_form_title(diagnosis, forms[0]), draw, 2.8, 2.8)
