"""Faults of a recording's files, with file, column and line.

Refused: missing, empty or header-only file; a first column other than `time_s`; a column twice or
without a name; a cell that is empty, no number, not finite or beyond 1e30 in any unit; a row of the
wrong length; stamps repeated, unsorted, with a gap or uneven by more than 1 %, too large for their
spacing, or as far apart as no clock ticks; broken TOML, values of the wrong kind, a
sampling period that the stamps contradict.
"""

from __future__ import annotations

import csv
import glob
import math
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from pamid.base.csv_table import RENAME, name_fault
from pamid.base.errors import FileError, listed, nearest, quoted
from pamid.base.files import read_lines
from pamid.base.toml_file import read_toml
from pamid.base.units import split_column

UNIFORM_TO = 0.01  # stamps are uniform to 1 %
# in any unit: beyond lies what no sensor shows, and what cannot be squared and summed
TINY, HUGE = 1e-30, 1e30
# faster samples no converter, slower ones than every thirty years no experiment
PERIODS_S = (1e-12, 1e9)
# of the spacing of the stamps: where doubles of their size lie farther apart, neighbours cannot be
# separated from each other
STAMP_RESOLUTION = 0.5
PERIOD_TO = 1e-3  # a stated sampling period may differ from the stamps by 0.1 %
MOST_OF_A_PERIOD = 0.5  # a coarser digit hides lost samples
_DIGITS = 9  # decimals looked for; below, 1 % of no period is missed
_NARROWINGS = 80  # of the period, by a third each: to the last bit
_TOUCH = 1e-3  # of a digit
_FEWEST_HALVES = 3  # stamps at either end of their digit
_INGEST = "`pamid ingest` repairs the time base of raw logs."
_RESAVE = "`pamid ingest` reads raw logs; a table is saved again as comma-separated UTF-8."
_WHERE = "Check the path; `pamid demo` makes recordings to try things on."
_READABLE = "Check that you may read it (ls -l)."

_KEYS: dict[str, tuple[str, ...] | None] = {  # None: any key
    "recording": ("rig", "loop", "sampling_period_s"),
    "known": None,
    "free": None,
    "controller": ("kp_per_deg", "kd_s_per_deg", "derivative_filter_s", "command_limit"),
    "between": None,
}
BETWEEN = ("held", "linear")  # what an input may do between samples
BEFORE = "before"  # an output is read before the command of its row is sent


def require_file(path: Path, wanted: str) -> None:
    """FileError unless `path` is a file with an end; `wanted` describes the file."""
    if path.is_file():
        return
    if path.is_dir():
        raise FileError(
            f"{path} is a folder, not a {wanted}.", "Name the file in it.", code="not-a-file"
        )
    if path.exists():
        raise FileError(
            f"{path} is a device, a pipe or a socket, not a {wanted}.",
            "Write what it gives into a file first.",
            code="not-a-file",
        )
    alike = path.parent.glob(f"*{glob.escape(path.suffix)}")
    near = nearest(path.name, [item.name for item in alike if item.is_file()])
    raise FileError(f"{path} does not exist.", near or _WHERE, code="missing")


def read_header(path: Path) -> list[str]:
    """The column names of the first line; FileError if the file is missing, empty or no text."""
    require_file(path, "recording")
    try:
        row = next(csv.reader(read_lines(path)), None)
    except UnicodeDecodeError:
        raise FileError(f"{path} is not UTF-8 text.", _RESAVE, code="encoding") from None
    except csv.Error as error:
        raise FileError(f"{path}, line 1: not CSV: {error}.", _RESAVE) from None
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.", _READABLE) from error
    if not row or not any(cell.strip() for cell in row):
        hint = "A recording starts with a header row: time_s,..."
        raise FileError(f"{path} is empty.", hint, code="empty")
    return [cell.strip() for cell in row]


