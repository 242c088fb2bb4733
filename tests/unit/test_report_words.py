"""Numbers, percentages, names and markup of the report."""

import pytest

from pamid.base.share_words import minutes_text
from pamid.report import formatting
from pamid.report.markup import escape, prose, tag
from pamid.report.page import Page, Section, html_of, strong, table, text


@pytest.mark.parametrize(
    "value, told",
    [
        (0.0, "0"),
        (0.52, "0.520"),
        (1234.5, "1234"),
        (-2.0, "\u22122.00"),
        (0.00123, "0.00123"),
        (0.9996, "1.00"),
        (1.234e-8, "1.23 × 10⁻⁸"),
        (9.999e-8, "1.00 × 10⁻⁷"),
        (5e7, "5.00 × 10⁷"),
        (None, "\u2013"),
    ],
)
def test_numbers(value, told):
    assert formatting.number(value).replace(formatting.SPACE, " ") == told


@pytest.mark.parametrize(
    "share, told",
    [
        (0.784, "78 %"),
        (0.996, "99.6 %"),
        (0.9999, "99.9 %"),
        (1.0, "100 %"),
        (0.004, "0.4 %"),
        (0.0, "0 %"),
        (-0.9, "\u221290 %"),
        (-0.0001, "0 %"),
        (None, "\u2013"),
    ],
)
def test_percentages(share, told):
    assert formatting.percent(share).replace(formatting.SPACE, " ") == told


@pytest.mark.parametrize(
    ("minutes", "told"), [(8.0, "8 min"), (1.0, "1 min"), (0.67, "40 s"), (0.0017, "0.1 s")]
)
def test_short_experiments_are_told_in_seconds(minutes, told):
    assert minutes_text(minutes) == told


def test_markup_escapes_everything_but_markup():
    assert tag("p", "<b>", tag("i", "&"), title='"') == '<p title="&#34;">&lt;b&gt;<i>&amp;</i></p>'
    assert prose("run `a<b`") == "run <code>a&lt;b</code>"
    assert escape("\x00\ud800") == "\ufffd\ufffd"


def test_a_page_lists_its_headings_down_to_the_third_level():
    inner = Section("Known <b>", (Section("Deep", (), 4), text("one", "")), 3)
    page = Page("Head", "sub", (Section("", (Section("Lead.", (), question="Where"),)), inner))
    html = html_of(page)
    assert [one.contents for one in page.sections] == [
        [(2, "Where", "where")],
        [(3, "Known <b>", "known-b")],
    ]
    assert '<h3 id="known-b">Known &lt;b&gt;</h3>' in html and "<p>one</p>" in html
    assert html.count("<section>") == 4 and "<title>Head</title>" in html


def test_a_table_marks_cells_that_repeat_the_row_above():
    html = table(["a", "b", "n"], [["x", "<y>", "1"], ["x", strong("z"), "1"]], (2,))
    assert html.count(' class="again"') == 1 and html.count('<td class="n">1</td>') == 2
    assert "&lt;y&gt;" in html and "<strong>z</strong>" in html
