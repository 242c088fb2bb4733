"""The text that Octave's `save` writes unless a format is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pamid.base.errors import FileError
from pamid.ingest.channel_builder import ChannelBuilder
from pamid.ingest.channels import Log
from pamid.ingest.readers.text import decode

CELL_TEXT_BYTES = 80  # bytes of a short text and of its place in a list
_STRUCTS = ("struct", "scalar struct")


def read_octave_text(path: Path) -> Log:
    """Matrices as channels without stamps, also those inside structs; everything else is left out
    by name."""
    builder = ChannelBuilder(path)
    text, _ = decode(builder.budget)
    for block in text.split("# name: ")[1:]:
        lines = block.split("\n")
        log_per_part = (
            line.lstrip("# ").partition(":") for line in lines[1:] if line.startswith("#")
        )
        head = {key: value.strip() for key, _, value in log_per_part}
        kind = head.get("type", "unknown")
        if (
            kind == "matrix"
            and head.get("rows", "").isdecimal()
            and head.get("columns", "").isdecimal()
        ):
            _matrix(builder, path, lines, int(head["rows"]), int(head["columns"]))
        elif kind not in _STRUCTS:
            builder.leave_out(lines[0], f"{kind}, save it with -v7")
    builder.note("text saved by Octave")
    return builder.log(path, "mat")


def _matrix(builder: ChannelBuilder, path: Path, lines: list[str], rows: int, columns: int) -> None:
    written = sum(len(line.split()) for line in lines[1:] if not line.startswith("#"))
    builder.budget.charge(lines[0], max(written, rows * columns), raw=CELL_TEXT_BYTES * written)
    cells = " ".join(line for line in lines[1:] if not line.startswith("#")).split()
    if len(cells) != rows * columns:
        raise FileError(
            f"{path}: {lines[0]} has {len(cells)} values, but its header has {rows} x {columns}.",
            "The file is damaged or truncated. Save it again.",
            code="damaged",
        )
    numbers = np.array(["nan" if cell == "NA" else cell for cell in cells], dtype=np.float64)
    builder.add(lines[0], numbers.reshape(rows, columns))