def check_header(path: Path, names: Sequence[str]) -> None:
    """FileError unless the first column is `time_s` and every column has a different name."""

    def refuse(what: str, hint: str) -> NoReturn:
        raise FileError(f"{path}, line 1: {what}.", hint, code="header")

    if names[0] != "time_s":
        guess = f"`pamid ingest --guess {quoted(path)}`"
        hint = (
            "The first line of a recording names its columns, time_s first. For a raw log run "
            f"{guess}."
        )
        if ";" in names[0] or "\t" in names[0]:
            hint = (
                f"It looks as if columns are not separated by commas. {guess} reads other dialects."
            )
        elif _is_number(names[0]):
            hint = "There seems to be no header row. " + hint
        refuse(f"the first column is {names[0]!r}, not 'time_s'", hint)
    if len(names) == 1:
        refuse(
            "there is no column except time_s",
            "A recording has a column NAME_UNIT for each input and each measured signal. If the "
            "columns are not separated by commas, convert the file with `pamid ingest`.",
        )
    seen: set[str] = set()
    for index, name in enumerate(names):
        if not name:
            refuse(
                f"column {index + 1} has no name",
                "Name the column NAME_UNIT, as angle_deg, or delete it. Check for an additional "
                "comma at the end of the line.",
            )
        if fault := name_fault(name):
            refuse(f"column {index + 1}, {name!r}, {fault}", RENAME)
        if name in seen:
            refuse(f"column {name!r} occurs twice", "Rename or delete either of them.")
        seen.add(name)


def explain_cells(path: Path, names: Sequence[str]) -> None:
    """Read slowly and raise a FileError naming line and column of the first cell that is not a
    finite number."""
    empty = True
    for line, row in _rows(path):
        empty = False
        if len(row) != len(names):
            what = f"{len(row)} cells, the header names {len(names)} columns"
            hint = "The line may have been cut short: drop it, or add what is missing."
            if len(row) > len(names):
                hint = "A decimal comma splits a number in two: write decimal points."
            raise FileError(f"{path}, line {line}: {what}.", hint, code="row")
        for name, cell in zip(names, row, strict=True):
            if not cell.strip():
                _refuse_cell(path, line, name, "is empty")
            number = _is_number(cell)
            if not number or not math.isfinite(float(cell)):
                wanted = "a finite number" if number else "a number"
                _refuse_cell(path, line, name, f"is {cell.strip()!r:.60}, not {wanted}")
    if empty:
        hint = "Check that the recording was not stopped immediately."
        raise FileError(f"{path} has a header but no rows.", hint, code="empty")


def check_range(path: Path, names: Sequence[str], table: NDArray[np.float64]) -> None:
    """FileError where a column, rows x columns, holds numbers that no sensor shows in any unit."""
    largest = np.abs(table).max(axis=0)
    for name, most, values in zip(names, largest.tolist(), table.T, strict=True):
        if most > HUGE:
            row = int(np.argmax(np.abs(values)))
            what = f"is {values[row]:g}, which no sensor shows"
            _refuse_cell(path, _line_of(path, row), name, what, "range")
        if 0.0 < most < TINY:
            raise FileError(
                f"{path}, column {name!r}: no number in it exceeds {most:g}, which no sensor "
                "shows.",
                "Correct the unit or the scale of that column.",
                code="range",
            )


def check_stamps(path: Path, time: NDArray[np.float64]) -> None:
    """FileError unless the stamps (s) rise evenly: no repeat, no step back, no gap, spacing uniform
    to 1 %, or to the last digit that was written, and such as a clock has."""
    steps = np.diff(time)
    if steps.size == 0:
        return
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    rounding = float(np.spacing(np.abs(time).max()))
    if period and rounding > STAMP_RESOLUTION * period:
        raise FileError(
            f"{path}, column 'time_s': stamps of {np.abs(time).max():.6g} s are rounded to "
            f"{rounding:.3g} s, which does not resolve samples {period:.3g} s apart.",
            "Subtract the first stamp before writing the file.",
            code="stamps-resolution",
        )
    if period and not PERIODS_S[0] <= period <= PERIODS_S[1]:
        raise FileError(
            f"{path}, column 'time_s': the sampling period is {period:.3g} s; recorders sample "
            f"every {PERIODS_S[0]:g} to {PERIODS_S[1]:g} s.",
            "Correct the unit or the scale of that column; it must be in seconds.",
            code="stamps-period",
        )
    backward = np.flatnonzero(steps <= 0)
    if backward.size:
        row = int(backward[0])
        if steps[row] == 0:
            _refuse_stamp(path, row + 1, f"{time[row + 1]:.9g} s occurs twice", "stamps-repeated")
        detail = f"{time[row + 1]:.9g} s comes after {time[row]:.9g} s"
        _refuse_stamp(path, row + 1, detail, "stamps-unsorted")
    # the spacing of stamps written with few digits looks uneven by the rounding, which is no fault
    # of the clock
    uneven = np.flatnonzero(np.abs(steps - period) > UNIFORM_TO * period + rounding)
    if uneven.size:
        gaps = uneven[steps[uneven] > 1.5 * period]
        row = int(gaps[0] if gaps.size else uneven[0])
        if gaps.size:
            detail = f"a gap of {steps[row]:.6g} s; the sampling period is {period:.6g} s"
            _refuse_stamp(path, row + 1, detail, "gap")
        if even_but_rounded(time):
            return
        detail = (
            f"a step of {steps[row]:.6g} s; the sampling period is {period:.6g} s (steps must be "
            "uniform to 1 %)"
        )
        _refuse_stamp(path, row + 1, detail, "stamps-uneven")


