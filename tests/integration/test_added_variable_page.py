"""Added-variable plots on the page, the card and as files: the leading candidates at once, any
other one when its row is chosen."""

import json
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, browser
from report_pages import Outline, flat
from synthetic_run import added_variables_json, make_run

import pamid
from pamid.base.errors import UsageError
from pamid.report.added_variable_figure import (
    added_panels,
    card_svg,
    usable_plots,
)
from pamid.report.answers import answers_of
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.report.style import Picture, render
from pamid.report.writing import write_report

MOST_BYTES = 60_000
TITLE = (
    "Coulomb friction explains 95 % of the refitted model's angle residual, slope 0.97 ± 0.07; "
    "Bouc-Wen hysteresis 50 %; dead time 0 %"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return make_run(tmp_path_factory.mktemp("added") / "run")


@pytest.fixture(scope="module")
def page(run) -> Path:
    return write_report(run).page


def plots_with(**changes: Any) -> dict[str, Any]:
    """The file with entries of its first plot replaced."""
    content = added_variables_json("explained")
    content["plots"][0] |= changes
    return content


def test_the_page_has_a_plot_of_every_candidate(run, page):
    text = page.read_text(encoding="utf-8")
    outline = Outline(text)
    places = {value for name, value in outline.attributes if name == "id"}
    assert "figure-added-variable" in places
    assert (run / "figures" / "added-variable.png").is_file()
    assert TITLE in flat(outline.text)
    candidates = [one.effect for one in usable_plots(load_run(run))]
    assert len(candidates) == 5
    for effect in candidates:
        assert f"added-{effect}" in places
        assert ("href", f"#added-{effect}") in outline.attributes
        assert ("data-figure", f"added-{effect}") in outline.attributes
    for panel in str(added_panels(load_run(run))).split("<figure")[1:]:
        assert len(panel) < MOST_BYTES


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_a_row_that_is_chosen_shows_its_plot(page):
    shown = (
        "[...document.querySelectorAll('.added-panel')].filter(p => p.offsetHeight).map(p => p.id)"
    )
    rows = "[...document.querySelectorAll('[data-figure=added-leak]')]"
    row = f"{rows}.find(r => r.getClientRects().length)"
    with browser() as opened:
        tab = opened.page(1200, 900)
        tab.open(page)
        assert tab.evaluate(shown) == []
        tab.evaluate(f"{row}.dispatchEvent(new MouseEvent('click', {{bubbles: true}}))")
        assert tab.evaluate(shown) == ["added-leak"]
        tab.evaluate("document.querySelector('a[href=\"#added-dead-time\"]').click()")
        assert tab.evaluate(shown) == ["added-dead-time"]
        assert tab.evaluate("document.activeElement.id") == "added-dead-time"
        assert not tab.complaints
        plain = opened.page(390, 900, scripts=False)
        plain.call("Page.navigate", url=f"{page.resolve().as_uri()}#added-leak")
        plain.wait("document.readyState === 'complete'")
        assert plain.evaluate(shown) == ["added-leak"]


def test_card_and_files_show_the_leading_candidate(run, tmp_path):
    found = pamid.open_run(run)
    assert isinstance(found, pamid.DiagnosisResult)
    svg = card_svg(found.data)
    assert "var(" not in svg and svg in found._repr_html_()
    assert "explains 95 % of the refitted model's angle residual" in flat(unescape(svg))
    which = answers_of(found.data, errors_of(found.data))[1].card
    assert which is not None
    assert "explains 95 % of the refitted model's angle residual, slope 0.97 ± 0.07" in map(
        flat, which.lines
    )
    assert len(found.overview_png()) > len(found.rig_png())
    assert found.plot_added_variable().get_suptitle()
    assert "Leak explains 0 %" in flat(found.plot_added_variable("leak").get_suptitle())
    with pytest.raises(UsageError, match="no added-variable plot of 'leek'"):
        found.plot_added_variable("leek")


def test_hostile_names_stay_text(tmp_path, monkeypatch):
    def drawn(one):
        """The plots of this page; the others take the time."""
        blank = Picture(one.name, one.title, "", "", b"")
        return render(one) if one.name.startswith("added") else blank

    monkeypatch.setattr("pamid.report.writing.render", drawn)
    hostile = "<img src=x onerror=alert(1)>"
    content = plots_with(effect=hostile, channel=f"{hostile}_deg", beside=[hostile])
    run = make_run(tmp_path / "run", **{"added-variables": content})
    diagnosis = json.loads((run / "diagnosis.json").read_text())
    diagnosis["ranking"][0]["effect"] = diagnosis["causes"][0]["effect"] = hostile
    (run / "diagnosis.json").write_text(json.dumps(diagnosis))
    assert "<img" not in write_report(run).page.read_text(encoding="utf-8")
