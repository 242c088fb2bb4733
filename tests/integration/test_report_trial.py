"""The page of a trial: figures against their targets, reliability, confusion, strata; damaged and
hostile files."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_pages import flat, outline_of, scripts_of
from synthetic_run import make_trial, share_json

from pamid.report.page import asset
from pamid.report.trial_figures import (
    confusion_drawing,
    reliability_drawing,
)
from pamid.report.trial_results import Trial, read_trial
from pamid.report.writing import write_report
from pamid.trial.figure_table import JOINT_ROWS

NAMES = ["targets", "reliability", "confusion", "strata"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = make_trial(tmp_path_factory.mktemp("trial") / "TRIAL")
    write_report(made)
    return made


@pytest.fixture(scope="module")
def trial(folder) -> Trial:
    found = read_trial(folder / "trial.json")
    assert found is not None
    return found


def test_one_page_with_four_figures(folder):
    page = outline_of(folder / "report.html")
    shown = [
        value for name, value in page.attributes if name == "id" and value.startswith("figure-")
    ]
    assert shown == [f"figure-{name}" for name in NAMES]
    assert sorted(path.stem for path in (folder / "figures").iterdir()) == sorted(NAMES)
    text = re.sub(r" (?=[,.):;])", "", flat(page.text))
    for told in (
        "Blind trial, part test, seed 7: 240 cases, 1 failed; 12 of 160 planted gaps do not show",
        "family named first 87.3 % 79.8 to 92.3 110 ≥ 90 % missed",
        "known effect called unknown 6.4 % 3.1 to 12.6 110 ≤ 10 % reached",
        "each of them visible in addition to the other - 0 ≥ 65 % no cases",
        "1.1 to 1.3 67 % (20/30) 60 % (18/30) 93 % (28/30) 5 % (1/20)",
        "inertia [kg m²]",
        "Case 17: the joint ran into its stop <b>hard</b>",
        "cd" * 32,
        "pamid trial --output TRIAL",
    ):
        assert told in text, told
    assert not {"link", "img", "b"} & set(page.elements)
    links = [value for name, value in page.attributes if name == "href"]
    assert links and all(value.startswith("#") for value in links)
    assert scripts_of((folder / "report.html").read_text(encoding="utf-8")) == [asset("page.js")]


def test_reliability_shows_what_was_said_and_what_was_right(trial):
    drawing = reliability_drawing(trial)
    assert drawing is not None and "(target ≤ 0.05)" in drawing.title
    figure = Figure()
    drawing.draw(figure, False)
    said, right = figure.axes[0].get_lines()[-1].get_data()
    np.testing.assert_allclose(said, [0.35, 0.55, 0.76, 0.96])
    np.testing.assert_allclose(right, [4 / 10, 9 / 15, 20 / 24, 58 / 60])
    assert [text.get_text() for text in figure.axes[0].texts] == ["10", "15", "24", "60"]


def test_confusion_counts_every_case_once(trial):
    drawing = confusion_drawing(trial)
    assert drawing is not None
    everything = sum(sum(row.values()) for row in trial.file.confusion.values())
    right = sum(row[family] for family, row in trial.file.confusion.items())
    title = drawing.title.replace("\u00a0", " ")
    assert title.startswith(
        f"{right:.0f} of {everything:.0f} visible single faults are given their family"
    )
    assert title.endswith("most often mistaken: command timing for tube lag, 5 of 17")
    figure = Figure()
    drawing.draw(figure, False)
    assert sum(int(text.get_text()) for text in figure.axes[0].texts) == everything
    assert [t.get_text() for t in figure.axes[0].get_xticklabels()][-1] == "(unknown effect)"


def test_a_trial_without_cases_makes_a_page(tmp_path):
    empty = {row.key: share_json(0, 0) for row in JOINT_ROWS if row.section == "rates"}
    figures = {
        row.key: {"value": None, "low": None, "high": None, "of": 0}
        for row in JOINT_ROWS
        if row.section == "figures"
    }
    folder = make_trial(
        tmp_path / "TRIAL",
        rates={**empty, "failed": share_json(0, 0), "unseen": share_json(0, 0)},
        figures=figures,
        reliability=[],
        strata={},
        confusion={},
        failures={},
        cases=0,
    )
    report = write_report(folder)
    assert report.figures == ()
    assert "No case counts for a target." in flat(outline_of(report.page).text)
