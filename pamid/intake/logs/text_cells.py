"""Cells of a text log: classification as number, date or word, and columns as numbers."""

from __future__ import annotations

import re
from array import array
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.intake.logs.channel_builder import ChannelBuilder
from pamid.intake.logs.source_units import is_readable

_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?$")
_WITH_UNIT = (
    r"^(?P<number>[+-]?[\d.,]{1,40}(?:[eE][+-]?\d{1,4})?)\s?(?P<unit>[^\d\s.,:;+-][^\d]{0,20})$"
)
_TIME = r"(?P<hour>\d{1,3}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<fraction>\d+))?)?\s?(?P<half>[aApP][mM])?"  # noqa: E501
_DATE = (
    r"(?:(?P<year>\d{4})(?P<mark>[-/.])(?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
    r"|(?P<day_or_month>\d{1,2})(?P<other_mark>[-/.])(?P<month_or_day>\d{1,2})[-/.](?P<late_year>\d{4}|\d{2}))"
)
_ZONE = r"\s?(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?"
_MOMENT = re.compile(
    rf"^(?:{_DATE}(?:[T\s]\s*{_TIME}{_ZONE})?"
    rf"|(?:(?P<only_days>\d{{1,6}})\sdays?,?\s)?{_TIME.replace('?P<', '?P<only_')})$"
)
_DATE_PARTS = ("year", "month", "day", "day_or_month", "month_or_day", "late_year")
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}(?:(?:[ \u00a0\u202f'’]\d{3})+(?:[.,]\d+)?|(?:,\d{3})+\.\d+|(?:\.\d{3})+,\d+"
    r"|(?:,\d{3}){2,}|(?:\.\d{3}){2,})$"
)
#: could be 1.234 or 1234
_UNCLEAR = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}{re.escape(mark)}\d{{3}}$") for mark in ".,"}

_MISSING = (
    "nan NaN NAN -nan +nan NA N/A n/a #N/A null NULL None none - -- --- 1.#QNAN -1.#QNAN 1.#IND "
    "-1.#IND 1,#QNAN -1,#QNAN 1,#IND -1,#IND"
)
MISSING_WORDS = tuple(_MISSING.split())
_WORDS_OF_NUMBERS = frozenset(("inf", "-inf", "+inf", "infinity", "-infinity", "true", "false"))
_FOLDED_MISSING = frozenset(word.lower() for word in MISSING_WORDS)
TEXT_CELL = 300  # bytes of a date or a word until it is a number
#: a column of text with fewer numbers than this is a column of words
SHARE_OF_NUMBERS = 0.5


def classify(cell: str) -> str:
    """n number, e empty, d date or time of day, k number with separated thousands, t text."""
    cell = cell.strip()
    if not cell or cell.lower() in _FOLDED_MISSING:
        return "e"
    if _NUMBER.match(cell) or cell.lower() in _WORDS_OF_NUMBERS:
        return "n"
    if _MOMENT.match(cell):
        return "d"
    return "k" if _THOUSANDS.match(cell) else "t"


def moment_kind(cell: str) -> str:
    """ "date", "time" of day, "both", or "" of a cell that is neither."""
    match = _MOMENT.match(cell.strip())
    if match is None:
        return ""
    if match["only_hour"] is not None:
        return "time"
    return "date" if match["hour"] is None else "both"


def decimal_mark(cells: list[str], place: str) -> str:
    """Decimal mark, point or comma, of cells with numbers; the more frequent if both occur.

    Raises FileError if each comma may also separate thousands.
    """
    commas = [cell for cell in cells if "," in cell]
    points = sum("." in cell for cell in cells)
    if not commas or points > len(commas):
        return "."
    if all(_UNCLEAR[","].match(cell) for cell in commas):
        raise _unclear(place, commas[0])
    return ","


def add_column(builder: ChannelBuilder, name: str, series: Any, unit: str, decimal: str) -> None:
    """Enter a column of a table that pandas has read with this decimal mark.

    Raises FileError if its cells are ambiguous.
    """
    if series.dtype.kind in "biuf":
        if series.isna().all():
            builder.leave_out(name, "empty")
        else:
            builder.add(name, series.to_numpy(), unit=unit)
        return
    place = f"{builder.path}, column {name!r}"
    builder.budget.charge(name, 0, raw=TEXT_CELL * len(series))
    text = series.astype("string").str.strip()
    there = text[text.notna()]
    if len(there) and classify(str(there.iloc[0])) == "d":
        seconds = _moments(builder, name, text, place)
        builder.add(name, seconds, unit="s")
        return
    # numbers without the unit behind each ("1.25 V"), and that unit
    parts = text.str.extract(_WITH_UNIT)
    units = parts["unit"].dropna().unique()
    most = parts["unit"].notna().sum() >= SHARE_OF_NUMBERS * text.notna().sum()
    if not unit and len(units) == 1 and most and is_readable(units[0]):
        text, unit = parts["number"].where(parts["number"].notna(), text), str(units[0])
    numbers = _numbers(builder, name, text, decimal, place)
    if numbers is None:
        builder.leave_out(name, "text")
    else:
        builder.add(name, numbers, unit=unit)


def _numbers(
    builder: ChannelBuilder, name: str, text: Any, decimal: str, place: str
) -> Array | None:
    """Numbers of a column that contains words; None if it is mostly words.

    Words among numbers become NaN, with a note.
    """
    kinds = text.map(classify, na_action="ignore").fillna("e")
    thousands = text[kinds == "k"]
    if len(thousands):
        raise FileError(
            f"{place}, data row {int(thousands.index[0]) + 1}: {thousands.iloc[0]!r} has its "
            "thousands separated.",
            "Write the numbers without separators between thousands.",
            code="thousands",
        )
    there = text[kinds == "n"]
    if len(there) < SHARE_OF_NUMBERS * max(1, int(text.notna().sum())):
        return None
    marks = {mark: there[there.str.contains(mark, regex=False)] for mark in ".,"}
    other_mark = "." if decimal == "," else ","
    other = marks[other_mark]
    if len(other) and all(_UNCLEAR[other_mark].match(cell) for cell in other.unique()):
        raise _unclear(place, other.iloc[0])
    if len(marks["."]) and len(marks[","]):
        raise FileError(
            f"{place}: it contains both {marks['.'].iloc[0]!r} and {marks[','].iloc[0]!r}.",
            "Use the same decimal mark in the whole column.",
            code="decimal-mark",
        )
    if len(other):
        builder.note(f"{name}: decimal {'comma' if decimal == '.' else 'point'}, unlike the others")
    words = text[(kinds == "t") | (kinds == "d")]
    if len(words):
        builder.note(
            f"{name}: {len(words)} cells are not numbers and become empty, the first is "
            f"{words.iloc[0]!r} in data row {int(words.index[0]) + 1}"
        )
    clean = (
        text.where(kinds == "n")
        .str.replace(",", ".")
        .str.lower()
        .replace({"true": "1", "false": "0"})
        .str.replace(r"(?<=[\d.])d(?=[-+\d])", "e", regex=True)  # as Fortran writes it
    )
    return np.asarray(clean.astype(object).fillna("nan").to_numpy().astype(np.float64))


def _moments(builder: ChannelBuilder, name: str, text: Any, place: str) -> Array:
    """Dates, times of day or both as s since the first; NaN for other cells.

    Times of day continue past midnight.
    """
    # numbers at once: the matches of all cells would need a kilobyte per row
    numbers, valid = array("d"), np.zeros(len(text), dtype=bool)
    dotted = False
    for row, cell in enumerate(text.fillna("")):
        if match := _MOMENT.match(cell):
            valid[row] = True
            numbers.extend(_time_of_day(match))
            numbers.extend(float(part or "nan") for part in match.group(*_DATE_PARTS))
            dotted = dotted or match["other_mark"] == "."
    lost = text[text.notna() & ~valid]
    if len(lost):
        builder.note(
            f"{name}: {len(lost)} cells are not times and become empty, the first is "
            f"{lost.iloc[0]!r}"
        )
    seconds, fractions, *parts = np.array(numbers).reshape(-1, 2 + len(_DATE_PARTS)).T
    days = _days(*parts, dotted=dotted, place=place)
    if np.isnan(days).all():
        days = np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200.0)
        if days[-1]:
            builder.note(f"{name}: the time continues past {int(days[-1])} midnights")
    builder.note(f"{name}: dates or times, in s since {text[valid].iloc[0]}")
    days, seconds, fractions = (x - x[0] for x in (days, seconds, fractions))
    moments = np.full(len(text), np.nan)
    moments[valid] = days * 86400.0 + seconds + fractions
    return moments


