"""Text logs: CSV of any dialect, LabVIEW measurement files, text saved by Octave.

What is decided (encoding, delimiter, decimal mark, names, columns left out) stands in the details
of the log.
"""

from __future__ import annotations

import codecs
import io
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from pamid.base.errors import FileError, listed
from pamid.base.files import TABLE, read_data
from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.dialect import (
    COMMENT,
    DELIMITERS,
    RUN,
    SAMPLE,
    SHARE_OF_ROWS,
    TextDialect,
    find_dialect,
    looks_like_unit,
)
from pamid.intake.logs.memory_budget import MemoryBudget
from pamid.intake.logs.stated_period import stated_period
from pamid.intake.logs.text_cells import MISSING_WORDS, add_column, classify, moment_kind

#: what a log is read as that is no UTF-8; they differ in letters, not in digits
OLD_ENCODINGS = ("cp1250", "cp1252", "latin-1")
#: memory that the text of a log takes, in sizes of the file, and each of its cells, bytes
ENCODED_BYTES = 1 << 12  # of a text whose encoding is looked for
ZERO_BYTES = 0.5  # more of the even or of the odd bytes are zero in UTF-16
TEXT_COPIES, CELL_BYTES = 5, 16
#: of a table with a value a row: columns that vary within a signal, and signals, at most
LONG_COLUMNS, MOST_SIGNALS = 4, 64
MOST_TURNS = 0.5  # share of rows with another signal than the row above, of signals in turn
SPARSE = 1.25  # times as many instants as such a table has where no signal lacks a value
#: text that is no table, and what to do
_MESSAGES = (
    (
        re.compile(r"[ \t]{0,40}(?:- )?(?:[A-Za-z_]\w{0,60}:(?: \S.{0,200})?|- \S{1,60}|---)?\s*$"),
        "messages with a value a line (YAML), no rows of numbers",
        "Of ROS record a bag (ros2 bag record TOPIC), or write rows: ros2 topic echo --csv TOPIC. "
        "A device that prints them puts all values of an instant into a line, u:1.2,angle:3.4. "
        "Of a YAML file save the list of records as JSON.",
    ),
    (
        re.compile(
            r"[ \t]{0,40}\(?(?:\d{1,12}\.\d{1,9})?\)?[ \t]{0,9}(?:v?can\d|\d)[ \t]{1,9}"
            r"[0-9A-Fa-f]{1,8}x?[ \t]{0,40}(?:#|[RT]x\b|\[\d\])"
        ),
        "frames of a CAN bus, whose bytes are not decoded",
        "Decode it with the DBC file of the bus, and export the signals as MDF4 or CSV (CANape, "
        "CANoe, asammdf, SavvyCAN).",
    ),
)
_SECONDS_TEXT = re.compile(r"\d{1,12}\.\d{1,12}")
ARROW, LONGEST_STAMP = "->", 40
#: bounded lengths, so that the time of a match is linear in the length of the line
_NUMBER = r"[+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,4})?|nan|inf"
_LABELLED = re.compile(
    rf"(?P<label>[^\W\d][\w./\[\]-]{{0,60}})[ \t]?[:=][ \t]?(?P<value>{_NUMBER})(?=[\s,;]|$)"
    r"(?:[ \t](?P<unit>[^\s,;:=\d]{1,12})(?=[\s,;]|$))?"
)
#: lines after the last row of numbers that may be something else
FOOTER = 20


def read_text(builder: ChannelBuilder) -> None:
    """A table of numbers in a text file, with every column as a channel without stamps; FileError
    if it is not a table or is ambiguous."""
    text, encoding = decode(builder.budget)
    text, serial = _as_table(text)
    head = text.split("\n", SAMPLE)[:SAMPLE]
    lines = [line for line in head if line.strip()]
    for pattern, what, hint in _MESSAGES:
        if sum(map(bool, map(pattern.match, lines))) >= SHARE_OF_ROWS * len(lines):
            raise FileError(f"{builder.path} contains {what}.", hint, code="messages")
    dialect = find_dialect(builder.path, head)
    start = sum(len(line) + 1 for line in head[: dialect.first])
    builder.note(f"encoding: {encoding}")
    for note in (serial, *dialect.notes) if serial else dialect.notes:
        builder.note(note)
    add_table(builder, text[start:], dialect)
    mark = "," if dialect.delimiter == "," else "\n"  # no decimal mark then
    builder.stated = stated_period(line.replace(mark, mark + " ") for line in head[: dialect.first])