def last_digits(stamps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Value of a unit in the last digit of every stamp (n,), s: as many decimals as any of them
    has, or as many significant digits, where these were counted."""
    counts = np.full(stamps.size, _DIGITS, dtype=np.int64)  # decimals of each stamp
    for decimals in range(_DIGITS - 1, -1, -1):
        scaled = stamps * 10.0**decimals
        whole = np.abs(scaled - np.round(scaled)) <= np.maximum(1e-6, 4.0 * np.spacing(scaled))
        counts[whole] = decimals
    size = np.floor(np.log10(np.maximum(np.abs(stamps), 10.0**-_DIGITS))).astype(np.int64)
    significant = int((counts + size).max())
    return np.asarray(10.0 ** np.maximum(-int(counts.max()), size - significant))


def even_but_rounded(stamps: NDArray[np.float64]) -> bool:
    """Is there an even clock that gives these rising stamps (n,), s, once it is rounded (or cut
    off) to their last digits?

    At 300 Hz and with four decimals stamps read 0.0033, 0.0067, 0.0100: the steps differ by 3 %,
    the clock by nothing. Even it is where some start and period put every stamp within half its
    last digit, which is checked exactly; no deviation beyond that is excused.
    """
    count = stamps.size
    if count < 3:
        return False
    digit = last_digits(stamps)
    period = float(stamps[-1] - stamps[0]) / (count - 1)
    if digit.max() > MOST_OF_A_PERIOD * period:
        return False
    place, half = np.arange(count, dtype=np.float64), 0.5 * digit

    def edges(trial: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Earliest and latest start of the clock of this period, by every stamp, s."""
        course = stamps - trial * place
        return course - half, course + half

    def excess(trial: float) -> float:
        """How far the clock stays outside the stamps' digits, s; below 0: nowhere."""
        earliest, latest = edges(trial)
        return float(earliest.max() - latest.min())

    # convex in the period, whose error the first and the last stamp bound
    low, high = (period + sign * 2.0 * float(digit.max()) / (count - 1) for sign in (-1.0, 1.0))
    for _ in range(_NARROWINGS):
        a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
        below, above = excess(a), excess(b)
        if min(below, above) < -_TOUCH * float(digit.min()):
            return True
        low, high = (low, b) if below < above else (a, high)
    # a clock that meets both ends of a digit, as halves do that are rounded to either side: then
    # several stamps do, not a single stamp that is off by a digit
    earliest, latest = edges(0.5 * (low + high))
    early, late, touch = earliest.max(), latest.min(), _TOUCH * float(digit.min())
    ends = (np.count_nonzero(earliest >= early - touch), np.count_nonzero(latest <= late + touch))
    return bool(early - late <= touch and min(ends) >= _FEWEST_HALVES)


def sidecar_of(path: Path, names: Sequence[str], time: NDArray[np.float64]) -> dict[str, Any]:
    """Checked content of the TOML next to the CSV `path`, if any, by the fields of a Recording.
    FileError with the key or line that is wrong."""
    source = path.with_suffix(".toml")
    tables = read_toml(source) if source.exists() else {}
    warnings: list[str] = []
    for title, table in tables.items():
        if title not in _KEYS:
            warnings.append(f"{source}: [{title}] is not used. {nearest(title, _KEYS)}".rstrip())
        elif not isinstance(table, dict):
            raise FileError(
                f"{source}: {title!r} must be a table, written [{title}].",
                f"Write [{title}] on a separate line, its entries below.",
                code="toml",
            )
        elif (valid := _KEYS[title]) is not None:
            # a user's rig may have its gains in other units: only what they are is held
            # against the list
            stems = {split_column(key)[0] for key in valid} if title == "controller" else set(valid)
            warnings += [
                f"{source}: [{title}] {key!r} is not a known key. {nearest(key, valid)}".rstrip()
                for key in table
                if key not in valid and split_column(key)[0] not in stems
            ]
    about = tables.get("recording", {})
    loop = _text(source, about, "loop")
    if loop not in (None, "closed", "open"):
        hint = nearest(str(loop), ("closed", "open")) or "Write 'closed' or 'open'."
        raise FileError(f"{source}: [recording] loop is {loop!r:.60}.", hint, code="toml")
    return {
        "sampling_period_s": _period(source, about, time),
        "loop": loop,
        **{t: _numbers(source, t, tables.get(t, {})) for t in ("known", "controller", "free")},
        "between": _between(source, tables.get("between", {}), names),
        "rig": _text(source, about, "rig"),
        "warnings": tuple(warnings),
    }


def _between(path: Path, table: dict[str, Any], names: Sequence[str]) -> dict[str, str]:
    """[between]: column -> "held" or "linear" for an input, "before" for an output."""
    for column, way in table.items():
        if column not in names:
            raise FileError(
                f"{path}: [between] {column!r} is no column of the recording.",
                nearest(column, names) or f"Its columns: {listed(names[1:])}.",
                code="toml",
            )
        if way not in (*BETWEEN, BEFORE):
            raise FileError(
                f"{path}: [between] {column} is {way!r:.60}.",
                'Write "held" (each value stays until the next sample) or "linear" (a straight '
                'line to the next sample) for an input, "before" for a reading taken before '
                "the command of its row is sent.",
                code="toml",
            )
    return dict(table)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """(line in the file, cells) of every row below the header; blank lines are passed over."""
    reader = csv.reader(read_lines(path))
    try:
        next(reader, None)
        for row in reader:
            if row and (len(row) > 1 or row[0].strip()):
                yield reader.line_num, row
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path} is not UTF-8 text (byte {error.start}).", _RESAVE, code="encoding"
        ) from None
    except csv.Error as error:
        raise FileError(f"{path}, line {reader.line_num}: not CSV: {error}.", _RESAVE) from None


