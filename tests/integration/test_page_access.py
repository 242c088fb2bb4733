"""The page for everybody: what stands above the fold, the diagram by mouse and by keyboard, names
for everything that can be focused, contrast in both colours, no id twice, what is folded in print.

axe-core, of the package axe-core-python or of the file axe.min.js that PAMID_AXE names, judges the
pages of a diagnosis, a trial and a comparison as well.
"""

import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser, Page, browser
from pamid_cli import frame
from synthetic_run import make_run, make_trial

from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.report.page import html_of
from pamid.report.rig_figure import rig_drawing
from pamid.report.run_page import run_page
from pamid.report.style import render

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


def axe_file() -> Path | None:
    """axe.min.js; of the package it is read, nothing of the package is run."""
    named = os.environ.get("PAMID_AXE", "")
    package = find_spec("axe_core_python")
    places = [Path(one) for one in (package.submodule_search_locations or ())] if package else []
    found = [Path(named)] if named else [place / "axe.min.js" for place in places]
    return next((one for one in found if one.is_file()), None)


AXE = axe_file()
SHOWN = "[...document.querySelectorAll('.port-panel.shown')].map(one => one.id)"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """A diagnosis with its diagram; the other pictures take the time."""
    run = load_run(make_run(tmp_path_factory.mktemp("run") / "RUN", "partly-explained"))
    drawing = rig_drawing(run.diagnosis)
    assert drawing is not None
    path = tmp_path_factory.mktemp("page") / "report.html"
    pictures = {"rig": render(drawing)}
    path.write_text(html_of(run_page(run, errors_of(run), pictures)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def pages(page, tmp_path_factory) -> dict[str, Path]:
    """One of every kind that people look at, as the command writes it."""
    place = tmp_path_factory.mktemp("pages")
    first, second = make_run(place / "first"), make_run(place / "second", "unknown-effect")
    trial = make_trial(place / "trial")
    for words in (["report", str(second)], ["report", str(trial)]):
        assert frame.run(words) == 0
    compared = place / "comparison.html"
    words = ["report", "--compare", str(first), str(second), "--output", str(compared)]
    assert frame.run(words) == 0
    return {
        "partly-explained": page,
        "unknown-effect": second / "report.html",
        "trial": trial / "report.html",
        "comparison": compared,
    }


def opened(chromium: Browser, page: Path, width: int = 1280, *, dark: bool = False) -> Page:
    tab = chromium.page(width, 900, dark=dark)
    tab.open(page)
    return tab


def test_three_answers_and_what_to_do_stand_above_the_fold(page, chromium):
    tab = opened(chromium, page)
    boxes = tab.evaluate(
        "[...document.querySelectorAll('.card')].map(c => { const r = c.getBoundingClientRect(); "
        "return [c.querySelector('.question').textContent, r.top, r.bottom, r.left]; })"
    )
    assert [one[0] for one in boxes] == ["Where", "Which", "How far"]
    assert len({one[1] for one in boxes}) == 1 and len({one[3] for one in boxes}) == 3
    todo = tab.evaluate("document.querySelector('.todo').getBoundingClientRect().bottom")
    assert max(*(one[2] for one in boxes), todo) < 900
    assert tab.evaluate("document.querySelectorAll('h1').length") == 1
    headline = tab.evaluate("document.querySelector('h1').textContent")
    assert "64" in headline and "64" in tab.evaluate(
        "document.querySelectorAll('.card')[1].textContent"
    )


def test_a_block_shows_what_is_known_of_it(page, chromium):
    tab = opened(chromium, page)
    assert tab.evaluate(SHOWN) == ["at-joint"]
    x, y = tab.evaluate(
        "(r => [r.left + r.width / 2, r.top + r.height / 2])(document.querySelector("
        "'.wide .block[href=\"#at-pressure\"]').getBoundingClientRect())"
    )
    tab.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    tab.mouse("mouseReleased", x, y, button="left", clickCount=1)
    tab.wait(f"({SHOWN}).join() === 'at-pressure'")
    tab.evaluate("document.querySelector('.wide .block[href=\"#at-valve\"]').focus()")
    assert tab.evaluate(SHOWN) == ["at-valve"]
    text = tab.evaluate("document.querySelector('.port-panel.shown').innerText")
    assert text.startswith("valve: 4") and "flow through a valve" in text
    assert tab.complaints == []


@pytest.mark.skipif(AXE is None, reason="neither axe-core-python nor PAMID_AXE is there")
@pytest.mark.parametrize("look", ["1280", "1280 dark", "390"])
@pytest.mark.parametrize("kind", ["partly-explained", "unknown-effect", "trial", "comparison"])
def test_axe_finds_nothing(kind, look, pages, chromium):
    assert AXE is not None
    wide, _, dark = look.partition(" ")
    tab = opened(chromium, pages[kind], int(wide), dark=bool(dark))
    tab.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    tab.evaluate(AXE.read_text(encoding="utf-8") + ";0")
    found = tab.evaluate(
        "axe.run(document, {resultTypes: ['violations']}).then(told => told.violations.map("
        "one => [one.id, one.nodes[0].html.slice(0, 200)]))"
    )
    assert found == []
