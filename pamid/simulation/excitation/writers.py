"""Excitations as files for whoever sends them: a CSV, Simulink, a PLC, a C program; and the note
next to each.

format      suffix  content
csv         .csv    a recording: time_s and the columns, 9 significant digits
mat         .mat    From Workspace: a structure with time per column, named as the column
mat-file    .mat    From File: matrix `excitation` of MAT version 4, rows time and columns
mat-matrix  .mat    From Workspace: matrix `excitation`, columns time and columns
st          .st     IEC 61131-3 structured text: per column the change points, arrays of TIME (or
            LTIME) and REAL
h           .h      C99: per column all samples and the change points, `static const double`

All are held until the next sample or change point (zero-order hold). MAT and C carry every bit of
the numbers.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError, UsageError, quoted
from pamid.base.files import make_folder, write_together
from pamid.base.json_file import json_bytes
from pamid.base.schemas.excitation_file import ExcitationFile
from pamid.base.units import NONE, split_column
from pamid.recording.recording import recording_files

MATRIX = "excitation"
MAT_HEADER = b"MATLAB 5.0 MAT-file, written by pamid"  # without a date: same request, same bytes
HELD_WORDS = "held until the next sample (zero-order hold)"
PER_LINE = 8


@dataclass(frozen=True)
class Format:
    """How an excitation is written: suffix, the bytes of it, and what to heed where it is
    played."""

    suffix: str
    content: Callable[[SentSignals], bytes] | None  # None: as a recording
    heed: str


@dataclass(frozen=True, eq=False)
class SentSignals:
    """Excitation columns (n,) in the unit of their names, a sample every period_s; stem: of the
    file to write; about: a line for its comments."""

    columns: Mapping[str, Array]
    period_s: float
    stem: str = MATRIX
    about: str = ""

    @property
    def time(self) -> Array:
        """Sampling instants, s."""
        return self.period_s * np.arange(self.samples, dtype=np.float64)

    @property
    def samples(self) -> int:
        return len(next(iter(self.columns.values())))

    @property
    def rows(self) -> Array:
        """Time and columns, a row each."""
        return np.stack([self.time, *self.columns.values()])


def format_of(path: Path, chosen: str | None = None) -> str:
    """The format to write a path in: as chosen, else that of its suffix, else CSV.
    UsageError where the suffix belongs to another."""
    suffix = path.suffix.lower()
    by_suffix = {form.suffix: name for name, form in reversed(FORMATS.items())}
    if chosen is None:
        return by_suffix.get(suffix, "csv")
    if suffix in by_suffix and suffix != FORMATS[chosen].suffix:
        raise UsageError(
            f"--format {chosen} cannot be written to a {suffix} file.",
            f"Write --output {quoted(path.with_suffix(FORMATS[chosen].suffix))}.",
        )
    return chosen


def write_excitation(
    path: Path,
    columns: Mapping[str, Array],
    period_s: float,
    about: Mapping[str, Any],
    *,
    form: str = "csv",
    meta: Mapping[str, Any] | None = None,
    others: Mapping[Path, bytes] | None = None,
) -> dict[str, Any]:
    """Write an excitation, the JSON note next to it, the tables of `meta` as TOML next to it and
    `others`: all or none.

    about: what to note of it, from the rig on; the note is returned. FileError for columns that are
    not finite or whose names cannot be separated in this format.
    """
    from importlib.metadata import version

    generator = f"pamid {version('pamid')} generate-aprbs"
    words = [f"{word} {about[word]}" for word in ("signal", "experiment", "seed") if word in about]
    signals = SentSignals(columns, period_s, path.stem, ", ".join([generator, *words, HELD_WORDS]))
    # first: it refuses what is not finite
    files = recording_files(path, signals.time, signals.columns, meta)
    chosen = FORMATS[form]
    if chosen.content is not None:
        files[path] = chosen.content(signals)
        about = {**about, "format": form, "interpolation": f"hold: {chosen.heed}"}
    digest = hashlib.sha256(files[path]).hexdigest()
    note = ExcitationFile(generator=generator, file=path.name, sha256=digest, **about).as_json()
    files = {**(others or {}), **files, path.with_suffix(".json"): json_bytes(note, path.stem)}
    make_folder(path.parent)
    write_together(files)
    return note


def change_points(samples: Array) -> NDArray[np.intp]:
    """Samples at which the value differs from the sample before; the first is included."""
    return np.append(0, np.flatnonzero(np.diff(samples)) + 1)


# ---- Simulink ----------------------------------------------------------------------------------


def _mat_structures(signals: SentSignals) -> bytes:
    variables = {}
    for column, word in _words(signals.columns, "").items():
        values = signals.columns[column][:, None]
        about = {"values": values, "dimensions": 1.0, "label": column}
        variables[word] = {"time": signals.time[:, None], "signals": about}
    return _mat(variables)


def _mat(variables: dict[str, Any], version: str = "5") -> bytes:
    from scipy.io import savemat

    buffer = io.BytesIO()
    savemat(buffer, variables, format=version)
    data = buffer.getvalue()
    return data if version == "4" else MAT_HEADER.ljust(116) + data[116:]


# ---- structured text ---------------------------------------------------------------------------


def _structured_text(signals: SentSignals) -> bytes:
    lines = [
        f"(* {_comment(signals.about)}. *)",
        "(* Send value[k] from time[k] on; hold the last value up to the end. *)",
        "VAR_GLOBAL CONSTANT",
    ]
    words = _words(signals.columns, signals.stem)
    points = {column: change_points(samples) for column, samples in signals.columns.items()}
    instants = {
        column: np.round(np.append(at, signals.samples) * (1e9 * signals.period_s)).astype(np.int64)
        for column, at in points.items()
    }  # ns, the end included
    whole = not any((ns % 1_000_000).any() for ns in instants.values())
    name = "TIME" if whole else "LTIME"
    for column, word in words.items():
        at, ns = points[column], instants[column].tolist()
        *stamps, end = [f"T#{n // 1_000_000}ms" if whole else f"LTIME#{n}ns" for n in ns]
        values = []
        for value in signals.columns[column][at].tolist():
            # the shortest literal that is read as this number with 24 bits; it needs a point
            mantissa, _, exponent = str(np.float32(value)).partition("e")
            mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
            values.append(f"{mantissa}E{int(exponent)}" if exponent else mantissa)
        lines += [
            f"    (* {_comment(f'{column}: {_unit(column)}')} *)",
            f"    {word}_count : DINT := {at.size};",
            f"    {word}_time : ARRAY[1..{at.size}] OF {name} := [",
            _rows(stamps, "        "),
            "    ];",
            f"    {word}_value : ARRAY[1..{at.size}] OF REAL := [",
            _rows(values, "        "),
            "    ];",
        ]
    lines += [f"    {_word(signals.stem)}_end : {name} := {end};", "END_VAR", ""]
    return "\n".join(lines).encode()


# ---- C -----------------------------------------------------------------------------------------


def _c_header(signals: SentSignals) -> bytes:
    words, stem = _words(signals.columns, signals.stem), _word(signals.stem)
    guard = f"{stem.upper()}_H"
    lines = [
        f"/* {_comment(signals.about)}. C99. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        f"#define {stem.upper()}_SAMPLES {signals.samples}",
        f"#define {stem.upper()}_PERIOD_S {signals.period_s!r} /* s */",
    ]
    for column, word in words.items():
        samples, at = signals.columns[column], change_points(signals.columns[column])
        unit = _comment(_unit(column))
        lines += [
            "",
            f"/* {_comment(column)}: {unit}, a value per sample */",
            *_c_array(word, samples),
            "",
            f"#define {word.upper()}_CHANGES {at.size}",
            f"/* its change points: s, and the value from then on, {unit} */",
            *_c_array(f"{word}_change_s", signals.time[at]),
            *_c_array(f"{word}_change", samples[at]),
        ]
    return "\n".join([*lines, "", "#endif", ""]).encode()


def _c_array(name: str, values: Array) -> list[str]:
    return [
        f"static const double {name}[{values.size}] = {{",
        _rows([repr(v) for v in values.tolist()], "    "),
        "};",
    ]


def _comment(text: str) -> str:
    """As it may stand in a comment of C and of structured text."""
    for mark in ("*/", "/*", "*)", "(*"):
        text = text.replace(mark, " ".join(mark))
    return " ".join(text.split())


# ---- names and numbers -------------------------------------------------------------------------


def _words(columns: Mapping[str, Array], stem: str) -> dict[str, str]:
    """A name per column that C, MATLAB and structured text (which hears no capitals) take."""
    words = {column: _word(f"{stem}_{column}" if stem else column) for column in columns}
    if len({word.lower() for word in words.values()}) < len(words):
        message = f"The columns {', '.join(columns)} have the same name in this format."
        raise FileError(message, "Write a CSV instead.")
    return words


def _word(text: str) -> str:
    word = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or MATRIX
    return word if word[0].isalpha() else f"x_{word}"


def _unit(column: str) -> str:
    symbol = split_column(column)[1]
    return "no unit" if symbol == NONE else f"in {symbol}"


def _rows(texts: list[str], indent: str) -> str:
    rows = [", ".join(texts[k : k + PER_LINE]) for k in range(0, len(texts), PER_LINE)]
    return ",\n".join(indent + row for row in rows)


_SIMULINK = (
    "From Workspace: tick off 'Interpolate data', sample time = sampling_period_s, after the last "
    "value hold the final value"
)
_FROM_FILE = "From File: interpolation zero-order hold, sample time = sampling_period_s"
_C99 = "samples, each for sampling_period_s, or change points, each until the next one"
_IEC = "change points, each value until the next one; REAL has 24 bits"
FORMATS: dict[str, Format] = {
    "csv": Format(".csv", None, ""),
    "mat": Format(".mat", _mat_structures, _SIMULINK),
    "mat-file": Format(".mat", lambda s: _mat({MATRIX: s.rows}, version="4"), _FROM_FILE),
    "mat-matrix": Format(".mat", lambda s: _mat({MATRIX: s.rows.T.copy()}), _SIMULINK),
    "st": Format(".st", _structured_text, _IEC),
    "h": Format(".h", _c_header, _C99),
}