def _time_of_day(match: re.Match[str]) -> tuple[float, float]:
    """Whole seconds since midnight UTC, more than a day for counted days, and the rest."""
    part = {key.removeprefix("only_"): text for key, text in match.groupdict().items() if text}
    days, hours, minutes, seconds = (
        int(part.get(key, 0)) for key in ("days", "hour", "minute", "second")
    )
    if half := part.get("half"):
        hours = hours % 12 + (12 if half.lower() == "pm" else 0)
    zone = part.get("zone", "UTC")
    if zone[0] in "+-":
        minutes -= int(zone[0] + "1") * (60 * int(zone[1:3]) + int(zone[-2:]))
    fraction = float(f"0.{part.get('fraction', 0)}")
    return ((days * 24 + hours) * 60 + minutes) * 60.0 + seconds, fraction


def _days(
    year: Array,
    month: Array,
    day: Array,
    first: Array,
    second: Array,
    late_year: Array,
    *,
    dotted: bool,
    place: str,
) -> Array:
    """Days since 1970; NaN without a date. Raises FileError if the month is ambiguous.

    first, second: day and month in unknown order. dotted: whether points separate them.
    """
    if np.isnan(first).all():
        return _counted_days(year, month, day)
    year = np.where(late_year < 100, late_year + 2000, late_year)
    day_first, month_first = _counted_days(year, second, first), _counted_days(year, first, second)
    if dotted or np.nanmax(first) > 12:
        return day_first
    if np.nanmax(second) > 12:
        return month_first
    # dates of a log rise by a day at most; in the wrong order they jump by months
    steps = (np.diff(days[np.isfinite(days)]) for days in (day_first, month_first))
    leaps = [bool(((step < 0.0) | (step > 1.0)).any()) for step in steps]
    if leaps == [True, False]:
        return month_first
    if leaps == [True, True]:
        message = f"{place}: the dates do not show which number is the month."
        raise FileError(message, "Write dates as 2024-12-31.", code="date-order")
    return day_first


def _counted_days(year: Array, month: Array, day: Array) -> Array:
    """Days since 1970 of year, month and day; NaN without a date."""
    there = ~np.isnan(year)
    months = np.where(there, (year - 1970) * 12 + month - 1, 0).astype(np.int64)
    first = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    days = first + np.where(there, day, 1) - 1
    return np.where(there, days, np.nan)


def _unclear(place: str, cell: str) -> FileError:
    return FileError(
        f"{place}: {cell!r} may be a decimal number or have its thousands separated.",
        "Write the numbers with more or fewer than three decimals.",
        code="thousands",
    )