def decode(budget: MemoryBudget) -> tuple[str, str]:
    """The text of the budget's file, its lines ended by "\\n", and its encoding."""
    path = budget.path
    budget.charge("its text", 0, raw=TEXT_COPIES * path.stat().st_size)
    data = read_data(path, TABLE)
    if not data.strip():
        raise FileError(f"{path} is empty.")
    halves = [data[start : 2 * ENCODED_BYTES : 2] for start in (0, 1)]
    zeros = [half.count(0) / max(1, len(half)) for half in halves]
    wide = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else ""
    if not wide and not len(data) % 2 and min(zeros) == 0.0 and max(zeros) > ZERO_BYTES:
        wide = "utf-16-be" if zeros[0] else "utf-16-le"
    if b"\0" in data and not wide:
        raise FileError(
            f"{path} is not text: it contains zero bytes.", "It may be damaged, or of another kind."
        )
    text, used = "", ""
    for used in (wide,) if wide else ("utf-8-sig", *OLD_ENCODINGS):
        try:
            text = data.decode(used)
            break
        except UnicodeDecodeError:
            continue
    else:
        raise FileError(f"{path} begins as UTF-16, but is not valid UTF-16.", "It may be damaged.")
    name = "utf-8" if used == "utf-8-sig" else used
    return text.replace("\r\n", "\n").replace("\r", "\n"), name


def add_table(builder: ChannelBuilder, text: str, dialect: TextDialect) -> None:
    """Enter the columns of rows of cells. Cells that are missing at the end of a row are an error,
    unless the log was cut there."""
    import pandas

    body, lines = _whole_rows(builder, text, dialect)
    copies, cells = TEXT_COPIES * len(body), lines * dialect.width
    builder.budget.charge("its table", cells, raw=copies + CELL_BYTES * cells)
    separator = r"\s+" if dialect.delimiter == " " else dialect.delimiter
    try:
        frame = pandas.read_csv(
            io.BytesIO(body),
            sep=separator,
            header=None,
            names=range(dialect.width),
            index_col=False,
            decimal=dialect.decimal,
            na_values=list(MISSING_WORDS),
            encoding="utf-8",
            skipinitialspace=True,
            low_memory=False,
        )
    except (ValueError, OverflowError) as error:
        raise FileError(
            f"{builder.path}: its {lines} rows from line {dialect.first + 1} on cannot be read as "
            f"a table: {error}."
        ) from error
    frame, dialect = _signal_per_column(builder, frame, dialect)
    # a column of dates is put before the times of day in another column
    places: dict[str, list[int]] = {}
    for column in range(dialect.width):
        cells = frame[column].dropna()
        if frame[column].dtype.kind not in "biuf" and len(cells):
            places.setdefault(moment_kind(str(cells.iloc[0])), []).append(column)
    dates, times = places.get("date", []), places.get("time", [])
    joined = len(dates) == len(times) == 1
    if joined:
        frame[times[0]] = frame[dates[0]].astype("string") + " " + frame[times[0]].astype("string")
        builder.note(f"{dialect.names[dates[0]]} is the date of {dialect.names[times[0]]}")
    for column, (name, unit) in enumerate(zip(dialect.names, dialect.units, strict=True)):
        series = frame[column]
        if joined and column == dates[0] or name == f"column_{column + 1}" and series.isna().all():
            continue  # what a delimiter at the end of every row makes
        add_column(builder, name, series, unit, dialect.decimal)


