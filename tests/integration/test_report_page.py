"""The page in a browser: it loads offline without a complaint, its plots zoom together and show the
numbers of residual.csv; colours, phone, print, no scripts, tables that can be copied; its size."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, Browser, Page, browser
from report_pages import flat
from synthetic_run import CHANNELS, WINDOW_ROWS, make_run, make_trial

from pamid.report.channel_errors import errors_of
from pamid.report.formatting import number
from pamid.report.load import RunData, load_run
from pamid.report.run_page import run_document
from pamid.report.samples import SAMPLE_LEVELS
from pamid.report.style import COLOURS
from pamid.report.trial_page import trial_document
from pamid.report.trial_results import read_trial
from pamid.report.web_page import html_of
from pamid.report.writing import write_report

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")

LONG = 66_667
PERIOD_S = 0.003
#: sha256 of the files of uPlot 1.6.32 as the registry has them
VENDORED = {
    "uplot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uplot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "uplot.LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
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
    path.write_text(html_of(run_document(run, errors_of(run), {})), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunData:
    return load_run(make_run(tmp_path_factory.mktemp("run") / "RUN"))


@pytest.fixture(scope="module")
def page(run: RunData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(run, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def tab(page: Path, chromium: Browser) -> Page:
    opened = chromium.page()
    opened.open(page)
    opened.evaluate("document.getElementById('samples').scrollIntoView()")
    opened.wait("pamid.panels.filter(p => p.chart).length > 3")
    return opened


def test_the_library_is_the_registry_s() -> None:
    assets = resources.files("pamid.report").joinpath("assets")
    for name, digest in VENDORED.items():
        assert hashlib.sha256(assets.joinpath(name).read_bytes()).hexdigest() == digest, name


# ---- plots --------------------


def test_it_loads_offline_without_a_complaint(tab: Page, page: Path) -> None:
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


def test_every_sample_is_there_within_half_a_step(tab: Page, run: RunData) -> None:
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


def test_a_drag_zooms_every_plot_and_a_double_click_resets(tab: Page) -> None:
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


def test_the_wheel_zooms_where_a_plot_has_the_focus_and_scrolls_elsewhere(tab: Page) -> None:
    left, top, width = tab.evaluate(OVER.format(0))
    tab.evaluate("document.activeElement.blur()")
    before, height = tab.evaluate("pamid.view"), tab.evaluate("scrollY")
    tab.mouse("mouseMoved", left + 0.5 * width, top + 60)
    tab.mouse("mouseWheel", left + 0.5 * width, top + 60, deltaX=0, deltaY=-120)
    tab.wait(f"scrollY !== {height}")
    tab.settle()
    assert tab.evaluate("pamid.view") == before
    tab.evaluate("document.getElementById('samples').scrollIntoView({behavior: 'instant'})")
    tab.settle()
    left, top, width = tab.evaluate(OVER.format(0))
    tab.evaluate("pamid.panels[0].canvas.focus()")
    tab.mouse("mouseWheel", left + 0.5 * width, top + 60, deltaX=0, deltaY=-250)
    tab.wait(f"pamid.view[1] - pamid.view[0] < {0.6 * (before[1] - before[0])}")
    for _ in range(14):
        tab.key("+")
    tab.wait("pamid.view[1] - pamid.view[0] < 0.1")  # a few samples of 10 ms, no fewer
    assert tab.evaluate("pamid.view[1] - pamid.view[0]") > 0.05
    tab.key("ArrowRight")
    tab.key("Escape")
    tab.wait(f"pamid.view[1] === {before[1]}")


def test_the_head_shows_the_numbers_at_the_cursor(tab: Page, run: RunData) -> None:
    assert run.residual is not None
    tab.evaluate("pamid.show(30, 30.4)")
    tab.wait("Math.abs(pamid.panels[0].chart.scales.x.min - 30) < 0.01")
    left, top, width = tab.evaluate(OVER.format(0))
    for share in (0.2, 0.7):
        tab.mouse("mouseMoved", left + share * width, top + 80)
        index = tab.evaluate("pamid.panels[0].chart.cursor.idx")
        row = int(index)
        assert abs(run.residual.columns["time_s"][row] - (30 + 0.4 * share)) <= 0.006
        for panel, column in ((0, "angle_deg"), (3, "pressure_1_kpa")):
            tab.wait(
                f"pamid.panels[{panel}].chart && pamid.panels[{panel}].chart.cursor.idx === {index}"
            )
            texts = tab.evaluate(f"pamid.panels[{panel}].values.map(one => one.value)")
            kinds = ("", "_data_sheet", "_refitted")
            for text, kind in zip(texts, kinds, strict=False):
                stem, unit = column.rsplit("_", 1)
                values = run.residual.columns[f"{stem}{kind}_{unit}"]
                digits = len(text.partition(".")[2])
                assert abs(float(text.replace("−", "-")) - values[row]) <= (
                    0.51 * np.ptp(values) / SAMPLE_LEVELS + 0.51 * 10.0**-digits
                )
        clock = tab.evaluate("document.querySelector('#samples .clock').value")
        assert clock == f"{run.residual.columns['time_s'][row]:g} s"
    tab.evaluate("pamid.all()")


def test_an_answer_leads_to_its_place(tab: Page) -> None:
    labels = [
        flat(one)
        for one in tab.evaluate(
            "[...document.querySelectorAll('button[data-place]')].map(b => b.textContent)"
        )
    ]
    assert labels[:2] == ["29 to 31.5 s", "35 to 36 s"]
    assert (
        labels[2].startswith("velocity between −2 and 2")
        and sum(": angle off by" in one for one in labels) == 5
    )
    tab.evaluate("document.querySelectorAll('button[data-place]')[1].click()")
    tab.wait("Math.abs(pamid.view[0] - 34.75) < 0.01 && Math.abs(pamid.view[1] - 36.25) < 0.01")
    assert (
        flat(tab.evaluate("document.querySelector('.bar select').selectedOptions[0].text"))
        == "35 to 36 s"
    )
    tab.evaluate(
        "[...document.querySelectorAll('.bar button')].find(b => b.textContent === '▶').click()"
    )
    tab.wait(f"Math.abs(pamid.view[1] - pamid.view[0] - {0.01 * WINDOW_ROWS}) < 0.02")
    tab.evaluate(
        "[...document.querySelectorAll('.bar button')].find(b => b.textContent === 'All').click()"
    )
    tab.wait("pamid.view[0] === 0")


def test_a_model_can_be_hidden_everywhere(tab: Page) -> None:
    click = (
        "[...document.querySelectorAll('.kinds .kind')].find(b => b.innerText.trim() === "
        "'data sheet').click()"
    )
    shown = (
        "pamid.panels.filter(p => p.chart).flatMap(p => p.kinds.map((k, i) => [k, "
        "p.chart.series[i + 1].show]))"
    )
    before = {tuple(one) for one in tab.evaluate(shown)}
    assert {one for one, is_shown in before if not is_shown} == {"free_run", "cause_free_run"}
    tab.evaluate(click)
    hidden = {("data_sheet", False)}
    assert {tuple(one) for one in tab.evaluate(shown)} == before - {("data_sheet", True)} | hidden
    tab.evaluate(click)
    assert {tuple(one) for one in tab.evaluate(shown)} == before


def test_several_recordings_and_blank_cells(tmp_path: Path, chromium: Browser) -> None:
    folder = make_run(tmp_path / "RUN", without=("network.json",))
    fit = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    fit["recordings"] += [{**fit["recordings"][0], "name": "other </script>"}]
    (folder / "fit.json").write_text(json.dumps(fit), encoding="utf-8")
    head, *lines = (folder / "residual.csv").read_text(encoding="utf-8").splitlines()
    cells = [line.split(",") for line in lines]
    for k, row in enumerate(cells):
        row[1] = str(int(k % 3 == 0))  # interleaved, as no program of ours would write it
    cells[1][head.split(",").index("angle_refitted_deg")] = ""
    (folder / "residual.csv").write_text(
        "\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8"
    )
    tab = chromium.page()
    tab.open(written(load_run(folder), tmp_path / "page.html"))
    options = "[...document.querySelector('.bar select').options].map(o => o.text)"
    assert tab.evaluate(options) == ["rec", "other </script>"]
    assert tab.evaluate("[pamid.panels[0].chart.data[3][0], pamid.panels[1].chart.data[2][0]]") == [
        None,
        None,
    ]
    assert tab.evaluate("pamid.panels[0].chart.data[0].length") == 2666
    tab.evaluate("document.getElementById('samples').scrollIntoView()")
    tab.evaluate(
        "(s => { s.value = 1; s.dispatchEvent(new Event('change')); "
        "})(document.querySelector('.bar select'))"
    )
    tab.wait("pamid.panels[0].chart.data[0].length === 1334")
    assert tab.complaints == []


# ---- size --------------------


def long_residual() -> dict[str, Any]:
    """200 s at 3 ms: a measured angle with noise, and three models."""
    random, time = np.random.default_rng(1), PERIOD_S * np.arange(LONG)
    shape = np.sin(0.9 * time) + 0.4 * np.sin(2.3 * time) + 0.3 * np.sign(np.sin(0.37 * time))
    gap = np.tanh(8.0 * np.cos(0.9 * time))
    return {
        "time_s": time,
        "recording": 0 * time,
        "part": 1 * (time >= 140.0),
        "window": np.where(np.arange(LONG) % 767 < 115, -1, np.arange(LONG) // 767),
        "angle_deg": 20.0 * shape + random.normal(0.0, 0.03, LONG),
        "angle_data_sheet_deg": 18.6 * shape + gap,
        "angle_refitted_deg": 20.0 * shape + 0.5 * gap,
        "angle_cause_deg": 20.0 * shape + 0.1 * gap,
    }


def test_four_long_traces_are_small_and_complete(tmp_path: Path, chromium: Browser) -> None:
    folder = make_run(tmp_path / "RUN", without=("residual.csv",))
    columns = long_residual()
    np.savetxt(
        folder / "residual.csv",
        np.stack(list(columns.values()), axis=1),
        delimiter=",",
        fmt="%.9g",
        header=",".join(columns),
        comments="",
    )
    found = write_report(folder).page  # with its pictures
    assert found.stat().st_size < 1_000_000
    tab = chromium.page()
    tab.open(found)
    # how soon: benchmarks/waiting.py
    assert tab.complaints == [] and tab.evaluate("pamidReady") > 0.0
    assert tab.evaluate("pamid.panels[0].chart.data.map(one => one.length)") == [LONG] * 5


# ---- colours, phone, print, no scripts, tables --------------------


def background(tab: Page) -> str:
    red, green, blue = tab.evaluate(
        "getComputedStyle(document.body).backgroundColor.match(/\\d+/g)"
    )[:3]
    return f"#{int(red):02x}{int(green):02x}{int(blue):02x}"


def test_colours_follow_the_system_and_the_reader(page: Path, chromium: Browser) -> None:
    light, dark = COLOURS["paper"]
    tab = chromium.page(dark=True)
    tab.open(page)
    assert background(tab) == dark
    assert tab.evaluate("pamid.panels[0].chart.series[1].stroke()") == COLOURS["ink"][1]
    for expected, line in ((light, 0), (dark, 1), (dark, 1)):  # light, dark, as the system
        tab.evaluate("document.querySelector('.colours').click()")
        assert background(tab) == expected
        assert tab.evaluate("pamid.panels[0].chart.series[1].stroke()") == COLOURS["ink"][line]
    assert tab.complaints == []


@pytest.mark.parametrize("kind", ["explained", "unknown-effect", "fit", "trial"])
def test_a_phone_never_scrolls_sideways(kind: str, tmp_path: Path, chromium: Browser) -> None:
    if kind == "trial":
        trial = read_trial(make_trial(tmp_path / "TRIAL") / "trial.json")
        assert trial is not None
        found = tmp_path / "trial.html"
        found.write_text(html_of(trial_document(trial, (), {})), encoding="utf-8")
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


def test_fingers_enlarge_and_move(page: Path, chromium: Browser) -> None:
    tab = chromium.page(375, 700)
    tab.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=5)
    tab.open(page)
    tab.evaluate("document.getElementById('samples').scrollIntoView({behavior: 'instant'})")
    tab.settle()
    left, top, width = tab.evaluate(OVER.format(0))

    def touch(kind: str, *shares: float) -> None:
        points = [
            {"x": left + share * width, "y": top + 60, "id": k} for k, share in enumerate(shares)
        ]
        tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    first, last = tab.evaluate("pamid.view")
    touch("touchStart", 0.4)
    touch("touchStart", 0.4, 0.6)
    for k in range(1, 9):
        touch("touchMove", 0.4 - 0.04 * k, 0.6 + 0.04 * k)
    touch("touchEnd")
    begin, end = tab.evaluate("pamid.view")  # what lay between the fingers still does
    assert begin + 0.08 * (end - begin) == pytest.approx(first + 0.4 * (last - first), rel=0.02)
    assert begin + 0.92 * (end - begin) == pytest.approx(first + 0.6 * (last - first), rel=0.02)
    touch("touchStart", 0.5)
    for k in range(1, 6):
        touch("touchMove", 0.5 - 0.05 * k)
    touch("touchEnd")
    assert tab.evaluate("pamid.view")[0] == pytest.approx(begin + 0.25 * (end - begin), rel=0.02)


def test_paper_shows_what_stands_still(page: Path, chromium: Browser) -> None:
    tab = chromium.page(dark=True, print_=True)
    tab.open(page)
    assert background(tab) == COLOURS["paper"][0]
    assert tab.evaluate("document.querySelectorAll('main button').length") > 0
    assert tab.evaluate(
        "[...document.querySelectorAll('main button, .plots, canvas')].every(e => !e.offsetParent)"
    )


def test_without_scripts_nothing_is_promised(page: Path, chromium: Browser) -> None:
    tab = chromium.page(scripts=False)
    tab.call("Page.navigate", url=page.resolve().as_uri())
    tab.wait("document.readyState === 'complete' && document.querySelector('table') !== null")
    assert tab.evaluate("document.querySelector('noscript').innerText").startswith(
        "The plots of all samples need"
    )
    assert tab.evaluate(
        "[...document.querySelectorAll('button, .scripted')].every(e => !e.offsetParent)"
    )
    assert tab.complaints == []


def test_tables_are_taken_along(tab: Page, chromium: Browser) -> None:
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


def test_a_button_copies_and_where_it_may_not_selects(tab: Page, chromium: Browser) -> None:
    chromium.call(
        "Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"]
    )
    press = "document.querySelectorAll('.copy button')[0].click()"
    told = "document.querySelectorAll('.copy button')[0].textContent"
    tab.call("Page.bringToFront")
    tab.evaluate(press)
    tab.wait(f"{told} === 'copied'")
    assert tab.evaluate("navigator.clipboard.readText()").startswith("channel\tunit\tdata sheet")
    tab.wait(f"{told} === 'TSV'")
    tab.evaluate("navigator.clipboard.writeText = () => Promise.reject(new Error('no'))")
    tab.evaluate(press)
    tab.wait(f"{told}.startsWith('selected')")
    assert tab.evaluate("getSelection().toString()").startswith("channel")
