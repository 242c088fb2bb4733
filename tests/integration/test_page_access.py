"""The page for everybody: what stands above the fold, the diagram by mouse and by keyboard, names
for everything that can be focused, contrast in both colours, no id twice, what is folded in print.

axe-core, of the package axe-core-python or of the file axe.min.js that PAMID_AXE names, judges the
pages of a diagnosis, a trial and a comparison as well.
"""

from __future__ import annotations

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
from pamid.report.rig_figure import rig_drawing
from pamid.report.run_page import run_document
from pamid.report.style import render
from pamid.report.web_page import html_of

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


def axe_file() -> Path | None:
    """axe.min.js; of the package it is read, nothing of the package is run."""
    named = os.environ.get("PAMID_AXE", "")
    package = find_spec("axe_core_python")
    places = [Path(one) for one in (package.submodule_search_locations or ())] if package else []
    found = [Path(named)] if named else [place / "axe.min.js" for place in places]
    return next((one for one in found if one.is_file()), None)


AXE = axe_file()
TEXT_CONTRAST = 4.5  # WCAG 2.2, 1.4.3, level AA
SIDEWAYS = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
#: contrast of every visible text with the first opaque colour behind it; what is drawn over tints
#: is judged by the diagram's own test
CONTRASTS = """(() => {
  const channel = (c) => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const behind = (one) => {
    for (; one; one = one.parentElement) {
      const found = parts(getComputedStyle(one).backgroundColor);
      if (found.length === 3 || found[3] === 1) return found;
    }
    return [255, 255, 255];
  };
  const low = [];
  for (const one of document.querySelectorAll("main *, nav *")) {
    const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || !one.offsetParent) continue;
    if (one.closest("svg, math, noscript")) continue;
    const [a, b] = [light(parts(getComputedStyle(one).color)), light(behind(one))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < LIMIT) low.push([one.tagName, one.className, one.textContent.slice(0, 30), ratio]);
  }
  return low;
})()""".replace("LIMIT", str(TEXT_CONTRAST))
UNNAMED = """[...document.querySelectorAll("a[href], button, select, input, summary, [tabindex]")]
  .filter((one) => one.offsetParent || one.ownerSVGElement)
  .filter((one) => !(one.getAttribute("aria-label") || one.closest("label")?.textContent ||
    one.textContent).trim())
  .map((one) => one.outerHTML.slice(0, 120))"""
SHOWN = "[...document.querySelectorAll('.port-panel.shown')].map(one => one.id)"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A diagnosis with its diagram; the other pictures take the time."""
    run = load_run(make_run(tmp_path_factory.mktemp("run") / "RUN", "partly-explained"))
    drawing = rig_drawing(run.diagnosis)
    assert drawing is not None
    path = tmp_path_factory.mktemp("page") / "report.html"
    pictures = {"rig": render(drawing)}
    path.write_text(html_of(run_document(run, errors_of(run), pictures)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def pages(page: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One of every kind that people look at, as the command writes it."""
    place = tmp_path_factory.mktemp("pages")
    first, second = make_run(place / "first"), make_run(place / "second", "unknown-effect")
    trial = make_trial(place / "trial")
    for words in (["report", str(first)], ["report", str(second)], ["report", str(trial)]):
        assert frame.run(words) == 0
    compared = place / "comparison.html"
    words = ["report", "--compare", str(first), str(second), "--output", str(compared)]
    assert frame.run(words) == 0
    return {
        "partly-explained": page,
        "explained": first / "report.html",
        "unknown-effect": second / "report.html",
        "trial": trial / "report.html",
        "comparison": compared,
    }


def opened(chromium: Browser, page: Path, width: int = 1280, *, dark: bool = False) -> Page:
    tab = chromium.page(width, 900, dark=dark)
    tab.open(page)
    return tab


def test_three_answers_and_what_to_do_stand_above_the_fold(page: Path, chromium: Browser) -> None:
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


def test_a_block_shows_what_is_known_of_it(page: Path, chromium: Browser) -> None:
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


def test_without_scripts_a_block_leads_to_its_panel(page: Path, chromium: Browser) -> None:
    tab = chromium.page(scripts=False)
    tab.call("Page.navigate", url=f"{page.resolve().as_uri()}#at-valve")
    tab.wait("document.readyState === 'complete' && !!document.querySelector('#at-valve')")
    shown = (
        "[...document.querySelectorAll('.port-panel')].filter(e => e.offsetParent).map(e => e.id)"
    )
    assert set(tab.evaluate(shown)) == {"at-valve", "at-joint"}


def test_everything_that_takes_the_focus_has_a_name(page: Path, chromium: Browser) -> None:
    for width in (1280, 390):
        assert opened(chromium, page, width).evaluate(UNNAMED) == []


def test_tab_goes_down_the_page(page: Path, chromium: Browser) -> None:
    """Contents, colours, the cards from left to right, then the diagram's blocks."""
    tab = opened(chromium, page)
    seen = []
    for _ in range(40):
        tab.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", windowsVirtualKeyCode=9)
        tab.call("Input.dispatchKeyEvent", type="keyUp", key="Tab", windowsVirtualKeyCode=9)
        seen.append(tab.evaluate("document.activeElement.getAttribute('class') || ''"))
    assert seen[0] == "skip"
    assert "colours" in seen
    cards = [k for k, name in enumerate(seen) if name == "card"]
    blocks = [k for k, name in enumerate(seen) if name.startswith("block")]
    assert len(cards) == 3 and len(blocks) == 5
    assert seen.index("colours") < cards[0] and cards == list(range(cards[0], cards[0] + 3))
    assert cards[-1] < blocks[0]