def _signal_per_column(
    builder: ChannelBuilder, frame: Any, dialect: TextDialect
) -> tuple[Any, TextDialect]:
    """The table with a column for each signal, where it has a row for each value: an instant, the
    signal in words, and a value or two (a historian, a database, a decoded bus). Rows of signals
    that are not sampled together have empty cells."""
    long = next(filter(None, (_long_columns(frame, words) for words in frame.columns)), None)
    if long is None:
        return frame, dialect
    words, stamp, values = long
    signals, instants = frame[words].unique(), frame[stamp].nunique()
    builder.budget.charge("its signals", instants * len(signals) * len(values))
    pairs = [(value, signal) for signal in signals for value in values]
    table = frame.pivot(index=stamp, columns=words, values=values)[pairs]
    order = frame[stamp].drop_duplicates()
    table = table.loc[order if frame[stamp].dtype.kind not in "biuf" else order.sort_values()]
    ends = [f"/{dialect.names[value]}" if len(values) > 1 else "" for value in values]
    names = (dialect.names[stamp], *(str(name) + end for name in signals for end in ends))
    units = (dialect.units[stamp], *("" for _ in names[1:]))
    table = table.reset_index()
    table.columns = range(len(names))
    builder.note(
        f"every row has the value of the signal that the column {dialect.names[words]!r} names; "
        f"each signal became a column: {listed(map(str, signals))}"
    )
    return table, replace(dialect, names=names, units=units)


def _long_columns(frame: Any, words: int) -> tuple[int, int, list[int]] | None:
    """(column of words, of stamps, those of values) of a table with a value a row; None if the
    words name no signals."""
    column = frame[words]
    if column.dtype.kind in "biuf" or not column.notna().all():
        return None
    signals = column.nunique()
    if not 1 < signals <= MOST_SIGNALS or classify(str(column.iloc[0])) != "t":
        return None
    varying = (
        place
        for place in frame.columns
        if place != words and frame.groupby(words)[place].nunique().max() > 1
    )
    others = list(islice(varying, LONG_COLUMNS))
    if not 1 < len(others) < LONG_COLUMNS:
        return None
    stamp, *values = others
    instants = frame[stamp].nunique()
    shared = instants <= SPARSE * len(frame) / signals
    turns = float((column != column.shift()).mean()) > MOST_TURNS
    # a value that only a single signal has is in a separate column already
    numbers = all(
        frame[place].dtype.kind in "biuf" and frame.groupby(words)[place].count().all()
        for place in values
    )
    enough = instants > RUN * signals and (shared or turns) and numbers
    if not enough or frame[[words, stamp]].duplicated().any():
        return None  # several values of a signal at an instant
    if frame[stamp].dtype.kind not in "biuf":
        rises = bool(moment_kind(str(frame[stamp].iloc[0])))  # dates
    else:
        rises = frame.groupby(words)[stamp].agg(lambda item: item.is_monotonic_increasing).all()
    return (words, stamp, values) if rises else None


def _whole_rows(builder: ChannelBuilder, text: str, dialect: TextDialect) -> tuple[bytes, int]:
    """The rows that have all their cells, and how many; a row cut short and lines of text at the
    end are dropped with a note."""
    if any("\n" + mark in text for mark in COMMENT):
        lines = [line for line in text.split("\n") if not line.startswith(tuple(COMMENT))]
        builder.note(f"{text.count(chr(10)) + 1 - len(lines)} lines of comment are left out")
        text = "\n".join(lines)
    ended = text.endswith("\n")
    body = (text if ended else text + "\n").encode()
    # line by line: a list of the lines would take several times the memory of the text
    delimiter = dialect.delimiter.encode()
    widths = np.fromiter((_cells(line, delimiter) for line in io.BytesIO(body)), dtype=np.intp)
    ends = np.cumsum(np.fromiter((len(line) for line in io.BytesIO(body)), dtype=np.intp))
    rows = np.flatnonzero(widths)
    if not ended and rows.size > RUN:
        builder.note("the last line has no line end and may be incomplete: it is left out")
        rows = rows[:-1]
    if '"' in text:  # delimiters in quotes: pandas counts
        return body[: ends[rows[-1]]], rows.size
    wrong = rows[widths[rows] != dialect.width]
    good = rows[widths[rows] == dialect.width]
    last = good[-1] if good.size else 0
    footer = wrong[wrong > last]
    if footer.size and footer.size <= FOOTER:
        builder.note(f"{footer.size} lines below the rows of numbers are left out")
        wrong = wrong[wrong < last]
    if wrong.size:
        line = dialect.first + 1 + int(wrong[0])
        raise FileError(
            f"{builder.path}, line {line}: {widths[wrong[0]]} cells, the others have "
            f"{dialect.width} ({DELIMITERS[dialect.delimiter]}).",
            "The log may be damaged there. Correct or delete the line.",
            code="ragged",
        )
    return body[: ends[last]], good.size


