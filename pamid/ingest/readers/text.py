"""Text logs: CSV of any dialect, LabVIEW measurement files, text saved by Octave.

What is decided (encoding, delimiter, decimal mark, names, columns left out) stands in the details
of the log.
"""

from __future__ import annotations

import codecs
import io
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import FileError
from pamid.base.files import TABLE, read_data
from pamid.ingest.cells import MISSING_WORDS, add_column, classify, moment_kind
from pamid.ingest.channels import Log
from pamid.ingest.dialect import COMMENT, DELIMITERS, RUN, SAMPLE, TextDialect, find_dialect
from pamid.ingest.gathering import Gathering
from pamid.ingest.log_kinds import Kind
from pamid.ingest.memory_budget import MemoryBudget
from pamid.ingest.serial_lines import as_table

#: what a log is read as that is no UTF-8; they differ in letters, not in digits
OLD_ENCODINGS = ("cp1250", "cp1252", "latin-1")
#: memory that the text of a log takes, in sizes of the file, and each of its cells, bytes
TEXT_COPIES, CELL_BYTES = 5, 16
COUNTED_BYTES = 1 << 24  # bytes of text in which cells are counted at a time
#: of a table with one value a row: columns, and signals, at most
LONG_COLUMNS, MOST_SIGNALS = 4, 64
SPARSE = 1.25  # times as many instants as such a table has where no signal lacks a value
#: lines after the last row of numbers that may be something else
FOOTER = 20


def read_text(path: Path) -> Log:
    """A table of numbers in a text file. Every column is a channel without stamps; FileError if it
    is no table or can be read in two ways."""
    gathering = Gathering(path)
    text, encoding = decode(gathering.budget)
    text, serial = as_table(text)
    head = text.split("\n", SAMPLE)[:SAMPLE]
    dialect = find_dialect(path, head)
    start = sum(len(line) + 1 for line in head[: dialect.first])
    gathering.note(f"encoding: {encoding}")
    for note in (serial, *dialect.notes) if serial else dialect.notes:
        gathering.note(note)
    add_table(gathering, text[start:], dialect, path)
    return gathering.log(path, "csv")


def decode(budget: MemoryBudget) -> tuple[str, str]:
    """The text of the budget's file, its lines ended by "\\n", and its encoding."""
    path = budget.path
    budget.charge("its text", 0, raw=TEXT_COPIES * path.stat().st_size)
    data = read_data(path, TABLE)
    if not data.strip():
        raise FileError(f"{path} is empty.")
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if b"\0" in data and not wide:
        raise FileError(
            f"{path} is no text: there are zero bytes in it.",
            "It may be damaged, or of another kind.",
        )
    text, used = "", ""
    for used in ("utf-16",) if wide else ("utf-8-sig", *OLD_ENCODINGS):
        try:
            text = data.decode(used)
            break
        except UnicodeDecodeError:
            continue
    else:
        raise FileError(f"{path} is no text in UTF-16, though it begins so.", "It may be damaged.")
    name = "utf-8" if used == "utf-8-sig" else used
    return text.replace("\r\n", "\n").replace("\r", "\n"), name


def add_table(
    gathering: Gathering, text: str, dialect: TextDialect, path: Path, *, stamps: Any = None
) -> None:
    """Enter the columns of rows of cells. Cells that are missing at the end of a row are an error,
    unless the log was cut there."""
    import pandas

    body, lines = _whole_rows(gathering, text, dialect, path)
    copies, cells = TEXT_COPIES * len(body), lines * dialect.width
    gathering.budget.charge("its table", cells, raw=copies + CELL_BYTES * cells)
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
            f"{path}: its {lines} rows from line {dialect.first + 1} on cannot be read as a table: "
            f"{error}."
        ) from error
    _refuse_long(frame, dialect, path)
    dates = _joined_dates(gathering, frame, dialect)
    for column, (name, unit) in enumerate(zip(dialect.names, dialect.units, strict=True)):
        series = frame[column]
        if column == dates or name == f"column_{column + 1}" and series.isna().all():
            continue  # what a delimiter at the end of every row makes
        add_column(gathering, name, series, unit, dialect.decimal, str(path))


def _joined_dates(gathering: Gathering, frame: Any, dialect: TextDialect) -> int | None:
    """The column of dates that was put before the times of day in another one; None where there
    are not one of each."""
    places: dict[str, list[int]] = {}
    for column in range(dialect.width):
        cells = frame[column].dropna()
        if frame[column].dtype.kind not in "biuf" and len(cells):
            places.setdefault(moment_kind(str(cells.iloc[0])), []).append(column)
    dates, times = places.get("date", []), places.get("time", [])
    if len(dates) != 1 or len(times) != 1:
        return None
    frame[times[0]] = frame[dates[0]].astype("string") + " " + frame[times[0]].astype("string")
    gathering.note(f"{dialect.names[dates[0]]} is the date of {dialect.names[times[0]]}")
    return dates[0]