@pytest.mark.parametrize("dark", [False, True])
def test_text_stands_out(dark: bool, page: Path, chromium: Browser) -> None:
    assert opened(chromium, page, dark=dark).evaluate(CONTRASTS) == []


@pytest.mark.parametrize("dark", [False, True])
def test_text_stands_out_in_the_darkest_block(dark: bool, page: Path, chromium: Browser) -> None:
    """Ink on the tint of a block that holds the whole gap, as the page would mix it."""
    tab = opened(chromium, page, dark=dark)
    ink, paper, tint = (
        tab.evaluate(
            "((role) => getComputedStyle(document.documentElement).getPropertyValue(role).trim())"
            f"('--{role}')"
        )
        for role in ("ink", "paper", "with-cause")
    )
    mixed = [0.5 * (a + b) for a, b in zip(rgb(paper), rgb(tint), strict=True)]
    high, low = sorted((luminance(mixed), luminance(rgb(ink))), reverse=True)
    assert (high + 0.05) / (low + 0.05) >= TEXT_CONTRAST


def rgb(colour: str) -> list[float]:
    return [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]


def luminance(colour: list[float]) -> float:
    """WCAG 2.2, relative luminance of sRGB."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_no_id_twice_and_every_place_is_there(page: Path, chromium: Browser) -> None:
    tab = opened(chromium, page)
    assert (
        tab.evaluate(
            "(ids => ids.filter((one, k) => ids.indexOf(one) !== k))"
            "([...document.querySelectorAll('[id]')].map(e => e.id))"
        )
        == []
    )
    assert (
        tab.evaluate(
            "[...document.querySelectorAll('a[href^=\"#\"]')].map(a => a.getAttribute('href'))"
            ".filter(h => !document.getElementById(h.slice(1)))"
        )
        == []
    )


def test_contents_stay_beside_a_wide_page_and_leave_a_phone(page: Path, chromium: Browser) -> None:
    tab = opened(chromium, page)
    tab.evaluate("scrollTo(0, 3000)")
    tab.settle()
    assert tab.evaluate("document.querySelector('.contents').getBoundingClientRect().top") == 0
    tab.wait("document.querySelectorAll('.contents a.here').length === 1")
    phone = opened(chromium, page, 390)
    assert phone.evaluate("document.querySelector('.contents').offsetParent === null")
    assert phone.evaluate(SIDEWAYS) == 0


def test_every_plot_is_drawn_without_being_scrolled_to(page: Path, chromium: Browser) -> None:
    tab = opened(chromium, page)
    tab.wait("'pamidDrawn' in window")
    assert tab.evaluate("pamid.panels.every(p => p.chart && p.chart.data[0].length > 0)")
    assert tab.complaints == []


def test_print_opens_what_is_folded(page: Path, chromium: Browser) -> None:
    tab = opened(chromium, page)
    assert tab.evaluate("document.querySelectorAll('details:not([open])').length") > 0
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert tab.evaluate("document.querySelectorAll('details:not([open])').length") == 0
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    assert tab.evaluate("document.querySelectorAll('details[open]').length") == 0


def test_a_phone_shows_that_a_table_goes_on_and_keeps_its_first_column(
    pages: dict[str, Path], chromium: Browser
) -> None:
    tab = opened(chromium, pages["trial"], 390)
    assert tab.evaluate(SIDEWAYS) == 0
    wide = "document.querySelector('.scroll')"
    assert tab.evaluate(f"{wide}.scrollWidth > {wide}.clientWidth")
    tab.wait("getComputedStyle(document.querySelector('.copy .more')).visibility === 'visible'")
    where = f"{wide}.querySelector('td').getBoundingClientRect().left"
    before = tab.evaluate(where)
    assert tab.evaluate(f"{wide}.scrollLeft = 60, {wide}.scrollLeft") == 60
    assert tab.evaluate(where) == before
    desk = opened(chromium, pages["trial"], 1280)
    desk.settle()
    cue = "[...document.querySelectorAll('.copy .more')].map(e => getComputedStyle(e).visibility)"
    assert set(desk.evaluate(cue)) == {"hidden"}


def test_what_stands_above_already_is_quiet(page: Path, chromium: Browser) -> None:
    tab = opened(chromium, page)
    rows = (
        "[...document.querySelector('#errors-by-recording-and-model').parentElement"
        ".querySelectorAll('td.again')].length"
    )
    assert tab.evaluate(rows) > 0
    assert tab.evaluate("document.querySelectorAll('td.n.again').length") == 0


@pytest.mark.skipif(AXE is None, reason="neither axe-core-python nor PAMID_AXE is there")
@pytest.mark.parametrize("look", ["1280", "1280 dark", "390"])
@pytest.mark.parametrize(
    "kind", ["partly-explained", "explained", "unknown-effect", "trial", "comparison"]
)
def test_axe_finds_nothing(kind: str, look: str, pages: dict[str, Path], chromium: Browser) -> None:
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
