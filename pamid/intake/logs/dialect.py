"""Dialect of a text log: delimiter, decimal mark, names, units and first line of numbers."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError
from pamid.intake.logs.text_cells import classify, decimal_mark
from pamid.recording.recording import MIN_SAMPLES

#: in the order of preference if two give the same result; a blank is any run of blanks
DELIMITERS = {";": "semicolon", "\t": "tab", "|": "bar", ",": "comma", " ": "blanks"}
#: lines that are examined
SAMPLE = 1000
#: consecutive rows of numbers at the beginning of a table
RUN = 3
#: share of the rows with numbers that have only numbers; below it there are columns of text
SHARE_OF_ROWS = 0.9
COMMENT = "#%"

_ATOM = (
    r"(?:[numcµμkMGhd]?(?:s|m|g|V|A|N|Nm|Pa|W|Hz|J|l|L|bar|mol|rad|Ohm|Ω|deg)|°C?|˚|º|K|C|F|deg[CF]?|degrees?|grad"
    r"|psi|rpm|min|h|sec|seconds?|volts?|amps?|inch|in|lbf|rev|turns|%|1|-|U/min|hPa|mmHg|atm|bar[ag]|kgf)"
    r"(?:\^?-?[0-9²³]+)?"
)
_UNIT = re.compile(rf"{_ATOM}(?:(?:\s?[*/·⋅.]\s?| ){_ATOM})*$", re.IGNORECASE)
#: longest unit in a header
LONGEST_UNIT = 40
_BRACKETED = re.compile(r"\s*[\[(<{]\s*(?P<unit>[^\[\](){}<>]*?)\s*[\])>}]$")
#: "t / s", "Winkel in °", "Temp, °C (LGR S/N: 1)": a unit behind the name without brackets
_BEHIND_NAME = re.compile(
    r"(?P<name>.*?[^\s,/])(?:\s*,\s+|\s+/\s*|\s+in\s+)(?P<unit>[^\s,()\[\]]+)(?:\s*\([^()]*\))?"
)
#: first cell of rows above the numbers with the names or units of the columns
_NAME_LABELS = frozenset(("name", "names", "tracename", "channel", "signal", "kanal", "title"))
_UNIT_LABELS = frozenset(("unit", "units", "vunit", "einheit", "einheiten"))
_BEFORE_UNIT = re.compile(r"^(?:in|en|units?:?|einheit:?)\s+", re.IGNORECASE)
#: share of cells that look like units, from which on a row holds units
MOST_UNITS = 0.5


@dataclass(frozen=True)
class TextDialect:
    """Dialect of a text log: names and units by column, index of the first line of numbers, and the
    decisions in words (notes)."""

    delimiter: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class _Guess:
    """Lines split at a delimiter."""

    delimiter: str
    rows: list[list[str]]  # cells; [] for a blank line
    kinds: list[str]  # a letter for each cell, see cells.classify
    first: int
    width: int
    count: int  # rows of numbers

    @classmethod
    def of(cls, lines: Sequence[str], delimiter: str) -> _Guess | None:
        """Lines split at a delimiter; None without rows of numbers."""
        rows = [cut_line(line.lstrip(COMMENT), delimiter) for line in lines]
        kinds = [
            "t" * len(row)
            if line.startswith(tuple(COMMENT))
            else "".join(classify(cell) for cell in row)
            for line, row in zip(lines, rows, strict=True)
        ]
        strict = _run(kinds, lambda kind: "t" not in kind and any(k in kind for k in "ndk"))
        loose = _run(kinds, lambda kind: len(kind) > 1 and any(k in kind for k in "nd"))
        few = strict and loose and strict[1] == loose[1] and strict[2] < SHARE_OF_ROWS * loose[2]
        chosen = loose if strict is None or few else strict  # loose: some columns are text
        return cls(delimiter, rows, kinds, *chosen) if chosen else None

    def text_above(self, line: int) -> int | None:
        """Index of the last line with text above this one."""
        return next((index for index in range(line - 1, -1, -1) if any(self.rows[index])), None)

    @property
    def above(self) -> int | None:
        """Index of the last line with text above the numbers."""
        return self.text_above(self.first)

    @property
    def header_fits(self) -> bool:
        return self.above is not None and _fits(self.rows[self.above], self.width)


def find_dialect(path: Path, lines: Sequence[str]) -> TextDialect:
    """Dialect in which most of the first lines are rows of numbers.

    Raises FileError if no line is, if they are ambiguous, or if the names do not fit the numbers.
    """
    guesses = [*filter(None, (_Guess.of(lines[:SAMPLE], delimiter) for delimiter in DELIMITERS))]
    if not guesses:
        raise FileError(
            f"{path}: there are no rows of numbers in its first {min(SAMPLE, len(lines))} lines.",
            "A log needs rows of numbers below a row of names.",
            code="no-numbers",
        )
    for guess in guesses:
        rows = [kinds for kinds in guess.kinds if kinds]
        wider = len(lines) < SAMPLE and guess.width > max(len(rows), MIN_SAMPLES)
        if wider and len(rows) > 1 and all(kinds[0] == "t" for kinds in rows):
            raise FileError(
                f"{path}: the signals are rows, not columns: {len(rows)} rows of {guess.width} "
                "cells.",
                "Transpose the table: in pandas, read_csv(FILE, sep="
                f"{guess.delimiter!r}, header=None).T.to_csv('log.csv', header=0, index=0).",
                code="signals-in-rows",
            )
    # a delimiter loses the few rows with a remark, so near counts are equally good
    most = max(guess.count for guess in guesses)
    near = [guess for guess in guesses if guess.count >= SHARE_OF_ROWS * most]
    best = max(near, key=lambda guess: (guess.header_fits, guess.count, guess.width))
    cells = []
    table = zip(best.rows[best.first :], best.kinds[best.first :], strict=True)
    for line, (row, kinds) in enumerate(table, best.first + 1):
        if len(row) != best.width:
            continue
        if "k" in kinds:
            raise FileError(
                f"{path}, line {line}: {row[kinds.index('k')]!r} has its thousands separated.",
                "Write the numbers without separators between thousands.",
                code="thousands",
            )
        cells += [cell.strip() for cell, kind in zip(row, kinds, strict=True) if kind == "n"]
    named = best.header_fits  # a name for each number gives the number of cells
    marked = any("." in cell or "," in cell for cell in cells)
    if best.delimiter == "," and best.width > 1 and not named and not marked:
        shown = ",".join(best.rows[best.first])
        raise FileError(
            f"{path}, line {best.first + 1}: {shown!r} does not show which commas are "
            "decimal marks and which are delimiters.",
            "Write decimal points, separate the numbers by semicolons, or add a row of names, a "
            "name for each number.",
            code="two-commas",
        )
    decimal = decimal_mark(cells, str(path))
    above = best.above
    if (
        above
        and "t" not in best.kinds[above]
        and len(best.kinds[above - 1]) == best.width
        and ("n" in best.kinds[above - 1])
    ):
        raise FileError(
            f"{path}, line {above + 1}: {len(best.rows[above])} cells, the others have "
            f"{best.width}.",
            "The log may be damaged there. Correct or delete the line.",
            code="ragged",
        )
    names, units, notes = _names(path, best)
    word = DELIMITERS[best.delimiter] if best.width > 1 else "none, a single column"
    decided = f"delimiter: {word}; decimal {'comma' if decimal == ',' else 'point'}"
    return TextDialect(
        best.delimiter, decimal, tuple(names), tuple(units), best.first, (decided, *notes)
    )


def cut_line(line: str, delimiter: str) -> list[str]:
    """Cells of a line without quotes; [] for a blank line."""
    if not line.strip():
        return []
    if delimiter == " ":
        line = line.strip().replace("\t", " ")
    row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in row]


def split_unit(name: str) -> tuple[str, str]:
    """A name and the unit in brackets behind it: "p [bar]" -> ("p", "bar"); "p (1)" is not
    changed."""
    if len(name) > 5 * LONGEST_UNIT:
        return name, ""
    match, behind = _BRACKETED.search(name), _BEHIND_NAME.fullmatch(name)
    pairs = [(name[: match.start()], match["unit"])] if match and match.start() else []
    pairs += [(behind["name"], behind["unit"])] if behind else []
    measured = ((n, u) for n, u in pairs if looks_like_unit(u) and u not in ("1", "-"))
    return next(measured, (name, ""))


def looks_like_unit(text: str) -> bool:
    """True for kPa, [ms], m/s^2, °, -, % ..."""
    if len(text) > LONGEST_UNIT:
        return False
    match = _BRACKETED.fullmatch(text)
    return bool(_UNIT.match(match["unit"] or "-" if match else text))


def _run(kinds: list[str], is_data: Callable[[str], bool]) -> tuple[int, int, int] | None:
    """(first, width, count) of the data rows of the most common width, from the first RUN
    consecutive ones on; None if there are not so many."""
    there = [index for index, kind in enumerate(kinds) if kind]
    data = {index for index in there if is_data(kinds[index])}
    widths = Counter(len(kinds[index]) for index in data)
    for width, count in widths.most_common():
        rows = [index in data and len(kinds[index]) == width for index in there]
        for position in range(len(there)):
            following = rows[position : position + RUN]
            if all(following) and (
                len(following) == RUN or position == 0 or not rows[position - 1]
            ):
                return _first_row(position, rows, there, kinds, width), width, count
    return None


def _first_row(
    position: int, rows: list[bool], there: list[int], kinds: list[str], width: int
) -> int:
    """First line of the table that contains the row at `position` of the lines that are not blank.

    The table continues above single rows with an odd word, and with rows of words in columns that
    are empty below.
    """
    while position >= 2 and rows[position - 2]:
        odd = kinds[there[position - 1]]
        if len(odd) != width or "n" not in odd:
            break
        position -= 2
        while position and rows[position - 1]:
            position -= 1
    start = there[position]
    below = kinds[start]
    while (
        "e" in below
        and start
        and len(kinds[start - 1]) == len(below)
        and all(kind in ("e", item) for item, kind in zip(kinds[start - 1], below, strict=True))
    ):
        start -= 1
    return start


def _fits(row: list[str], width: int) -> bool:
    """Whether these are names of `width` columns; empty names at the end do not count."""
    full = len("".join(cell[:1] or " " for cell in row).rstrip())
    return full == width or (full < width <= len(row)) or (full == width - 1 and width > 2)


def _names(path: Path, guess: _Guess) -> tuple[list[str], list[str], list[str]]:
    """Names and units of the columns, with notes."""
    numbered = [f"column_{column + 1}" for column in range(guess.width)]
    none = [""] * guess.width
    above = guess.above
    if labelled := _labelled(guess):
        return labelled
    if above is None or (guess.width > 1 and len([*filter(None, guess.rows[above])]) == 1):
        note = (
            f"no row of names above line {guess.first + 1}: the columns are column_1 to "
            f"column_{guess.width}"
        )
        return numbered, none, [note]
    if not guess.header_fits:
        row = guess.rows[above]
        if "n" in guess.kinds[above]:
            raise FileError(
                f"{path}: line {above + 1} has {len(row)} cells, the numbers from line "
                f"{guess.first + 1} on have {guess.width}.",
                "If the log has several kinds of rows, extract a single kind: grep '^IMU,' FILE > "
                "imu.csv.",
                code="header",
            )
        raise FileError(
            f"{path}: line {above + 1} has {len(row)} names ({', '.join(row[:8])}), the numbers "
            f"from line {guess.first + 1} on have {guess.width} columns.",
            "Give each column a single name.",
            code="header",
        )
    lowest, above = above, _line_of_names(guess, above)
    row = _padded(guess.rows[above], guess.width)
    units, notes = none, [f"names: line {above + 1}"]
    for below in range(above + 1, lowest + 1):
        if _are_units(guess.rows[below], row):
            units = [_bare(cell) for cell in _padded(guess.rows[below], guess.width)]
            notes = [f"names: line {above + 1}; units: line {below + 1}"]
    higher = guess.text_above(above)
    upper = guess.rows[higher] if higher is not None else []
    if higher is not None and _fits(upper, guess.width) and _are_units(row, upper):
        units = [_bare(cell) for cell in row]
        row = _padded(upper, guess.width)
        notes = [f"names: line {higher + 1}; units: line {above + 1}"]
        above = higher
    pairs = [split_unit(name) for name in row]
    if len({name for name, _ in pairs}) < len(set(row)):  # names that differ by their unit only
        pairs = [(name, unit) for name, (_, unit) in zip(row, pairs, strict=True)]
    names = [name or numbered[column] for column, (name, _) in enumerate(pairs)]
    if above:
        notes.append(f"{above} lines above the names are left out")
    symbols = [unit or bracketed for unit, (_, bracketed) in zip(units, pairs, strict=True)]
    return names, symbols, notes


def _line_of_names(guess: _Guess, lowest: int) -> int:
    """Lowest line of the head with complete, different cells that are not numbers.

    Lines below it have other contents, as the averaging of the logger or the type of a value.
    """
    for line in range(lowest, -1, -1):
        row = guess.rows[line]
        if not row or not _fits(row, guess.width):
            break
        cells = set(row[: guess.width])
        if len(cells) == guess.width and all(cell and classify(cell) != "n" for cell in cells):
            return line
    return lowest


def _labelled(guess: _Guess) -> tuple[list[str], list[str], list[str]] | None:
    """Names and units in rows with such a label in their first cell: "Name;Torque;Angle".

    The label may also precede each name (Name;Torque;Name;Angle). None without such a row.
    """
    cells: dict[str, list[str]] = {}
    for row in filter(None, guess.rows[: guess.first]):
        label = row[0].lower()
        kind = "names" if label in _NAME_LABELS else "units" if label in _UNIT_LABELS else ""
        label_column = guess.kinds[guess.first][0] == "e" or row.count(row[0]) > 1
        if kind and label_column and _fits(row, guess.width):
            cells[kind] = ["" if cell.lower() == label else cell for cell in row]
    if "names" not in cells:
        return None
    names = _padded(cells["names"], guess.width)
    named = [name or f"column_{column + 1}" for column, name in enumerate(names)]
    units = [_bare(cell) for cell in _padded(cells.get("units", []), guess.width)]
    return named, units, ["names and units: the rows that say so in their first cell"]


def _padded(row: list[str], width: int) -> list[str]:
    return (row + [""] * width)[:width]


def _are_units(row: list[str], above: list[str]) -> bool:
    """Whether a row has the units of the names above.

    Most cells look like units, and more than in the row of names. Unknown units, as counts, may
    occur.
    """
    shares = []
    for cells in (row, above):
        written = [cell for cell in cells if classify(cell) == "t" or cell == "-"]
        alike = [looks_like_unit(_bare(cell)) or _BRACKETED.fullmatch(cell) for cell in written]
        shares.append(sum(map(bool, alike)) / max(1, len(alike)))
    return shares[0] >= MOST_UNITS and shares[0] > shares[1]


def _bare(cell: str) -> str:
    """A unit without its brackets and the word before it: "[kPa]", "in kPa"."""
    match = _BRACKETED.fullmatch(cell)
    unit = _BEFORE_UNIT.sub("", match["unit"] if match else cell)
    return "" if unit == "-" else unit