def _cells(line: bytes, delimiter: bytes) -> int:
    """Number of cells of a line, 0 for a blank line."""
    if delimiter == b" ":
        return len(line.split())
    blank = b" \n" if delimiter == b"\t" else b" \t\n"
    return line.count(delimiter) + 1 if line.strip(blank) else 0


# ---- lines of a serial monitor -----------------------------------------------------------------


def _as_table(text: str) -> tuple[str, str]:
    """(text as rows of cells, note about the conversion); the unchanged text and "" if it is not
    the output of a serial monitor: `12:33:01.123 -> 512,3.2`, `u:1.2,angle:3.4`,
    `t=0.01 u=1.2`."""
    stamps, notes = list[str](), list[str]()
    lines = text.split("\n", SAMPLE)[:SAMPLE]
    if _most(_is_stamped(line) for line in lines if line.strip()):
        parts = [line.partition(ARROW) for line in text.split("\n") if _is_stamped(line)]
        stamps = [stamp.strip() for stamp, _, _ in parts]
        text = "\n".join(rest.strip() for _, _, rest in parts) + "\n"
        lines = text.split("\n", SAMPLE)[:SAMPLE]
        notes.append("every line begins with a time and ->")
    ((labels, count),) = Counter(map(_labels, filter(str.strip, lines))).most_common(1) or [((), 0)]
    if labels and count >= SHARE_OF_ROWS * sum(map(bool, map(str.strip, lines))):
        rows = text.split("\n")
        if not stamps and _most(map(_leading_stamp, filter(str.strip, rows[:SAMPLE]))):
            stamps = [_leading_stamp(row) for row in rows]
            notes.append("every line begins with a time")
        times = [[stamp] for stamp in stamps] or [[] for _ in rows]
        # names with the units behind the numbers, if all lines agree
        matches = [
            list(_LABELLED.finditer(line)) for line in rows[:SAMPLE] if _labels(line) == labels
        ]
        units = [{line[place]["unit"] or "" for line in matches} for place in range(len(labels))]
        names = [
            f"{label} [{unit}]" if len(symbol) == 1 and unit and looks_like_unit(unit) else label
            for label, symbol in zip(labels, units, strict=True)
            for unit in (min(symbol),)
        ]
        table = [["time", *names] if stamps else names]
        for time, row in zip(times, rows, strict=False):
            if _labels(row) == labels:
                table.append([*time, *(match["value"] for match in _LABELLED.finditer(row))])
        left = sum(map(bool, map(str.strip, rows))) - len(table) + 1
        notes.append("every number follows its name")
        if left:
            notes.append(f"{left} other lines are left out")
        return "".join(";".join(row) + "\n" for row in table), "; ".join(notes)
    if not stamps:
        return text, ""
    rows = text.split("\n")[:-1]
    mark = next((m for m in DELIMITERS if _most(m in row for row in rows[:SAMPLE])), "\t")
    rows = [re.sub(r"\s+", "\t", row.strip()) if mark == " " else row for row in rows]
    mark = "\t" if mark == " " else mark
    return "".join(f"{s}{mark}{row}\n" for s, row in zip(stamps, rows, strict=True)), notes[0]


def _leading_stamp(line: str) -> str:
    """Time at the beginning of a line, before the first name, or "": "2025-03-04 10:00:00,020 INFO
    cmd=1", "[12.345678] cmd=1"."""
    first = _LABELLED.search(line)
    words = line[: first.start() if first else 0].split()[:2]
    texts = [text.strip("[](),;") for text in (" ".join(words), *words[:1])]
    return next(
        (text for text in texts if classify(text) == "d" or _SECONDS_TEXT.fullmatch(text)), ""
    )


def _is_stamped(line: str) -> bool:
    stamp, arrow, _ = line.partition(ARROW)
    return bool(arrow) and len(stamp) <= LONGEST_STAMP and classify(stamp) in "nd"


def _labels(line: str) -> tuple[str, ...]:
    """Names of the numbers of a line."""
    return tuple(match["label"] for match in _LABELLED.finditer(line))


def _most(checks: Iterable[object]) -> bool:
    """Whether nearly all checks are true, and there are any."""
    results = [bool(check) for check in checks]
    return bool(results) and sum(results) >= SHARE_OF_ROWS * len(results)


KIND = Kind("csv", (".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".prn"), read_text)
