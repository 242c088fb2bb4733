"""The picture of the first paper's test: what every model leaves of the angle on the steps, at both
inertias."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pamid.report.style import Drawing, Picture, colour, grid, legend_above, render

Array = NDArray[np.float64]

#: colours of the models in the order they are drawn
LINE_ROLES = ("data_sheet", "with_network", "with_cause")


def steps_picture(
    time_s: Array, errors: Mapping[str, Mapping[str, Array]], notes: Sequence[str]
) -> Picture:
    """errors: model - measured (samples,), deg, by case and then by model (at most three); notes: a
    remark per case.

    The title states the mean absolute errors of the first and the last model in the last case.
    """
    case, last = list(errors.items())[-1]
    sizes = {model: float(np.abs(values).mean()) for model, values in last.items()}
    first, final = list(sizes)[0], list(sizes)[-1]
    title = (
        f"At {case}, the {first} is off by {sizes[first]:.2f} deg, the {final} by "
        f"{sizes[final]:.2f} deg"
    )

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots(len(errors), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for one, (name, models), note in zip(axes, errors.items(), notes, strict=True):
            for role, (model, values) in zip(LINE_ROLES, models.items(), strict=False):
                one.plot(time_s, values, color=colour(role), linewidth=1.1, label=model)
            one.axhline(0.0, color=colour("ink"), linewidth=0.7)
            grid(one, "y")
            one.set_ylabel(f"{name}\nerror [deg]" if narrow else f"{name} ({note})\nerror [deg]")
        legend_above(axes[0], 1 if narrow else 3)
        axes[-1].set_xlabel("time [s]")

    return render(Drawing("steps", title, draw, 4.2, 4.2))
