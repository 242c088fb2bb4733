"""Tables of numbers as CSV: the only writer of every CSV file.

A name of a column may come from a recording, a model file or a run of somebody else. A spreadsheet
takes a cell that begins with = + - or @ for a formula, a terminal obeys control characters, and a
comma or a quote shifts the columns. Such names are refused, not escaped: an escaped name would
differ from the name that a rig, a mapping or `fit.json` gives the column.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from pamid.base.errors import FileError

ROWS_AT_A_TIME = 4096  # formatted at a time: a number takes many times its size as a Python object
RENAME = "Rename the column; letters, digits and _ are safe, as in angle_deg."


def name_fault(name: str) -> str:
    """Reason why a text cannot be the name of a column; "" if there is none."""
    if name[:1] in ("=", "+", "-", "@"):
        return f"begins with {name[:1]!r}, which a spreadsheet takes for a formula"
    if not name.isprintable():
        return "has characters that cannot be seen, such as control characters"
    return next((f"has {mark!r} in it" for mark in ',"' if mark in name), "")


def header_line(names: Sequence[str]) -> str:
    """The first line of a table; FileError for a name that `name_fault` objects to."""
    for name in names:
        if fault := name_fault(name):
            raise FileError(f"The column {name!r} {fault}.", RENAME, code="header")
    return ",".join(names) + "\n"


def table_bytes(
    names: Sequence[str], rows: NDArray[Any], formats: Sequence[str], *, blank: bool = False
) -> bytes:
    """A table as CSV.

    names    columns, as of `header_line`
    rows     (n, m) numbers
    formats  a format for each of the m columns, as "%.9g"
    blank    leave the cell of a NaN empty
    """
    pieces = [header_line(names).encode()]
    line = ",".join(formats) + "\n"
    for begin in range(0, len(rows), ROWS_AT_A_TIME):
        piece = rows[begin : begin + ROWS_AT_A_TIME]
        text = (line * len(piece)) % tuple(piece.ravel().tolist())
        pieces.append((text.replace("nan", "") if blank else text).encode())
    return b"".join(pieces)
