"""Why candidates lost, which parameters hang together, figures as people say them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_pages import flat
from synthetic_run import diagnosis_json, fit_json, make_run

from pamid.base.share_words import minutes_text, times_text
from pamid.report.correlation_figure import correlation_drawing
from pamid.report.figures import missing_drawing
from pamid.report.formatting import in_one_unit, span, with_unit_text
from pamid.report.load import load_run
from pamid.report.ranking import rivals_table, why_not
from pamid.schemas.diagnosis_file import DiagnosisFile
from pamid.schemas.fit_file import FitFile
from pamid.schemas.model import read


def test_a_candidate_says_what_it_lost_by() -> None:
    content = diagnosis_json("explained")
    rival, *_ = (one for one in content["ranking"] if one["effect"] == "lugre-friction")
    rival |= {"set_aside": ["lugre-friction does what viscous of the rig does"]}
    (step,) = content["comparison"]
    step["tied"] = [*step["tied"], step["tied"][0] | {"effect": "lugre-friction"}]
    loser = next(one for one in content["ranking"] if one["effect"] == "bouc-wen-hysteresis")
    loser |= {"low": -0.02, "at_bound": ["force_n"]}
    found = read(DiagnosisFile, content)
    told = {one.effect: flat(why_not(one, found)) for one in found.ranking}
    assert told["coulomb-friction"] == "is named"
    assert told["lugre-friction"] == (
        "lugre-friction does what viscous of the rig does; these recordings cannot separate it "
        "from the first"
    )
    assert told["bouc-wen-hysteresis"].startswith(
        "its gain is not sure: the interval reaches 0; removes 41 % where Coulomb friction removes"
    )
    assert told["bouc-wen-hysteresis"].endswith("needs a value at its bound")
    rival |= {"converged": False, "why": "iterations used up"}
    found = read(DiagnosisFile, content)
    assert any("did not converge: iterations" in why_not(one, found) for one in found.ranking)
    assert len(rivals_table(found).rows) == len(found.ranking)


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


def test_many_parameters_leave_those_that_are_correlated_most() -> None:
    size = 20
    whole = np.eye(size)
    whole[19, 0] = 0.95
    rows = [whole[k, : k + 1].tolist() for k in range(size)]
    drawing = correlation_drawing(fit_with(rows, *(f"p{k}" for k in range(size))))
    assert drawing is not None and drawing.title.startswith("p19 and p0 are hard to tell apart")


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(1.36, "1.4"), (7312.0, "7300"), (290.4, "290"), (4.2e7, "42 million"), (0.5, "0.5")],
)
def test_ratios_without_powers_of_ten(ratio: float, text: str) -> None:
    assert times_text(ratio) == text


def test_spans_of_time_in_units_people_use() -> None:
    told = [minutes_text(one) for one in (0.17, 0.0017, 8.0, 100.0, 150.0)]
    assert told == ["10 s", "0.1 s", "8 min", "100 min", "2.5 h"]


def test_small_values_have_small_units() -> None:
    assert flat(with_unit_text(4.05e-7, "m")) == "0.405 µm"
    assert flat(with_unit_text(5.0e-4, "s")) == "0.5 ms"
    assert flat(with_unit_text(0.04, "m")) == "40 mm"
    assert flat(with_unit_text(0.4, "m")) == "0.4 m"
    assert flat(with_unit_text(2.0e-5, "rad")) == "2 × 10⁻⁵ rad"
    assert flat(span(3.01e-5, 9.0e-5, "m")) == "30.1 to 90 µm"
    assert flat(in_one_unit((0.00598, 0.00263), "m", " → ")) == "5.98 → 2.63 mm"
    assert flat(in_one_unit((0.5, 0.02), "m", " to ")) == "0.5 to 0.02 m"
    assert in_one_unit((0.5, 0.02), "", " to ") == "0.5 to 0.02"


def test_what_is_missing_is_not_drawn_over_itself(tmp_path: Path) -> None:
    """The formula of a remainder begins with what it is of: "missing [N] = ..."."""
    content = diagnosis_json("partly-explained")
    content["remainder"]["formula"] = "missing [N] = -0.42 sign(velocity)"
    run = load_run(make_run(tmp_path / "RUN", "partly-explained", diagnosis=content))
    drawing = missing_drawing(run)
    assert drawing is not None and drawing.title.startswith("Velocity alone accounts for")