def _line_of(path: Path, row: int) -> int:
    """The line of the file that holds data row `row` (from 0)."""
    return next((line for line, _ in islice(_rows(path), row, None)), row + 2)


def _refuse_cell(path: Path, line: int, name: str, what: str, code: str = "cell") -> NoReturn:
    hint = "Every cell needs a finite number. Delete or repair this part of the log."
    raise FileError(f"{path}, line {line}, column {name!r}: the cell {what}.", hint, code=code)


def _refuse_stamp(path: Path, row: int, detail: str, code: str) -> NoReturn:
    raise FileError(
        f"{path}, line {_line_of(path, row)}, column 'time_s': {detail}.", _INGEST, code=code
    )


def _is_number(cell: str) -> bool:
    if "_" in cell:  # Python reads 1_000, no other tool does
        return False
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _text(path: Path, table: dict[str, Any], key: str) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise FileError(
            f"{path}: [recording] {key} is {value!r:.60}, not text in quotes.",
            f'Write {key} = "..."',
            code="toml",
        )
    return value


def _numbers(path: Path, title: str, table: dict[str, Any]) -> dict[str, float]:
    for key, value in table.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            stem, symbol = split_column(key)
            hint = f"Write the {stem} in {symbol}." if symbol != "1" else "Write a plain number."
            message = f"{path}: [{title}] {key} is {value!r:.60}, not a finite number."
            raise FileError(message, hint, code="toml")
    return {key: float(value) for key, value in table.items()}


def _period(path: Path, table: dict[str, Any], time: NDArray[np.float64]) -> float:
    """The sampling period in s: the mean spacing of the stamps, or the stated period where the two
    agree."""
    measured = float(time[-1] - time[0]) / (time.size - 1)
    if "sampling_period_s" not in table:
        return float(f"{measured:.9g}")
    key = "sampling_period_s"
    stated = _numbers(path, "recording", {key: table[key]})[key]
    if stated <= 0 or abs(stated - measured) > PERIOD_TO * measured:
        raise FileError(
            f"{path}: sampling_period_s is {stated:g}, but the stamps are {measured:.6g} s apart.",
            "Correct the key or leave it out; is the time column in seconds?",
            code="sampling-period",
        )
    # both name the same clock: keep the round number unless the stamps really run at another rate
    return stated if abs(stated - measured) <= 1e-5 * measured else float(f"{measured:.9g}")
