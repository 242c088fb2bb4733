"""JSON logs as people write them: arrays of records, records of arrays, a record a line, and
either of these nested in others, as `data[i].actions`."""

from __future__ import annotations

import json
from typing import Any

from pamid.base.errors import FileError
from pamid.intake.logs.channel_builder import MAX_COLUMNS, ChannelBuilder, Kind
from pamid.intake.logs.readers.text import decode
from pamid.intake.logs.text_cells import add_column

OBJECT_BYTES = 12  # memory that a byte of the file takes as objects
_UNIT_KEYS = ("unit", "units", "Unit", "Units")


def read_json(builder: ChannelBuilder) -> None:
    """Every array of numbers as a channel named by its keys, joined by "/"; the elements of a
    record's short array are name/1, name/2 ... Times are channels like the others.

    FileError for a file that is no JSON or holds no array of numbers.
    """
    builder.budget.charge("its objects", 0, raw=OBJECT_BYTES * builder.path.stat().st_size)
    text, _ = decode(builder.budget)
    _enter(builder, "", _parsed(builder, text))


def _parsed(builder: ChannelBuilder, text: str) -> Any:
    """The value in a file, or the list of those in its lines."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        whole = error
    lines = [line for line in text.split("\n") if line.strip()]
    try:
        values = [json.loads(line) for line in lines[:-1]]
    except json.JSONDecodeError:
        values = []
    else:
        try:
            values += map(json.loads, lines[-1:])
        except json.JSONDecodeError:
            builder.note("the last line is incomplete and is left out")
    if len(values) < 2:
        raise FileError(
            f"{builder.path}, line {whole.lineno}: {whole.msg}: this is not JSON.",
            "The file may be truncated or damaged there. Export it again.",
            code="damaged",
        )
    return values


def _enter(builder: ChannelBuilder, name: str, value: Any) -> None:
    """Enter a value and all that is in it, under this name."""
    if isinstance(value, dict):
        _enter_record(builder, name, value)
    elif isinstance(value, list):
        _enter_list(builder, name, value)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        builder.leave_out(f"{name} = {value:.6g}", "a single number")
    elif value is not None:
        builder.leave_out(name, "text" if isinstance(value, str) else "a single value")


def _enter_record(builder: ChannelBuilder, name: str, record: dict[str, Any]) -> None:
    arrays = [key for key, value in record.items() if isinstance(value, list)]
    unit = next((record[k] for k in _UNIT_KEYS if isinstance(record.get(k), str)), "")
    names, rows = record.get("columns"), record.get("data")
    if (  # as pandas splits a table
        isinstance(names, list)
        and isinstance(rows, list)
        and all(_is_plain(row) and len(row) == len(names) for row in rows)
    ):
        for column, key in enumerate(names):
            _column(builder, _inside(name, str(key)), [row[column] for row in rows])
    elif unit and len(arrays) == 1 and _is_plain(record[arrays[0]]):
        _column(builder, name or arrays[0], record[arrays[0]], unit)
    elif len(record) > 1 and list(record) == [str(i) for i in range(len(record))]:
        _enter_list(builder, name, list(record.values()))  # pandas numbers the rows of a column
    else:
        for key, inside in record.items():
            _enter(builder, _inside(name, key), inside)


def _enter_list(builder: ChannelBuilder, name: str, values: list[Any]) -> None:
    if _is_plain(values):
        _column(builder, name, values)
        return
    there = [value for value in values if value is not None]
    of_records = all(isinstance(value, dict) for value in there)
    # columns of rows of numbers; 0 where they are none
    widths = {len(value) if _is_plain(value) else 0 for value in there}
    width = widths.pop() if len(widths) == 1 else 0
    if of_records and len(there) == len(values) and _are_rows(values):
        keys = dict.fromkeys(key for value in values for key in value)
        for key in keys:
            _enter_list(builder, _inside(name, key), [value.get(key) for value in values])
    elif of_records and len(there) < len(values):  # some records lack it
        _enter_list(builder, name, [value if isinstance(value, dict) else {} for value in values])
    elif 0 < width <= min(MAX_COLUMNS, len(values)):
        for column in range(width):
            cells = [None if row is None else row[column] for row in values]
            _column(builder, _inside(name, str(column + 1)), cells)
    else:
        for index, inside in enumerate(values):
            _enter(builder, _inside(name, str(index + 1)), inside)


def _column(builder: ChannelBuilder, name: str, cells: list[Any], unit: str = "") -> None:
    import pandas

    add_column(builder, name or "value", pandas.Series(cells), unit, ".")


def _inside(name: str, key: str) -> str:
    return f"{name}/{key}" if name else key


def _is_plain(values: Any) -> bool:
    """Is it a list without further ones inside?"""
    return isinstance(values, list) and not any(isinstance(value, list | dict) for value in values)


def _are_rows(records: list[Any]) -> bool:
    """Are these samples? Else they are recordings, with arrays of different lengths."""
    count = len(records)
    for key in dict.fromkeys(
        key for record in records if isinstance(record, dict) for key in record
    ):
        inside = [record[key] for record in records if isinstance(record, dict) and key in record]
        if any(isinstance(item, dict) for item in inside) and not _are_rows(inside):
            return False
        arrays = [item for item in inside if isinstance(item, list)]
        if len({len(array) for array in arrays}) > 1:
            return False
        if any(len(array) >= count or not _is_plain(array) for array in arrays):
            return False
    return True


KIND = Kind("json", (".json", ".jsonl", ".ndjson"), read_json)
