"""Cells of a text log: classification as number, date or word, and columns as numbers."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from pamid.base.errors import FileError
from pamid.base.metrics import FloatArray
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
#: rows whose dates are parsed at a time
PARTED_ROWS = 1 << 16
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
) -> FloatArray | None:
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
    return _floats(clean)


def _moments(builder: ChannelBuilder, name: str, text: Any, place: str) -> FloatArray:
    """Dates, times of day or both as s since the first; NaN for other cells.

    Times of day continue past midnight.
    """
    parts = _parts(text)
    lost = text.notna() & parts.isna().all(axis=1)
    if lost.any():
        builder.note(
            f"{name}: {int(lost.sum())} cells are not times and become empty, the first is "
            f"{text[lost].iloc[0]!r}"
        )

    def part(*names: str, missing: float = 0.0) -> FloatArray:
        column = parts[names[0]].astype(object)
        for other in names[1:]:
            column = column.fillna(parts[other].astype(object))
        numbers = _floats(column)
        return np.where(np.isnan(numbers), missing, numbers)

    days = _days(parts, part, place)
    hours = part("hour", "only_hour")
    half = parts["half"].astype(object).fillna(parts["only_half"].astype(object)).str.lower()
    hours = np.where(half.notna(), hours % 12, hours)
    hours = hours + np.where((half == "pm").fillna(False), 12.0, 0.0)
    # offsets of time zones from UTC, s; 0 if none is written
    zones = parts["zone"].astype(object)
    offsets = {zone: 0.0 for zone in zones.dropna().unique()}
    for zone in offsets:
        if zone[0] in "+-":
            sign = -1.0 if zone[0] == "-" else 1.0
            offsets[zone] = sign * (int(zone[1:3]) * 3600 + int(zone[-2:]) * 60)
    digits = parts["fraction"].astype(object).fillna(parts["only_fraction"].astype(object))
    fractions = np.nan_to_num(_floats("0." + digits))
    seconds = (
        part("only_days") * 86400
        + hours * 3600
        + part("minute", "only_minute") * 60
        + part("second", "only_second")
        - np.nan_to_num(_floats(zones.map(offsets)))
    )
    if np.isnan(days).all():
        days = np.zeros(len(text))
        nights = np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200.0)
        if nights[-1]:
            builder.note(f"{name}: the time continues past {int(nights[-1])} midnights")
        days += nights
    valid = parts.notna().any(axis=1).to_numpy()
    first = np.flatnonzero(valid)[0]
    builder.note(f"{name}: dates or times, in s since {text.iloc[first]}")
    days, seconds, fractions = (x - x[first] for x in (days, seconds, fractions))
    return np.where(valid, days * 86400.0 + seconds + fractions, np.nan)


def _parts(text: Any) -> Any:
    """Named parts of dates and times, a column each.

    The columns are categories, because separate texts would need a kilobyte per row.
    """
    import pandas

    pieces = [
        text.iloc[start : start + PARTED_ROWS].str.extract(_MOMENT).astype("category")
        for start in range(0, max(len(text), 1), PARTED_ROWS)
    ]
    columns = {
        name: pandas.api.types.union_categoricals([piece[name] for piece in pieces])
        for name in pieces[0]
    }
    return pandas.DataFrame(columns, index=text.index)


def _days(parts: Any, part: Any, place: str) -> FloatArray:
    """Days since 1970; NaN without a date. Raises FileError if the month is ambiguous."""
    nan = float("nan")
    first, second = part("day_or_month", missing=nan), part("month_or_day", missing=nan)
    year = part("late_year", missing=nan)
    year = np.where(year < 100, year + 2000, year)
    if np.isnan(first).all():
        return _counted_days(*(part(name, missing=nan) for name in ("year", "month", "day")))
    day_first, month_first = _counted_days(year, second, first), _counted_days(year, first, second)
    if (parts["other_mark"] == ".").any() or np.nanmax(first) > 12:
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


def _counted_days(year: FloatArray, month: FloatArray, day: FloatArray) -> FloatArray:
    """Days since 1970 of year, month and day; NaN without a date."""
    there = ~np.isnan(year)
    months = np.where(there, (year - 1970) * 12 + month - 1, 0).astype(np.int64)
    first = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    days = first + np.where(there, day, 1) - 1
    return np.where(there, days, np.nan)


def _floats(cells: Any) -> FloatArray:
    """Numbers of a column of texts; NaN for an empty cell."""
    return np.asarray(cells.astype(object).fillna("nan").to_numpy().astype(np.float64))


def _unclear(place: str, cell: str) -> FileError:
    return FileError(
        f"{place}: {cell!r} may be a decimal number or have its thousands separated.",
        "Write the numbers with more or fewer than three decimals.",
        code="thousands",
    )
