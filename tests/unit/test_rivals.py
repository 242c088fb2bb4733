"""Why candidates lost, which parameters hang together, figures as people say them."""

from __future__ import annotations

from matplotlib.figure import Figure
from synthetic_run import fit_json

from pamid.report.correlation_figure import correlation_drawing
from pamid.schemas.fit_file import FitFile
from pamid.schemas.model import read


def fit_with(covariance: list[list[float]], *keys: str) -> FitFile:
    count = len(keys)
    posterior = {
        "keys": list(keys),
        "log": [False] * count,
        **dict.fromkeys(("centre", "value", "held"), [0.0] * count),
        "spread": [1.0] * count,
        "others": {},
        "covariance": covariance,
    }
    return read(FitFile, fit_json() | {"posterior": posterior}, also=("posterior",))


def test_parameters_that_hang_together_are_named() -> None:
    rows = [[4.0], [-1.9, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.9, 1.0]]
    drawing = correlation_drawing(fit_with(rows, "mass", "gain", "lag", "background.map:level"))
    assert drawing is not None
    assert drawing.title == "gain and mass are hard to tell apart: correlation −0.95"
    figure = Figure()
    drawing.draw(figure, False)
    (axes,) = figure.axes
    assert [one.get_text() for one in axes.get_yticklabels()] == ["gain", "lag"]
    assert [one.get_text() for one in axes.texts] == ["−0.95"]  # no colour alone


def test_no_map_of_one_parameter_or_of_a_covariance_that_does_not_fit() -> None:
    assert correlation_drawing(fit_with([[1.0]], "mass")) is None
    assert correlation_drawing(fit_with([[1.0], [0.5]], "mass", "gain")) is None
    assert correlation_drawing(None) is None
