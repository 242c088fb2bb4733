"""The page of a trial: figures against their targets, reliability, confusion, strata; damaged and
hostile files."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from pamid_cli.frame import run as run_command
from report_pages import flat, outline_of, scripts_of
from synthetic_run import make_trial, share_json, trial_json

from pamid.base.errors import FileError
from pamid.report.trial_figures import (
    confusion_drawing,
    reliability_drawing,
    strata_drawing,
    targets_drawing,
    trial_drawings,
)
from pamid.report.trial_results import Trial, read_trial
from pamid.report.web_page import page_script
from pamid.report.writing import write_report
from pamid.trial.figure_table import JOINT_ROWS

NAMES = ["targets", "reliability", "confusion", "strata"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_trial(tmp_path_factory.mktemp("trial") / "TRIAL")
    write_report(made)
    return made


@pytest.fixture(scope="module")
def trial(folder: Path) -> Trial:
    found = read_trial(folder / "trial.json")
    assert found is not None
    return found


def test_one_page_with_four_figures(folder: Path) -> None:
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
        "each of them visible beside the other - 0 ≥ 65 % no cases",
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
    assert scripts_of((folder / "report.html").read_text(encoding="utf-8")) == [page_script()]


def test_every_row_of_the_table_is_judged_by_its_own_direction(trial: Trial) -> None:
    assert [one.row for one in trial.scored] == list(JOINT_ROWS)
    by_key = {one.row.key: one for one in trial.scored}
    assert by_key["family_first"].reached is False and by_key["family_first_two"].reached is True
    assert by_key["wrong_abstention"].reached is True and by_key["false_alarm"].reached is False, (
        "less is better"
    )
    assert by_key["missed"].reached is None, "no target"
    assert by_key["both_seen"].reached is None, "no case"
    judged = [one.reached for one in trial.scored if one.reached is not None]
    drawing = targets_drawing(trial)
    assert drawing is not None
    assert drawing.title.startswith(
        f"{sum(judged)} of {len(judged)} targets are reached; missed: family named first "
        "(87.3 %, target ≥ 90 %), at least one of two"
    )


def test_targets_that_are_all_reached_say_so(tmp_path: Path) -> None:
    rates = {
        **trial_json()["rates"],
        **{
            row.key: share_json(100 if row.upward else 0, 100)
            for row in JOINT_ROWS
            if row.section == "rates"
        },
    }
    figures = {
        row.key: {"value": 0.01, "low": 0.0, "high": 0.02, "of": 50}
        for row in JOINT_ROWS
        if row.section == "figures"
    }
    found = read_trial(make_trial(tmp_path / "TRIAL", rates=rates, figures=figures) / "trial.json")
    assert found is not None
    aimed = sum(row.target is not None for row in JOINT_ROWS)
    drawing = targets_drawing(found)
    assert drawing is not None and drawing.title == f"{aimed} of {aimed} targets are reached"


def test_reliability_shows_what_was_said_and_what_was_right(trial: Trial) -> None:
    drawing = reliability_drawing(trial)
    assert drawing is not None and "(target ≤ 0.05)" in drawing.title
    figure = Figure()
    drawing.draw(figure, False)
    said, right = figure.axes[0].get_lines()[-1].get_data()
    np.testing.assert_allclose(said, [0.35, 0.55, 0.76, 0.96])
    np.testing.assert_allclose(right, [4 / 10, 9 / 15, 20 / 24, 58 / 60])
    assert [text.get_text() for text in figure.axes[0].texts] == ["10", "15", "24", "60"]


def test_confusion_counts_every_case_once(trial: Trial) -> None:
    drawing = confusion_drawing(trial)
    assert drawing is not None
    everything = sum(sum(row.values()) for row in trial.confusion.values())
    right = sum(row[family] for family, row in trial.confusion.items())
    title = drawing.title.replace("\u00a0", " ")
    assert title.startswith(
        f"{right:.0f} of {everything:.0f} visible single faults are given their family"
    )
    assert title.endswith("most often mistaken: command timing for tube lag, 5 of 17")
    figure = Figure()
    drawing.draw(figure, False)
    assert sum(int(text.get_text()) for text in figure.axes[0].texts) == everything
    assert [t.get_text() for t in figure.axes[0].get_xticklabels()][-1] == "(unknown effect)"


def test_strata_name_the_worst_and_the_best(trial: Trial) -> None:
    drawing = strata_drawing(trial)
    assert drawing is not None
    title = drawing.title.replace("\u00a0", " ")
    assert title == (
        "The family is named first in 67 % (inertia 0.014 kg m²) to 98 % (visibility ≥ 2) of the "
        "visible faults"
    )


def test_every_axis_names_its_unit(trial: Trial) -> None:
    for drawing in trial_drawings(trial):
        for narrow in (False, True):
            figure = Figure(layout="constrained")
            drawing.draw(figure, narrow)
            labels = [
                text
                for axes in figure.axes
                for text in (axes.get_xlabel(), axes.get_ylabel())
                if text
            ]
            assert labels and all(re.search(r"\[\S.*\]", text) for text in labels), drawing.name


def test_a_trial_without_cases_makes_a_page(tmp_path: Path) -> None:
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


def test_the_command_reports_a_trial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = make_trial(tmp_path / "TRIAL", reliability=[], strata={}, confusion={})
    assert run_command(["report", str(made), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["mae"] == {} and [Path(path).stem for path in told["figures"]] == ["targets"]
    assert run_command(["report", str(made)]) == 0
    assert capsys.readouterr().out.split() == ["Page:", str(made / "report.html")]


def broken(change: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    content = trial_json()
    change(content)
    return content


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda one: one.update(schema="pamid.trial/9"), "schema should be 'pamid.trial/1'"),
        (lambda one: one["rates"].pop("unseen"), "rates.unseen should be"),
        (lambda one: one["rates"].pop("failed"), "failed should be"),
        (
            lambda one: one["rates"]["family_first"].update(share="most"),
            "rates.family_first.share should be a number",
        ),
        (
            lambda one: one["rates"]["port"].pop("of"),
            "rates.port.of should be a number, it is missing",
        ),
        (
            lambda one: one["rates"]["port"].update(of=3.5),
            "rates.port.of should be a whole number",
        ),
        (
            lambda one: one["figures"]["ece"].update(of=12.25),
            "figures.ece.of should be a whole number",
        ),
        (
            lambda one: one["strata"]["visibility"][">= 2"].pop("detected"),
            "strata.visibility.>= 2.detected",
        ),
        (
            lambda one: one["reliability"][0].pop("right"),
            "reliability[0].right should be an object",
        ),
        (lambda one: one.update(confusion=[]), "confusion should be an object"),
    ],
)
def test_damage_is_named(
    change: Callable[[dict[str, Any]], Any], told: str, tmp_path: Path
) -> None:
    made = make_trial(tmp_path / "TRIAL")
    (made / "trial.json").write_text(json.dumps(broken(change)), encoding="utf-8")
    with pytest.raises(FileError, match=re.escape(told)):
        write_report(made)
    assert not (made / "report.html").exists()


def test_a_count_with_a_decimal_point_is_a_count(tmp_path: Path) -> None:
    rates = trial_json()["rates"]
    rates["port"]["of"] = float(rates["port"]["of"])
    found = read_trial(make_trial(tmp_path / "TRIAL", rates=rates) / "trial.json")
    assert found is not None and write_report(tmp_path / "TRIAL").page.exists()
    port = found.of("port")
    assert port is not None and isinstance(port.cases, int)


def test_figures_that_a_trial_lacks_are_left_out(tmp_path: Path) -> None:
    """A trial.json from before a row was added to the table."""
    baselines = trial_json()["baselines"]
    del baselines["most_common_family"]
    found = read_trial(make_trial(tmp_path / "TRIAL", baselines=baselines) / "trial.json")
    assert found is not None and "most_common_family" not in {one.row.key for one in found.scored}
