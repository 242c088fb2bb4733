"""LabVIEW measurement files (.lvm): a header of tags, then segments, each with a header and a
table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.dialect import TextDialect
from pamid.intake.logs.readers.text import add_table, decode

FIRST_TAG = "LabVIEW Measurement"
END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}


@dataclass(frozen=True)
class _Way:
    """How the file is written; x_columns: "One", "Multi" or "No"."""

    delimiter: str
    decimal: str
    x_columns: str


def read_lvm(builder: ChannelBuilder) -> None:
    """Channels by name ("segment 2/name" where there are several segments), stamped by their X
    column or, if there is none, by X0 and Delta_X."""
    text, encoding = decode(builder.budget)
    lines = text.split("\n")
    ends = [index for index, line in enumerate(lines) if line.startswith(END)]
    if not text.startswith(FIRST_TAG) or len(ends) < 2:
        raise FileError(
            f"{builder.path} is not a complete LabVIEW measurement file.",
            f"Such a file begins with {FIRST_TAG!r} and has {END} twice before its numbers.",
        )
    way = _way(builder.path, lines[: ends[0]])
    builder.note(f"encoding: {encoding}; decimal {'comma' if way.decimal == ',' else 'point'}")
    builder.note("stamps: " + ("X0 and Delta_X" if way.x_columns == "No" else "X_Value"))
    heads = [ends[0] + 1]
    for above, below in pairwise(ends[1:]):
        # where the header begins that ends at line `below`
        begins = (k for k in range(below, above, -1) if lines[k].startswith("Channels"))
        heads.append(next(begins, below))
    for number, (head, end) in enumerate(zip(heads, ends[1:], strict=True)):
        stop = heads[number + 1] if number + 1 < len(heads) else len(lines)
        prefix = f"segment {number + 1}/" if len(heads) > 1 else ""
        tags = _tags(lines[head:end], way.delimiter)
        _segment(builder, prefix, tags, lines[end + 1 : stop], end + 2, way)


def _way(path: Path, lines: Sequence[str]) -> _Way:
    """The separator follows the first tag; what it is called stands further down."""
    mark = lines[0].removeprefix(FIRST_TAG)[:1] or "\t"
    head = {tag: values[0] for tag, values in _tags(lines, mark).items() if values}
    word = head.get("Separator", "")
    delimiter = _SEPARATORS.get(word, mark)
    decimal = head.get("Decimal_Separator") or "."
    if delimiter not in _SEPARATORS.values() or decimal not in (".", ",") or decimal == delimiter:
        raise FileError(
            f"{path}: separator {delimiter!r} and decimal separator {decimal!r} are not valid."
        )
    return _Way(delimiter, decimal, head.get("X_Columns", "One"))


def _tags(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """A tag and its values, for each channel, a line."""
    rows = [line.split(delimiter) for line in lines if line.strip()]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows}


def _segment(
    builder: ChannelBuilder,
    prefix: str,
    tags: dict[str, list[str]],
    lines: Sequence[str],
    first: int,
    way: _Way,
) -> None:
    """Enter a table, whose names stand in line `first`, counted from 1."""
    names = [name.strip() for name in lines[0].split(way.delimiter)] if lines else []
    rows = [line for line in lines[1:] if line.strip()]
    if not rows:
        return
    width = rows[0].count(way.delimiter) + 1
    names = (names + [f"column_{column + 1}" for column in range(len(names), width)])[:width]
    table = ChannelBuilder(builder.path, builder.budget)
    ended = lines[-1] == ""  # else the file was cut
    dialect = TextDialect(way.delimiter, way.decimal, tuple(names), ("",) * width, first, ())
    add_table(table, "\n".join(rows) + ("\n" if ended else ""), dialect)
    for note in table.notes:
        builder.note(prefix + note)
    units = tags.get("Y_Unit_Label", [])
    x: Array | None = None
    number = 0
    for channel in table.channels:
        if channel.name.startswith("Comment"):
            continue
        if channel.name.startswith("X_Value"):
            x = channel.values
            continue
        stamps = x
        if way.x_columns == "No":  # X0 + k Delta_X, if the header says both
            try:
                start, step = (
                    float(tags[tag][number].replace(way.decimal, ".")) for tag in ("X0", "Delta_X")
                )
                samples = np.arange(channel.values.size, dtype=np.float64)
                stamps = start + step * samples if step > 0 else None
            except (KeyError, IndexError, ValueError):
                stamps = None
        unit = units[number] if number < len(units) else ""
        builder.add(prefix + channel.name, channel.values, stamps, unit)
        number += 1


KIND = Kind("lvm", (".lvm",), read_lvm, (b"LabVIEW Measurement",))
