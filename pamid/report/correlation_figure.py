"""Correlations of the fitted parameters as a heat map, which show parameters that cannot be
separated."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pamid.report import formatting
from pamid.report.reading import FloatArray
from pamid.report.style import Drawing, colour, label
from pamid.schemas.fit_file import FitFile, Posterior

_MOST, _FEWEST, _WRITTEN, _STRONG = 14, 3, 0.3, 0.9
_BACKGROUND = "background."


def correlation_drawing(fit: FitFile | None) -> Drawing | None:
    """Cells: the correlation of two fitted parameters [-], written where it is 0.3 or more; None
    where fewer than three were fitted, or none is as large. Background terms are left out, and of
    many parameters those stay that are correlated most."""
    posterior = fit.posterior if fit is not None else None
    if posterior is None:
        return None
    names, correlations = _correlations(posterior)
    if len(names) < _FEWEST or np.abs(np.tril(correlations, -1)).max() < _WRITTEN:
        return None  # the sentence says all of it

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        count = len(names)
        for row in range(1, count):
            for column in range(row):
                _cell(axes.add_patch, row, column, float(correlations[row, column]))
                written = abs(correlations[row, column]) >= _WRITTEN
                if written:
                    axes.text(
                        column,
                        row,
                        f"{correlations[row, column]:.2f}".replace("-", formatting.MINUS),
                        ha="center",
                        va="center",
                        fontsize=6.0 if narrow or count > 9 else 8.0,
                        color=colour("ink"),
                    )
        shown = [label(formatting.port_label(name), 22) for name in names]
        axes.set_yticks(range(1, count), shown[1:])
        axes.set_xticks(
            range(count - 1), shown[:-1], rotation=40, ha="right", rotation_mode="anchor"
        )
        axes.set_xlim(-0.5, count - 1.5)
        axes.set_ylim(count - 0.5, 0.5)
        axes.tick_params(length=0, labelsize=7.5 if narrow else 8.5)
        for side in ("left", "bottom"):
            axes.spines[side].set_visible(False)

    tall = 1.2 + 0.3 * len(names)
    return Drawing("correlation", correlation_title(names, correlations), draw, tall, tall + 0.3)


def correlation_note(fit: FitFile | None) -> str:
    """Sentence in place of a picture that would be one cell, or empty cells."""
    if fit is None or fit.posterior is None or correlation_drawing(fit) is not None:
        return ""
    names, correlations = _correlations(fit.posterior)
    return f"{correlation_title(names, correlations)}." if len(names) > 1 else ""


def _cell(add, row: int, column: int, value: float) -> None:  # type: ignore[no-untyped-def]
    add(
        Rectangle(
            (column - 0.47, row - 0.47),
            0.94,
            0.94,
            facecolor=colour("with_cause" if value > 0.0 else "refitted"),
            alpha=0.75 * abs(value),
            linewidth=0.0,
        )
    )


def correlation_title(names: list[str], correlations: FloatArray) -> str:
    """ "mass and gain go together (correlation 0.98): the data fix them only in combination"."""
    apart = np.abs(np.tril(correlations, -1))
    row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
    value = f"{correlations[row, column]:.2f}".replace("-", formatting.MINUS)
    pair = f"{formatting.port_label(names[row])} and {formatting.port_label(names[column])}"
    if apart.max() >= _STRONG:
        return f"{pair} are hard to tell apart: correlation {value}"
    return f"No two parameters are tied: the largest correlation is {value}, of {pair}"


def _correlations(posterior: Posterior) -> tuple[list[str], FloatArray]:
    """Names of the rig's parameters and their correlations (n, n); empty if the covariance does not
    fit its names."""
    size = len(posterior.keys)
    if [len(row) for row in posterior.covariance] != list(range(1, size + 1)):
        return [], np.zeros((0, 0))
    lower = np.zeros((size, size))
    for k, row in enumerate(posterior.covariance):
        lower[k, : k + 1] = row
    whole = lower + np.tril(lower, -1).T
    spread = np.sqrt(np.maximum(np.diag(whole), 0.0))
    indices = [
        k
        for k, name in enumerate(posterior.keys)
        if not name.startswith(_BACKGROUND) and spread[k] > 0.0
    ]
    if len(indices) < 2:
        return [], np.zeros((0, 0))
    correlations = (whole / np.where(spread > 0.0, spread, 1.0)).T / np.where(
        spread > 0.0, spread, 1.0
    )
    correlations = np.clip(correlations[np.ix_(indices, indices)], -1.0, 1.0)
    if len(indices) > _MOST:
        strength = np.sort(np.abs(correlations - np.eye(len(indices))), axis=1)[:, -1]
        strongest = sorted(np.argsort(-strength, kind="stable")[:_MOST].tolist())
        indices, correlations = (
            [indices[k] for k in strongest],
            correlations[np.ix_(strongest, strongest)],
        )
    return [posterior.keys[k] for k in indices], correlations
