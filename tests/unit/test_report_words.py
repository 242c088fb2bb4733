"""Numbers, percentages, names and markup of the report."""

from __future__ import annotations

import pytest

from pamid.report import formatting
from pamid.report.markup import escape, prose, tag


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
def test_numbers(value: float | None, told: str) -> None:
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
def test_percentages(share: float | None, told: str) -> None:
    assert formatting.percent(share).replace(formatting.SPACE, " ") == told


def test_names_and_units() -> None:
    assert formatting.effect_label("coulomb-friction@joint_2") == "Coulomb friction at joint 2"
    assert formatting.effect_label("maxwell-slip-hysteresis") == "Maxwell slip hysteresis"
    assert (
        formatting.channel_label("pressure_1_kpa"),
        formatting.channel_unit("pressure_1_kpa"),
    ) == (
        "pressure 1",
        "kPa",
    )
    assert formatting.unit_label("m3/(s Pa)") == "m³/(s Pa)"
    assert (
        formatting.short(0.52) == "0.52"
        and formatting.short(100.0) == "100"
        and formatting.short(1e-8, 3).startswith("1\u00a0×")
    )
    assert (
        formatting.span(1.17e-8, 1.29e-8).replace(formatting.SPACE, " ") == "(1.17 to 1.29) × 10⁻⁸"
    )


def test_markup_escapes_everything_but_markup() -> None:
    assert tag("p", "<b>", tag("i", "&"), title='"') == '<p title="&#34;">&lt;b&gt;<i>&amp;</i></p>'
    assert prose("run `a<b`") == "run <code>a&lt;b</code>"
    assert escape("\x00\ud800") == "\ufffd\ufffd"


def test_no_probability_is_a_certainty() -> None:
    assert [formatting.chance(p) for p in (1.0, 0.991, 0.99, 0.0, 0.01)] == [
        "above 0.99",
        "above 0.99",
        "0.99",
        "below 0.01",
        "0.01",
    ]


def test_numbers_without_powers_that_nobody_needs() -> None:
    from pamid.base.share_words import plain_number

    assert [plain_number(x) for x in (-1441.0, 0.0, 12.345, 2.5e5, 0.00123)] == [
        "-1440",
        "0",
        "12.3",
        "250000",
        "0.00123",
    ]


def test_a_value_and_its_interval_are_told_in_one_unit() -> None:
    from pamid.report.formatting import with_interval

    told = with_interval(3.01e-5, 3.01e-5, 1.12e-4, "m").replace("\u00a0", " ")
    assert told == "0.0301 mm (95 % interval 0.0301 to 0.112 mm)"
    assert with_interval(2.0, None, None, "") == "2"
