"""Parquet files. Columns of numbers, truth values, dates and durations, and of lists of numbers
of equal length; texts and other nested columns are left out by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pamid.ingest.channel_builder import ChannelBuilder
from pamid.ingest.channels import Log
from pamid.ingest.log_kinds import Kind
from pamid.ingest.memory_budget import FLOAT
from pamid.ingest.readers.hdf5 import UNIT_NAMES


def read_parquet(path: Path) -> Log:
    """Every column as a channel without stamps; null becomes NaN; the unit is the field's metadata
    `unit`."""
    builder = ChannelBuilder(path)
    for name, values, unit in columns_of(builder, path):
        builder.add(name, values, unit=unit)
    return builder.log(path, "parquet")


def columns_of(builder: ChannelBuilder, path: Path) -> Iterator[tuple[str, Any, str]]:
    """(name, values, unit) of every column that can be a channel, or (n, m) lists of m numbers; the
    others are left out by name."""
    import pyarrow
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        declared = _declared(file)
        rows = file.metadata.num_rows
        reserved = [  # the sum of all is known before any is read; a decimal has 16 bytes
            name
            for name in _columns(builder, file)
            if builder.reserve(name, (max(rows, declared[name]),), 2 * FLOAT)
        ]
        for name in reserved:
            column = file.read(columns=[name], use_threads=False).column(0)
            field = file.schema_arrow.field(name)
            if _is_list(field.type):
                values = _lists(builder, name, column, file.metadata.num_rows)
                if values is not None:
                    yield name, values, _unit(field)
            else:
                yield name, _values(pyarrow, column), _unit(field)


def _is_list(kind: Any) -> bool:
    import pyarrow.types as types

    return bool(
        (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))
        and (types.is_floating(kind.value_type) or types.is_integer(kind.value_type))
    )


def _lists(builder: ChannelBuilder, name: str, column: Any, rows: int) -> Any:
    """A column of lists as (n, m), NaN where a list is missing; None, and left out, where their
    lengths differ."""
    import pyarrow
    import pyarrow.compute

    lengths = pyarrow.compute.list_value_length(column).drop_null().unique().to_pylist()
    if len(lengths) != 1 or not lengths[0]:
        builder.leave_out(name, "lists of different lengths" if lengths else "empty")
        return None
    builder.budget.charge(name, 0, raw=FLOAT * rows * lengths[0])
    flat = (
        pyarrow.compute.list_flatten(column).cast(pyarrow.float64(), safe=False).fill_null(np.nan)
    )
    there = column.is_valid().to_numpy()
    values = np.full((rows, lengths[0]), np.nan)
    values[there] = flat.to_numpy().reshape(-1, lengths[0])
    return values


def _columns(builder: ChannelBuilder, file: Any) -> list[str]:
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
            or _is_list(kind)
        ):
            readable.append(field.name)
        else:
            builder.leave_out(field.name, f"of type {kind}")
    return readable


def _declared(file: Any) -> Counter[str]:
    """How many values the footer declares, by column; of lists those inside."""
    declared: Counter[str] = Counter()
    groups = (file.metadata.row_group(index) for index in range(file.metadata.num_row_groups))
    for group in groups:
        for index in range(group.num_columns):
            chunk = group.column(index)  # its path is NAME or NAME.list.element
            parts = chunk.path_in_schema.split(".")
            for end in range(1, len(parts) + 1):
                declared[".".join(parts[:end])] += chunk.num_values
    return declared


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
