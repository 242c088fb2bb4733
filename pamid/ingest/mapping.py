"""Mapping from the channels of a raw log to the columns of a recording: a TOML file, checked key
by key.

Every error names the file, the path of the key ("map.toml: signals.pressure_1_kpa.pressure is
..."), the allowed values and the nearest name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from pamid.base.errors import FileError, PamidError, nearest
from pamid.base.toml_file import read_toml
from pamid.base.units import NONE, split_column, unit, with_unit
from pamid.ingest.channel_columns import column_unit, is_foreign_unit
from pamid.ingest.source_units import (
    PRESSURE_DIMENSION,
    STANDARD_ATMOSPHERE_KPA,
    SourceUnit,
    is_readable,
    read_unit,
    require_same_quantity,
)
from pamid.model.rig import Rig
from pamid.recording.recording import TIME, match_column

UNANSWERED = "?"  # in a guessed mapping: the user must fill it in
Interpolation = Literal["hold", "smooth"]
Between = Literal["held", "linear", "before"]
Repair = Literal["ask", "late-stamps", "jittered-sampling", "none"]
_COLUMN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class TimeMap(_Table):
    """Time of a log: channel with the stamps (source) and its unit, sampling period of the
    recording to write, repair of the time base, and longest gap that does not split the
    recording."""

    source: str | None = None
    unit: str | None = None
    period_s: PositiveFloat | None = None
    repair: Repair = "ask"
    max_gap_s: PositiveFloat | None = None


class SignalMap(_Table):
    """A column: value = sign * (source in the column's unit, or scale * source) + offset
    (column's unit).

    rows: delay of the log in rows; -1 if a row has the value of the next row.
    """

    source: str
    unit: str | None = None
    scale: float | None = None
    pressure: Literal["gauge", "absolute"] | None = None
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    rows: int = 0
    interpolation: Interpolation | None = None


class Atmosphere(_Table):
    """Atmospheric pressure to subtract from absolute pressures."""

    pressure_kpa: PositiveFloat = STANDARD_ATMOSPHERE_KPA


class Mapping(_Table):
    """A complete mapping; known, controller and between are copied to the recording's TOML."""

    rig: str | None = None
    loop: Literal["open", "closed"] | None = None
    time: TimeMap = TimeMap()
    signals: dict[str, SignalMap] = Field(min_length=1)
    atmosphere: Atmosphere = Atmosphere()
    known: dict[str, float] = {}
    controller: dict[str, float] = {}
    between: dict[str, Between] = {}


@dataclass(frozen=True)
class MappedSignal:
    """A column of the recording, with all settings of its channel.

    unit       of the channel; None if `scale` replaces it
    absolute   whether it is an absolute pressure
    hold       whether a value holds until the next value, as for commands and references
    rows       delay of its values in rows
    events     whether the mapping states the hold, so that a hold of any length is not a gap
    """

    column: str
    source: str
    symbol: str
    unit: SourceUnit | None
    scale: float
    absolute: bool
    sign: int
    offset: float
    rows: int
    hold: bool
    events: bool


def load_mapping(
    path: Path, pressures: str | None = None, period_s: float | None = None
) -> Mapping:
    """Read and check a mapping; FileError with the line (TOML) or the path of the key.

    pressures: "gauge" or "absolute" for every pressure that the mapping leaves open; FileError if
    it contradicts the mapping. period_s: overrides time.period_s.
    """

    def nearby() -> str:
        siblings = (
            [item.name for item in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        )
        return (
            nearest(path.name, siblings)
            or "`pamid ingest --guess` writes a first mapping of a log."
        )

    tables = read_toml(path, nearby)
    if pressures is not None:
        _answer(tables.get("signals"), pressures, str(path))
    if period_s is not None and isinstance(tables.setdefault("time", {}), dict):
        tables["time"]["period_s"] = period_s
    return mapping_of(tables, str(path))


def _answer(signals: Any, pressures: str, where: str) -> None:
    """Enter the answer for every open pressure."""
    for column, table in signals.items() if isinstance(signals, dict) else ():
        if (
            not isinstance(table, dict)
            or unit(split_column(column)[1]).dimension != PRESSURE_DIMENSION
        ):
            continue
        stated = table.get("pressure", UNANSWERED)
        if stated not in (UNANSWERED, pressures):
            raise FileError(
                f"{where}: signals.{column}.pressure is {_shown(stated)}, but --pressures is "
                f'"{pressures}".',
                "Remove either of the two.",
                code="mapping",
            )
        if stated == UNANSWERED and not _names_kind(table.get("unit")):
            table["pressure"] = pressures


def _names_kind(text: Any) -> bool:
    """Whether a unit states gauge or absolute pressure, as barg does."""
    return isinstance(text, str) and is_readable(text) and bool(read_unit(text).pressure)


def mapping_of(tables: dict[str, Any], where: str) -> Mapping:
    """Mapping from TOML tables; `where` names them in errors."""
    time = tables.get("time")
    if isinstance(time, dict) and time.get("period_s") == UNANSWERED:
        raise FileError(
            f'{where}: time.period_s is "?", and the log has no clock.',
            "Give the sampling period in s, for example period_s = 0.01 or --period 0.01. If a "
            "channel has the time, name it in time.source.",
            code="period",
        )
    try:
        mapping = Mapping.model_validate(tables)
    except ValidationError as error:
        raise _explain(error, where) from None
    for column in mapping.signals:
        _check_column(column, where)
    for title, table in (("known", mapping.known), ("controller", mapping.controller)):
        for key in table:
            if not _COLUMN.fullmatch(key):
                raise FileError(
                    f"{where}: {title} has the key {key!r}.",
                    "Names are letters, digits and _.",
                    code="mapping",
                )
    for column in mapping.between:
        if column not in mapping.signals:
            raise FileError(
                f"{where}: between.{column} is not a column of the mapping.",
                nearest(column, list(mapping.signals)) or f"Columns: {', '.join(mapping.signals)}.",
                code="mapping",
            )
    return mapping


def resolved_signals(
    mapping: Mapping, rig: Rig | None, units: dict[str, str], where: str
) -> tuple[MappedSignal, ...]:
    """Complete the mapping of each signal with the units of the channels (channel -> unit, "" if
    the log states none).

    Raises FileError if a unit is missing, unknown or of another quantity, if the kind of a pressure
    is open, and if a column of the rig has a unit that pamid does not support.
    """
    held = set(_held(rig)) if rig else set()
    mapped = []
    for column, signal in mapping.signals.items():
        if rig is not None:
            for wanted in (*rig.inputs, *rig.outputs, *(loop.reference for loop in rig.loops)):
                _known_unit(column, wanted, where)
        hold = column in held or (
            rig is None and split_column(column)[0].split("_")[0] in ("command", "reference")
        )
        if (way := mapping.between.get(column)) is not None:
            hold = way == "held"
        hold = hold if signal.interpolation is None else signal.interpolation == "hold"
        mapped.append(_resolved_signal(column, signal, hold, units.get(signal.source, ""), where))
    return tuple(mapped)


def named_by_units(mapping: Mapping, rig: Rig | None) -> Mapping:
    """Mapping with the stated units in the column names: `angle` in deg becomes `angle_deg`.

    Columns that the rig names without a unit are not changed.
    """
    wanted = () if rig is None else (*rig.inputs, *rig.outputs, *(k.reference for k in rig.loops))
    stems = {split_column(name)[0] for name in wanted}
    names: dict[str, str] = {}
    for column, signal in mapping.signals.items():
        symbol = NONE
        plain = split_column(column)[1] == NONE and column not in stems
        if plain and signal.scale is not None and signal.unit != NONE:
            raise FileError(
                f"signals.{column} has a scale, but its name has no unit for the result.",
                f"Add that unit to the name, for example [signals.{column}_deg] if scale is in "
                'degrees per count: 360 / (4 * lines) for an encoder. For a ratio give unit = "1".',
                code="unit",
            )
        if plain and signal.unit is not None and signal.scale is None and is_readable(signal.unit):
            symbol = column_unit(signal.unit) if any(read_unit(signal.unit).dimension) else NONE
        name = with_unit(column, symbol)
        names[column] = column if name in (*mapping.signals, *names.values()) else name
    return mapping.model_copy(
        update={
            "signals": {names[column]: signal for column, signal in mapping.signals.items()},
            "between": {names[column]: way for column, way in mapping.between.items()},
        }
    )


def unknown_to(rig: Rig, columns: Iterable[str]) -> list[str]:
    """A sentence per column that the rig does not have; such columns are kept."""
    wanted = [*rig.inputs, *rig.outputs, *(loop.reference for loop in rig.loops)]
    columns, known = list(columns), {split_column(name)[0] for name in wanted}
    stems = {split_column(name)[0] for name in columns}
    lacking = [name for name in wanted if split_column(name)[0] not in stems]
    return [
        f"rig {rig.name!r} has no column {name!r}; it is kept. {nearest(name, lacking)}".rstrip()
        for name in columns
        if split_column(name)[0] not in known
    ]


def _resolved_signal(
    column: str, signal_map: SignalMap, hold: bool, logged: str, where: str
) -> MappedSignal:
    place, symbol = f"{where}: signals.{column}", split_column(column)[1]
    pressure = unit(symbol).dimension == PRESSURE_DIMENSION
    source = None
    if signal_map.scale is None:
        text = signal_map.unit if signal_map.unit is not None else logged
        if signal_map.unit is None and not logged and symbol != NONE:
            hint = (
                "The log does not state it either. For example "
                + _EXAMPLES.get(unit(symbol).quantity, '"1"')
                + "."
            )
            raise FileError(f"{place}.unit is missing.", hint, code="mapping")
        source = _read(text, symbol, place)
        _require_agreement(source, logged, symbol, place)
    elif signal_map.scale == 0.0:
        raise FileError(
            f"{place}.scale is 0, which makes the column constant.",
            "Give another scale, or leave the signal out.",
            code="mapping",
        )
    implied = source.pressure if source is not None else ""
    if not pressure and signal_map.pressure is not None:
        raise FileError(
            f"{place}.pressure is {signal_map.pressure!r}, but {column!r} is not a pressure.",
            "Delete the key.",
            code="mapping",
        )
    if source is not None and implied and signal_map.pressure not in (None, implied):
        raise FileError(
            f"{place}.pressure is {signal_map.pressure!r}, but the unit {source.text!r} "
            f"means {implied} pressure.",
            "Correct either of the two.",
            code="mapping",
        )
    if pressure and not (implied or signal_map.pressure):
        raise FileError(
            f'{place}.pressure is missing; allowed: "gauge", "absolute".', _GAUGE, code="pressure"
        )
    return MappedSignal(
        column,
        signal_map.source,
        symbol,
        source,
        signal_map.scale if signal_map.scale is not None else 1.0,
        (signal_map.pressure or implied) == "absolute",
        signal_map.sign,
        signal_map.offset,
        signal_map.rows,
        hold,
        signal_map.interpolation == "hold",
    )


_GAUGE = (
    "A log does not show it: a gauge sensor reads 0 with the air off, an absolute sensor about 1 "
    "bar (101 kPa, 14.7 psi)."
)
_EXAMPLES = {
    "pressure": '"bar", "kPa", "psi"',
    "angle": '"deg", "rad", "rev"',
    "force": '"N", "lbf"',
    "torque": '"N m"',
    "time": '"s", "ms"',
}


def _require_agreement(source: SourceUnit, logged: str, symbol: str, place: str) -> None:
    """Refuse a unit of another quantity than the unit that the log states."""
    if logged.strip() in ("", "1", "-") or not is_readable(logged):
        return
    if read_unit(logged).dimension != source.dimension:
        raise FileError(
            f"{place}.unit is {source.text!r}, but the log has {logged!r}.",
            f"Give scale, {symbol} per {logged}, in place of unit. If the log is wrong, give "
            "scale = 1.0.",
            code="unit",
        )


def _read(text: str, symbol: str, place: str) -> SourceUnit:
    if text == UNANSWERED:
        fitting = '"1", "percent"; the unit of a quantity becomes part of the column\'s name'
        hint = "For example " + _EXAMPLES.get(unit(symbol).quantity, fitting) + "."
        raise FileError(
            f'{place}.unit is "?": give the unit that the channel has in the log.',
            hint,
            code="unit",
        )
    try:
        source_unit = read_unit(text)
        require_same_quantity(source_unit, symbol)
    except FileError as error:
        raise FileError(
            f"{place}.unit is {text!r}: {error.message}", error.hint, code="unit"
        ) from None
    return source_unit


def _held(rig: Rig) -> list[str]:
    """References and commands: inputs that a recording must have, or that a controller produces."""
    loops = [name for loop in rig.loops for name in (loop.reference, loop.command)]
    return [*loops, *(name for name in rig.inputs if name not in rig.optional)]


def _known_unit(column: str, wanted: str, where: str) -> None:
    try:
        match_column(column, wanted)
    except PamidError as error:
        raise FileError(
            f"{where}: signals: {error.message}",
            "Name the column with such an ending; the source may be in any unit.",
            code="unit",
        ) from None


def _check_column(column: str, where: str) -> None:
    if column == TIME:
        raise FileError(
            f"{where}: signals.time_s: the time is not a signal.",
            "Name its channel in [time] source.",
            code="mapping",
        )
    if not _COLUMN.fullmatch(column):
        raise FileError(
            f"{where}: signals has the name {column!r}.",
            "A name has letters, digits and _, and ends in its unit: angle_deg, pressure_1_kpa, "
            "command.",
            code="mapping",
        )
    tail = column.rpartition("_")[2]
    if split_column(column)[1] == NONE and tail != column and is_foreign_unit(tail):
        # the column would be read as a column without a unit
        raise FileError(
            f"{where}: signals.{column}: {tail!r} is not a unit of pamid's columns.",
            "Use another unit in the name of the column, such as _kpa, _deg, _n, _nm. The source "
            "may have any unit.",
            code="unit",
        )


def _explain(error: ValidationError, where: str) -> FileError:
    """First validation error as a sentence with the path of the key."""
    first = error.errors(include_url=False)[0]
    path, kind = [str(part) for part in first["loc"]], first["type"]
    place, given = ".".join(path), first["input"]
    if kind == "extra_forbidden":
        keys = list(_fields(path[:-1]))
        hint = nearest(path[-1], keys) or "Keys here are: " + ", ".join(keys) + "."
        return FileError(f"{where}: {place} is not a key of a mapping.", hint, code="mapping")
    if kind == "missing":
        hint = (
            "Give the name of the channel in the log."
            if path[-1] == "source"
            else "Write a table [signals.NAME] with a source."
        )
        return FileError(f"{where}: {place} is missing.", hint, code="mapping")
    shown = _shown(given)
    if kind == "literal_error":
        allowed = _allowed(first["ctx"]["expected"])
        hint = (
            _GAUGE
            if path[-1] == "pressure"
            else nearest(str(given), [word.strip('"') for word in allowed])
        )
        return FileError(
            f"{where}: {place} is {shown}; allowed: {', '.join(allowed)}.", hint, code="mapping"
        )
    wanted = {
        "float_type": "a number",
        "finite_number": "a finite number",
        "greater_than": "a number above 0",
        "string_type": "text in quotes",
        "too_short": "a [signals.NAME]",
    }
    need = wanted.get(kind, "a table" if "type" in kind else first["msg"])
    return FileError(f"{where}: {place} is {shown}; {need} is needed.", code="mapping")


def _fields(path: list[str]) -> Iterable[str]:
    """Allowed keys of the table at `path`."""
    models: dict[str, type[_Table]] = {
        "time": TimeMap,
        "atmosphere": Atmosphere,
        "signals": SignalMap,
    }
    return (models[path[0]] if path else Mapping).model_fields


def _allowed(expected: str) -> list[str]:
    return [word.replace("'", '"') for word in re.findall(r"'[^']*'|-?\d+", expected)]


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    return f"{value}" if len(f"{value}") < 40 else "a number of " + f"{len(str(value))} digits"
