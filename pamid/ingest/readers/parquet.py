"""Parquet files. Columns of numbers, truth values, dates and durations; texts and nested ones are
left out by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pamid.ingest.channels import Log
from pamid.ingest.gathering import Gathering
from pamid.ingest.log_kinds import Kind
from pamid.ingest.readers.hdf5 import UNIT_NAMES


def read_parquet(path: Path) -> Log:
    """Every column as a channel without stamps; null becomes NaN; the unit is the field's metadata
    `unit`."""
    import pyarrow
    import pyarrow.parquet

    gathering = Gathering()
    with pyarrow.parquet.ParquetFile(path) as file:
        for name in _columns(gathering, file):
            column = file.read(columns=[name], use_threads=False).column(0)
            field = file.schema_arrow.field(name)
            gathering.add(name, _values(pyarrow, column), unit=_unit(field))
    return gathering.log(path, "parquet")


def _columns(gathering: Gathering, file: Any) -> list[str]:
    """Names of the columns that can be channels."""
    import pyarrow.types as types

    readable = []
    for field in file.schema_arrow:
        kind = field.type
        if (
            types.is_integer(kind)
            or types.is_floating(kind)
            or types.is_boolean(kind)
            or types.is_decimal(kind)
            or (types.is_timestamp(kind) or types.is_duration(kind) or types.is_date(kind))
        ):
            if gathering.fits(field.name, file.metadata.num_rows):
                readable.append(field.name)
        else:
            gathering.leave_out(field.name, f"of type {kind}")
    return readable


def _values(pyarrow: Any, column: Any) -> Any:
    kind = column.type
    if (
        pyarrow.types.is_decimal(kind)
        or pyarrow.types.is_float16(kind)
        or pyarrow.types.is_boolean(kind)
    ):
        column = column.cast(pyarrow.float64())
    elif pyarrow.types.is_date(kind):
        column = column.cast(pyarrow.timestamp("ms"))
    elif pyarrow.types.is_integer(kind) and column.null_count:
        column = column.cast(pyarrow.float64(), safe=False)
    if pyarrow.types.is_floating(column.type):
        column = column.cast(pyarrow.float64()).fill_null(np.nan)
    return column.combine_chunks().to_numpy(zero_copy_only=False)


def _unit(field: Any) -> str:
    for name in UNIT_NAMES:
        value = (field.metadata or {}).get(name.encode())
        if value is not None:
            return str(value.decode(errors="replace"))
    return ""


KIND = Kind("parquet", (".parquet", ".pq"), read_parquet, (b"PAR1",), "parquet", ("pyarrow",))
