"""Parquet files. Columns of numbers, truth values, dates and durations, and of lists of numbers
of equal length; texts and other nested columns are left out by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.memory_budget import FLOAT
from pamid.intake.logs.readers.hdf5 import unit_of


def read_parquet(builder: ChannelBuilder) -> None:
    """Every column as a channel without stamps; null becomes NaN; the unit is the field's metadata
    `unit`."""
    for name, values, unit in columns_of(builder, builder.path):
        builder.add(name, values, unit=unit)


def columns_of(builder: ChannelBuilder, path: Path) -> Iterator[tuple[str, Any, str]]:
    """(name, values, unit) of every column that can be a channel, or (n, m) lists of m numbers; the
    others are left out by name."""
    import pyarrow
    import pyarrow.compute
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        # how many values the footer declares, by column
        declared: Counter[str] = Counter()
        groups = (file.metadata.row_group(index) for index in range(file.metadata.num_row_groups))
        for group in groups:
            for index in range(group.num_columns):
                chunk = group.column(index)  # its path is NAME or NAME.list.element
                parts = chunk.path_in_schema.split(".")
                for end in range(1, len(parts) + 1):
                    declared[".".join(parts[:end])] += chunk.num_values
        rows = file.metadata.num_rows
        reserved = [  # the sum of all is known before any is read; a decimal has 16 bytes
            name
            for name in _columns(builder, file)
            if builder.reserve(name, (max(rows, declared[name]),), 2 * FLOAT)
        ]
        for name in reserved:
            column = file.read(columns=[name], use_threads=False).column(0)
            field = file.schema_arrow.field(name)
            metadata = field.metadata or {}
            unit = unit_of({key.decode(errors="replace"): text for key, text in metadata.items()})
            if not _is_list(field.type):
                yield name, _values(pyarrow, column), unit
                continue
            lengths = pyarrow.compute.list_value_length(column).drop_null().unique().to_pylist()
            if len(lengths) != 1 or not lengths[0]:
                builder.leave_out(name, "lists of different lengths" if lengths else "empty")
                continue
            builder.budget.charge(name, 0, raw=FLOAT * rows * lengths[0])
            flat = pyarrow.compute.list_flatten(column).cast(pyarrow.float64(), safe=False)
            flat = flat.fill_null(np.nan)
            values = np.full((rows, lengths[0]), np.nan)  # NaN where a list is missing
            values[column.is_valid().to_numpy()] = flat.to_numpy().reshape(-1, lengths[0])
            yield name, values, unit


def _is(kind: Any, *words: str) -> bool:
    """Whether a type is one of pyarrow's of these names."""
    import pyarrow.types

    return any(getattr(pyarrow.types, f"is_{word}")(kind) for word in words)


def _is_list(kind: Any) -> bool:
    lists = _is(kind, "list", "large_list", "fixed_size_list")
    return lists and _is(kind.value_type, "floating", "integer")


def _columns(builder: ChannelBuilder, file: Any) -> list[str]:
    """Names of the columns that can be channels."""
    readable = []
    for field in file.schema_arrow:
        numbers = _is(field.type, "integer", "floating", "boolean", "decimal")
        if numbers or _is(field.type, "timestamp", "duration", "date") or _is_list(field.type):
            readable.append(field.name)
        else:
            builder.leave_out(field.name, f"of type {field.type}")
    return readable


def _values(pyarrow: Any, column: Any) -> Any:
    if _is(column.type, "decimal", "float16", "boolean"):
        column = column.cast(pyarrow.float64())
    elif _is(column.type, "date"):
        column = column.cast(pyarrow.timestamp("ms"))
    elif _is(column.type, "integer") and column.null_count:
        column = column.cast(pyarrow.float64(), safe=False)
    if _is(column.type, "floating"):
        column = column.cast(pyarrow.float64()).fill_null(np.nan)
    return column.combine_chunks().to_numpy(zero_copy_only=False)


KIND = Kind("parquet", (".parquet", ".pq"), read_parquet, (b"PAR1",), "parquet", ("pyarrow",))
