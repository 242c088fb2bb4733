"""The page in a browser: it loads offline without a complaint, its plots zoom together and show the
numbers of residual.csv; colours, phone, print, no scripts, tables that can be copied; its size."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser, Page, browser
from synthetic_run import CHANNELS, make_run, make_trial

from pamid.report.channel_errors import errors_of
from pamid.report.formatting import number
from pamid.report.load import RunData, load_run
from pamid.report.page import html_of
from pamid.report.run_page import run_page
from pamid.report.samples import SAMPLE_LEVELS
from pamid.report.trial_page import trial_page
from pamid.report.trial_results import read_trial

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")

SIDEWAYS = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
OVER = "(r => [r.left, r.top, r.width])(pamid.panels[{0}].chart.over.getBoundingClientRect())"
SCALES = (
    "pamid.panels.filter(p => p.chart && p.near).map(p => [p.chart.scales.x.min, "
    "p.chart.scales.x.max])"
)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


def written(run: RunData, path: Path) -> Path:
    """The page without its pictures, which take the time."""
    path.write_text(html_of(run_page(run, errors_of(run), {})), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunData:
    return load_run(make_run(tmp_path_factory.mktemp("run") / "RUN"))


@pytest.fixture(scope="module")
def page(run, tmp_path_factory) -> Path:
    return written(run, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def tab(page, chromium) -> Page:
    opened = chromium.page()
    opened.open(page)
    opened.evaluate("document.getElementById('samples').scrollIntoView()")
    opened.wait("pamid.panels.filter(p => p.chart).length > 3")
    return opened


# ---- plots --------------------


def test_it_loads_offline_without_a_complaint(tab, page):
    assert tab.complaints == []
    assert tab.requested == [page.resolve().as_uri()]
    shown = tab.evaluate("pamid.panels.map(p => p.box.dataset.column)")
    assert (
        shown == ["angle_deg"] * 2 + ["command"] + ["pressure_1_kpa"] * 2 + ["pressure_2_kpa"] * 2
    )
    kinds = tab.evaluate(
        "[...document.querySelectorAll('.kinds .kind')].map(b => [b.innerText.trim(), "
        "b.getAttribute('aria-pressed')])"
    )
    assert kinds == [
        ["measured", "true"],
        ["data sheet", "true"],
        ["refitted", "true"],
        ["with network", "true"],
        ["with Coulomb friction", "true"],
        ["refitted, free run", "false"],
        ["with Coulomb friction, free run", "false"],
    ]


def test_every_sample_is_there_within_half_a_step(tab, run):
    assert run.residual is not None
    columns = run.residual.columns
    time, *traces = tab.evaluate("pamid.panels[0].chart.data.map(one => [...one])")
    np.testing.assert_allclose(time, columns["time_s"], atol=1e-6 * 0.01)
    refitted = columns["angle_refitted_deg"]
    for found, name in zip(traces, ("", "_data_sheet", "_refitted", "_network"), strict=False):
        values = columns[f"angle{name}_deg"]
        assert np.abs(np.array(found) - values).max() <= 0.5001 * np.ptp(values) / SAMPLE_LEVELS
    errors = np.array(tab.evaluate("[...pamid.panels[1].chart.data[2]]"))
    assert (
        np.abs(errors - (columns["angle_deg"] - refitted)).max()
        <= 1.01 * np.ptp(refitted) / SAMPLE_LEVELS
    )


def test_a_drag_zooms_every_plot_and_a_double_click_resets(tab):
    whole = tab.evaluate("pamid.view")
    left, top, width = tab.evaluate(OVER.format(0))
    tab.drag(left + 0.25 * width, top + 60, left + 0.5 * width)
    tab.wait("pamid.view[1] - pamid.view[0] < 11")
    expected = [whole[0] + share * (whole[1] - whole[0]) for share in (0.25, 0.5)]
    tab.wait(
        f"{SCALES}.length > 3 && {SCALES}.every(s => Math.abs(s[0] - {expected[0]}) < 0.1 && "
        f"Math.abs(s[1] - {expected[1]}) < 0.1)"
    )
    for count in (1, 2):
        for button in ("mousePressed", "mouseReleased"):
            tab.mouse(button, left + 90, top + 60, button="left", clickCount=count)
    tab.wait(f"{SCALES}.every(s => s[0] === {whole[0]} && s[1] === {whole[1]})")


# ---- colours, phone, print, no scripts, tables --------------------


@pytest.mark.parametrize("kind", ["explained", "unknown-effect", "fit", "trial"])
def test_a_phone_never_scrolls_sideways(kind, tmp_path, chromium):
    if kind == "trial":
        trial = read_trial(make_trial(tmp_path / "TRIAL") / "trial.json")
        assert trial is not None
        found = tmp_path / "trial.html"
        found.write_text(html_of(trial_page(trial, (), {})), encoding="utf-8")
    else:
        verdict = "explained" if kind == "fit" else kind
        found = written(
            load_run(
                make_run(tmp_path / "RUN", verdict, without=("diagnosis.json",) * (kind == "fit"))
            ),
            tmp_path / "page.html",
        )
    tab = chromium.page(375, 700, dark=True)
    tab.open(found)
    assert tab.evaluate(SIDEWAYS) == 0
    assert tab.complaints == []
    if kind != "trial":
        tab.evaluate("document.getElementById('samples').scrollIntoView()")
        tab.wait("pamid.panels[0].chart.width <= 375")
        assert tab.evaluate(SIDEWAYS) == 0


def test_tables_are_taken_along(tab, chromium):
    table = (
        "[...document.querySelectorAll('table')].find(t => "
        "t.rows[0].innerText.startsWith('channel'))"
    )
    rows = [line.split("\t") for line in tab.evaluate(f"pamidTable({table}, 'TSV')").split("\n")]
    assert rows[0][:4] == ["channel", "unit", "data sheet", "refitted"]
    assert rows[1][:4] == ["angle", "deg", *(number(value) for value in CHANNELS["angle_deg"][1:3])]
    assert len({len(row) for row in rows}) == 1
    parameters = tab.evaluate(
        "pamidTable([...document.querySelectorAll('table')].find(t => "
        "t.rows[0].innerText.startsWith('parameter')), 'TSV')"
    )
    assert (
        "sonic_conductance_m3_per_s_pa Table 2 of the first paper\tm³/(s Pa)\t1.23e-8" in parameters
    )
    markdown = tab.evaluate(f"pamidTable({table}, 'Markdown')").split("\n")
    assert markdown[1] == "|" + " --- |" * len(rows[0]) and markdown[2].startswith(
        "| angle | deg | 1.29 |"
    )
