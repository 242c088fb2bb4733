"""A recording: a CSV file of uniformly sampled signals and, next to it, an optional TOML file of
the same stem.

The first column is `time_s`; every other column is `<signal>_<unit>`. What cannot be trusted is
refused here, with file, column and row, so that nothing later has to wonder: see
`pamid.recording.file_checks` for the list.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.base.card import Cells, card, html_table, interval, text_table
from pamid.base.csv_table import table_bytes
from pamid.base.errors import DataError, FileError, UsageError, listed, nearest
from pamid.base.files import TABLE, open_data, sha256_of, write_together
from pamid.base.units import (
    NONE,
    compatible,
    divided_name,
    duration_text,
    from_si,
    split_column,
    suffixes_for,
    to_si,
)
from pamid.recording.file_checks import (
    check_header,
    check_range,
    check_stamps,
    explain_cells,
    read_header,
    sidecar_of,
)

if TYPE_CHECKING:
    from pandas import DataFrame

    from pamid.recording.plot import NotebookFigure


TIME = "time_s"
MIN_SAMPLES = 50
SIGNIFICANT_DIGITS = 9
EXACT_DIGITS = 17  # any double comes back as it was
TIME_DIGITS = 12  # a stamp late in a long record needs more: 9 digits are 10 us after 1000 s

_PLAIN_CELLS = (
    "Every cell holds a number with a decimal point; `pamid ingest` reads other dialects."
)

#: words that people write for units pamid does not read; they tell "wrong unit" from "another
#: signal"
_FOREIGN_UNITS = (
    "psi psig psia atm torr mmhg barg bara degree degrees radian radians grad rev turns inch in ft "
    "lb lbs lbf kgf ozin lbin sec msec counts ticks kv"
)


@dataclass(frozen=True)
class Recording:
    """Signals on a uniform time base, as the file holds them (units by column name), and what is
    known about them.

    time              s, shape (n,), strictly increasing
    columns           full column name -> values in the column's unit, shape (n,), without time;
                      arrays are read-only
    sampling_period_s s
    loop              "closed" | "open" | None: was a controller producing the command from the
                      output?
    known             parameters of the rig known for this recording, by full name, in the unit of
                      the name
    free              parameters of the rig that are fitted although it holds them, by full name,
                      with the standard deviation within which they are known, in its unit
    controller        the controller's settings, by full name
    between           "held" or "linear": what an input does between samples, by column,
                      where the recording states it; else as the rig states
    warnings          what was odd but not wrong
    effects           labels of the effects that a simulated recording was made with, with their
                      values; no file tells them
    """

    name: str
    path: Path
    sha256: str
    time: Array
    columns: dict[str, Array]
    sampling_period_s: float
    loop: str | None = None
    rig: str | None = None
    known: dict[str, float] = field(default_factory=dict)
    controller: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    between: dict[str, str] = field(default_factory=dict)
    free: dict[str, float] = field(default_factory=dict)

    @classmethod
    def from_pandas(
        cls,
        frame: DataFrame,
        name: str = "recording",
        *,
        rig: str | None = None,
        loop: str | None = None,
        known: Mapping[str, float] | None = None,
        controller: Mapping[str, float] | None = None,
        between: Mapping[str, str] | None = None,
        free: Mapping[str, float] | None = None,
    ) -> Recording:
        """A recording out of a table with the column time_s and a column per signal, its unit at
        the end of its name (angle_deg); the rest is the content of a recording's TOML.

        UsageError where it is no such table; otherwise errors as of `read_recording`.
        """
        if TIME not in frame.columns:
            raise UsageError(
                f"The table {name!r} has no column {TIME!r}.",
                "Its index is not read: frame.reset_index(names='time_s') makes a column of it.",
            )
        try:
            arrays = {str(c): frame[c].to_numpy(dtype=float) for c in frame.columns}
        except (TypeError, ValueError) as error:
            raise UsageError(
                f"The table {name!r} holds more than numbers: {error}.", "Leave such columns out."
            ) from None
        tables = {
            "recording": {k: v for k, v in (("rig", rig), ("loop", loop)) if v is not None},
            "known": dict(known or {}),
            "controller": dict(controller or {}),
            "between": dict(between or {}),
            "free": dict(free or {}),
        }
        return recording_of(arrays.pop(TIME), arrays, tables, name=name, digits=EXACT_DIGITS)

    def to_pandas(self) -> DataFrame:
        """time_s and every signal as the columns of a table."""
        import pandas

        return pandas.DataFrame({TIME: self.time, **self.columns})

    def plot(self, signals: Iterable[str] | None = None) -> NotebookFigure:
        """A figure of every signal over time, or of these, in the units of their names; FileError
        for a signal that was not recorded."""
        from pamid.recording.plot import plot_signals

        chosen = {name: self.signal(name) for name in (signals or self.columns)}
        return plot_signals(self._headline(), self.time, chosen)

    def __repr__(self) -> str:
        return f"<Recording {self._headline()}: {listed(self.columns)}>"

    def _repr_html_(self) -> str:
        return card(self._headline(), html_table(self._ranges()))

    def summary(self) -> str:
        """The range of every signal as lines of text."""
        return f"{self._headline()}\n{text_table(self._ranges())}"

    def _headline(self) -> str:
        loop = f", {self.loop} loop" if self.loop else ""
        every, span = duration_text(self.sampling_period_s, 4), len(self) * self.sampling_period_s
        return f"{self.name}: {len(self)} samples over {span:.4g} s, a sample every {every}{loop}"

    def _ranges(self) -> Cells:
        rows = [
            (name, interval(float(x.min()), float(x.max()))) for name, x in self.columns.items()
        ]
        return ("signal", "range"), rows

    def __len__(self) -> int:
        return self.time.size

    def has(self, column: str) -> bool:
        """True if this signal was recorded, in whatever unit of its quantity."""
        return match_column(self.columns, column) is not None

    def signal(self, column: str) -> Array:
        """The signal `column`, converted to the unit in that name if the file holds another of the
        same quantity.

        FileError if it was not recorded, or in a unit that pamid does not know.
        """
        name = match_column(self.columns, column)
        if name is None:
            hint = nearest(column, self.columns) or f"Its columns are: {listed(self.columns)}."
            message = f"{self.path}: there is no column {column!r}."
            raise FileError(message, hint, code="missing-column")
        if name == column:
            return self.columns[name]
        values = from_si(to_si(self.columns[name], split_column(name)[1]), split_column(column)[1])
        return np.asarray(values)

    def si(self, column: str) -> Array:
        """The signal `column` in SI units (rad, Pa, N, m ...)."""
        return np.asarray(to_si(self.signal(column), split_column(column)[1]))

    def slice(self, start: int, stop: int) -> Recording:
        """Samples start to stop (as in a Python slice) as a separate recording; the time stamps
        stay."""
        rows = slice(start, stop)
        return replace(
            self,
            time=self.time[rows],
            columns={name: array[rows] for name, array in self.columns.items()},
        )


def read_recording(path: str | Path | DataFrame) -> Recording:
    """Read a recording and its TOML file, or a table with a column time_s.

    Raises
    ------
    FileError
        The files are wrong (exit code 3); the message names column and line.
    DataError
        There are fewer than 50 samples (exit code 4).
    """
    if not isinstance(path, str | Path):
        return Recording.from_pandas(path)
    source = Path(path)
    names = read_header(source)
    check_header(source, names)
    table = _read_cells(source, names)
    check_range(source, names, table)
    columns = {name: np.ascontiguousarray(y) for name, y in zip(names, table.T, strict=True)}
    for array in columns.values():
        array.flags.writeable = False
    time = columns.pop(TIME)
    check_stamps(source, time)
    if time.size < MIN_SAMPLES:
        hint = "Record for longer: a fit needs some seconds of motion."
        message = f"{source}: too short: {time.size} samples, at least {MIN_SAMPLES} are needed."
        raise DataError(message, hint, code="too-short")
    stated = sidecar_of(source, names, time)
    return Recording(source.stem, source, sha256_of(source), time, columns, **stated)


def recording_of(
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    meta: Mapping[str, Any] | None = None,
    *,
    name: str = "recording",
    digits: int = SIGNIFICANT_DIGITS,
) -> Recording:
    """Recording that reading a file of `write_recording` would give, without a file: the same
    checks, the same rounding. Its path is NAME.csv, where nothing need lie."""
    plain = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "recording"
    tables = {title: content for title, content in (meta or {}).items() if content}
    with tempfile.TemporaryDirectory(prefix="pamid-") as folder:
        path = Path(folder, f"{plain}.csv")
        try:
            write_recording(path, time, columns, tables, digits=digits)
            recording = read_recording(path)
        except (FileError, DataError) as error:
            message = error.message.replace(str(path), path.name)
            raise type(error)(message, error.hint, code=error.code) from None
    return replace(recording, path=Path(path.name))


def write_recording(
    path: str | Path,
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    meta: Mapping[str, Any] | None = None,
    *,
    digits: int = SIGNIFICANT_DIGITS,
) -> None:
    """Write a recording: a CSV file and, for `meta`, a TOML file next to it. Both or none.

    Parameters
    ----------
    time
        Time of shape (n,), s.
    columns
        Finite samples of shape (n,), by full column name.
    meta
        Tables of the TOML file, such as {"recording": {"loop": "open"}, "known": {...}}. None: no
        file is written, and an existing file stays.
    digits
        Significant digits.
    """
    write_together(recording_files(Path(path), time, columns, meta, digits=digits))


def recording_files(
    target: Path,
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    meta: Mapping[str, Any] | None = None,
    *,
    digits: int = SIGNIFICANT_DIGITS,
) -> dict[Path, bytes]:
    """The files of `write_recording` and what stands in them."""
    names = [TIME, *columns]
    check_header(target, names)
    arrays = [np.asarray(values, dtype=float) for values in (time, *columns.values())]
    for name, array in zip(names, arrays, strict=True):
        if array.shape != arrays[0].shape or array.ndim != 1 or not np.isfinite(array).all():
            what = "not finite" if array.shape == arrays[0].shape else f"of shape {array.shape}"
            raise FileError(
                f"{target}: column {name!r} is {what}; {arrays[0].size} finite values are needed.",
                "Reduce the excitation, or correct the parameters that make the model unstable.",
            )
    formats = [f"%.{TIME_DIGITS}g", *[f"%.{digits}g"] * len(columns)]
    rows = np.stack(arrays, axis=1)
    if len(rows):
        check_range(target, names[1:], rows[:, 1:])  # what cannot be read again is not written
    table = table_bytes(names, rows, formats)
    side = {target.with_suffix(".toml"): toml_text(meta).encode()} if meta else {}
    return {**side, target: table}


def match_column(names: str | Iterable[str], wanted: str) -> str | None:
    """Which of the columns `names` holds the signal `wanted`, in any unit of its quantity; None if
    it is not there.

    Wanted "angle_deg" finds "angle_rad". FileError if the signal is there only in a unit that is
    unknown or of another quantity: wanted "pressure_1_kpa" and a column "pressure_1_psi".
    """
    every = [names] if isinstance(names, str) else list(names)
    if wanted in every:
        return wanted
    stem, symbol = split_column(wanted)
    for name in every:
        column_stem, column_symbol = split_column(name)
        if column_stem == stem and compatible(column_symbol, symbol):
            return name
    for name in every:
        column_stem, column_symbol = split_column(name)
        if wanted == (meant := divided_name(name)):
            message = f"Column {name!r} is in {column_symbol!r}; {wanted!r} is wanted."
            hint = f"In a name _ multiplies and _per_ divides: rename it {meant!r}."
            raise FileError(message, hint, code="unit")
        if column_stem == stem and column_symbol != NONE and symbol != NONE:
            raise _wrong_unit(name, f"in {column_symbol!r}", wanted, symbol)
        tail = name.removeprefix(stem + "_").lower() if name.startswith(stem + "_") else ""
        if tail in _FOREIGN_UNITS.split():
            raise _wrong_unit(name, f"in {tail!r}, which is no unit pamid knows", wanted, symbol)
        if name == stem and symbol != NONE:
            raise _wrong_unit(name, "without a unit", wanted, symbol)
    return None


def toml_text(tables: Mapping[str, Any]) -> str:
    """Plain TOML of tables of text, numbers, booleans and lists of them."""
    lines: list[str] = []
    for title, table in tables.items():
        lines += [
            f"[{title}]",
            # TOML allows few keys as they are: names may come from other people's files
            *(
                f"{key if re.fullmatch(r'[A-Za-z0-9_-]+', key) else toml_string(key)}"
                f" = {_toml_value(value)}"
                for key, value in table.items()
            ),
            "",
        ]
    return "\n".join(lines)


def toml_string(value: str) -> str:
    """A text as TOML holds it: no character of it can end the line or the quotes. FileError for
    what is no text (a file name that is not UTF-8)."""
    if not value.isascii() and any("\ud800" <= c <= "\udfff" for c in value):
        raise FileError(f"{value!r} is no UTF-8 text and cannot be written to TOML.", "Rename it.")
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _read_cells(path: Path, names: Sequence[str]) -> Array:
    """All numbers below the header, shape (rows, columns). The fast reader only reports that a cell
    is wrong; the slow reader then names it."""
    import warnings

    import pandas

    try:
        with warnings.catch_warnings():
            # warned where cells would be lost
            warnings.simplefilter("error", pandas.errors.ParserWarning)
            with open_data(path, TABLE) as file:
                frame = pandas.read_csv(
                    file,
                    header=None,
                    skiprows=1,
                    names=list(range(len(names))),
                    index_col=False,
                    dtype=np.float64,
                    encoding="utf-8",
                    skipinitialspace=True,
                )
    except (ValueError, OSError, pandas.errors.ParserWarning) as error:
        explain_cells(path, names)
        raise FileError(
            f"{path} cannot be read as comma-separated numbers: {error}.", _PLAIN_CELLS
        ) from error
    table = frame.to_numpy()
    if table.shape[0] == 0 or not np.isfinite(table).all():
        explain_cells(path, names)
        raise FileError(f"{path}: there are no finite numbers to read.", _PLAIN_CELLS)
    return np.asarray(table, dtype=np.float64)


def _wrong_unit(name: str, state: str, wanted: str, symbol: str) -> FileError:
    valid = ", ".join(f"_{suffix}" for suffix in suffixes_for(symbol))
    ending = f"Valid endings are {valid}."
    ending = ending if valid else "This signal has no unit: name it as it is."
    hint = f"{ending} Convert the values and rename the column."
    return FileError(f"Column {name!r} is {state}; {wanted!r} is wanted.", hint, code="unit")


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    raise FileError(
        f"A {type(value).__name__} cannot be written to TOML.",
        "Give text, numbers, true or false, and lists of them.",
    )