def _refuse_long(frame: Any, dialect: TextDialect, path: Path) -> None:
    """FileError for a table with one value a row, whose signal stands in a column of words."""
    for words, name in enumerate(dialect.names):
        column = frame[words]
        if dialect.width > LONG_COLUMNS or column.dtype.kind in "biuf" or not column.notna().all():
            continue
        signals = column.nunique()
        if not 1 < signals <= MOST_SIGNALS or classify(str(column.iloc[0])) != "t":
            continue
        for stamps in (place for place in range(dialect.width) if place != words):
            instants = frame[stamps].nunique()
            shared = RUN * signals < instants <= SPARSE * len(frame) / signals
            if shared and not frame[[words, stamps]].duplicated().any():
                raise FileError(
                    f"{path}: every row holds one value, of the signal that is named in the "
                    f"column {name!r}.",
                    "Give every signal a column: in pandas, table.pivot(index="
                    f"{dialect.names[stamps]!r}, columns={name!r}, values=...).",
                    code="long-table",
                )


def _whole_rows(
    gathering: Gathering, text: str, dialect: TextDialect, path: Path
) -> tuple[bytes, int]:
    """The rows that have all their cells, and how many; a row cut short and lines of text at the
    end are dropped and said."""
    if any("\n" + mark in text for mark in COMMENT):
        lines = [line for line in text.split("\n") if not line.startswith(tuple(COMMENT))]
        gathering.note(f"{text.count(chr(10)) + 1 - len(lines)} lines of comment are left out")
        text = "\n".join(lines)
    ended = text.endswith("\n")
    body = (text if ended else text + "\n").encode()
    widths, ends = _widths(body, dialect.delimiter)
    rows = np.flatnonzero(widths)
    if not ended and rows.size > RUN:
        gathering.note("the last line has no line end, so it may be cut: it is left out")
        rows = rows[:-1]
    if '"' in text:  # delimiters in quotes: pandas counts
        return body[: ends[rows[-1]] + 1], rows.size
    wrong = rows[widths[rows] != dialect.width]
    good = rows[widths[rows] == dialect.width]
    last = good[-1] if good.size else 0
    footer = wrong[wrong > last]
    if footer.size and footer.size <= FOOTER:
        gathering.note(f"{footer.size} lines below the rows of numbers are left out")
        wrong = wrong[wrong < last]
    if wrong.size:
        line = dialect.first + 1 + int(wrong[0])
        raise FileError(
            f"{path}, line {line}: {widths[wrong[0]]} cells, the others have {dialect.width} "
            f"({DELIMITERS[dialect.delimiter]}).",
            "The log may be damaged there; mend or cut the line.",
            code="ragged",
        )
    return body[: ends[last] + 1], good.size


def _widths(body: bytes, delimiter: str) -> tuple[Any, Any]:
    """Cells of every line, 0 for a blank one, and where the lines end; body ends with a line
    end."""
    data = np.frombuffer(body, dtype=np.uint8)
    pieces, begin = list[tuple[Any, Any]](), 0
    while begin < len(body):  # piece by piece: the masks take several times the memory of the text
        end = body.find(b"\n", min(begin + COUNTED_BYTES, len(body) - 1)) + 1
        cells, ends = _piece_widths(data[begin:end], delimiter)
        pieces.append((cells, ends + begin))
        begin = end
    return np.concatenate([cells for cells, _ in pieces]), np.concatenate([e for _, e in pieces])


def _piece_widths(data: Any, delimiter: str) -> tuple[Any, Any]:
    ends = np.flatnonzero(data == 10)
    blank = (data == 32) | (data == 9) | (data == 10)
    starts = ~blank & np.concatenate(([True], blank[:-1]))
    words = _count(starts, ends)
    if delimiter == " ":
        return words, ends
    marks = _count(data == ord(delimiter), ends)
    if delimiter == "\t":
        return np.where(words + marks, marks + 1, 0), ends
    return np.where(words, marks + 1, 0), ends


def _count(there: Any, ends: Any) -> Any:
    """True cells of `there` in each of the lines that end at `ends`."""
    return np.diff(np.searchsorted(np.flatnonzero(there), ends), prepend=0)


KIND = Kind("csv", (".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".prn"), read_text)
