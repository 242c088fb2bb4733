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

from pamid.base.arrays import Array
from pamid.base.errors import FileError, PamidError, nearest
from pamid.base.toml_file import read_toml
from pamid.base.units import NONE, split_column, unit, with_unit
from pamid.intake.logs.channel_columns import column_unit, is_foreign_unit
from pamid.intake.logs.source_units import (
    PRESSURE_DIMENSION,
    STANDARD_ATMOSPHERE_KPA,
    SourceUnit,
    in_unit,
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
    """A column of the recording, with the settings of its channel.

    stated     entry of the mapping
    symbol     unit of the column
    unit       unit of the channel; None if a scale replaces it
    absolute   whether it is an absolute pressure
    hold       whether a value holds until the next value, as for commands and references
    events     whether the mapping states the hold, so that a hold of any length is not a gap
    """

    column: str
    stated: SignalMap
    unit: SourceUnit | None
    absolute: bool
    hold: bool
    events: bool

    @property
    def symbol(self) -> str:
        return split_column(self.column)[1]

    def in_column(self, values: Array, atmosphere_pa: float) -> Array:
        """Values of the channel in the column's unit, with its scale, sign and offset."""
        pressure = atmosphere_pa if self.absolute else 0.0
        if self.unit is not None:
            converted = in_unit(values, self.unit, self.symbol, pressure)
        else:
            converted = values * (self.stated.scale or 1.0) - pressure / unit(self.symbol).factor
        converted = converted if self.stated.sign == 1 else -converted
        return converted + self.stated.offset if self.stated.offset else converted


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


def _fault(message: str, hint: str = "", code: str = "mapping") -> FileError:
    return FileError(message, hint, code=code)


def _columns(rig: Rig | None) -> list[str]:
    """Columns that a recording of the rig may have."""
    if rig is None:
        return []
    return [*rig.inputs, *rig.outputs, *(loop.reference for loop in rig.loops)]


def load_mapping(
    path: Path, pressures: str | None = None, period_s: float | None = None
) -> Mapping:
    """Read and check a mapping; FileError with the line (TOML) or the path of the key.

    pressures: "gauge" or "absolute" for every pressure that the mapping leaves open; FileError if
    it contradicts the mapping. period_s: overrides time.period_s.
    """

    def nearby() -> str:
        siblings = [item.name for item in path.parent.glob("*.toml")]
        return nearest(path.name, siblings) or "`pamid ingest --guess` writes a first version."

    tables = read_toml(path, nearby)
    signals = tables.get("signals")
    for column, table in signals.items() if pressures and isinstance(signals, dict) else ():
        if not isinstance(table, dict) or not _is_pressure(column):
            continue
        stated, text = table.get("pressure", UNANSWERED), table.get("unit")
        if stated not in (UNANSWERED, pressures):
            raise _fault(
                f"{path}: signals.{column}.pressure is {_shown(stated)}, but --pressures is "
                f'"{pressures}".',
                "Remove either of them.",
            )
        # a unit such as barg states the kind
        marked = isinstance(text, str) and is_readable(text) and read_unit(text).pressure
        if stated == UNANSWERED and not marked:
            table["pressure"] = pressures
    if period_s is not None and isinstance(tables.setdefault("time", {}), dict):
        tables["time"]["period_s"] = period_s
    return mapping_of(tables, str(path))


def _is_pressure(column: str) -> bool:
    return unit(split_column(column)[1]).dimension == PRESSURE_DIMENSION


def mapping_of(tables: dict[str, Any], where: str) -> Mapping:
    """Mapping from TOML tables; `where` names them in errors."""
    time = tables.get("time")
    if isinstance(time, dict) and time.get("period_s") == UNANSWERED:
        raise _fault(
            f'{where}: time.period_s is "?", and the log has no clock.',
            "Give the sampling period in s, for example period_s = 0.01 or --period 0.01. If a "
            "channel has the time, name it in time.source.",
            "period",
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
                hint = "Names are letters, digits and _."
                raise _fault(f"{where}: {title} has the key {key!r}.", hint)
    for column in mapping.between:
        if column not in mapping.signals:
            raise _fault(
                f"{where}: between.{column} is not a column of the mapping.",
                nearest(column, list(mapping.signals)) or f"Columns: {', '.join(mapping.signals)}.",
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
    held = set[str]()
    if rig is not None:
        # references and commands: inputs that a recording must have, or that a controller produces
        held = {name for loop in rig.loops for name in (loop.reference, loop.command)}
        held |= set(rig.inputs) - set(rig.optional)
    mapped = []
    for column, signal in mapping.signals.items():
        for wanted in _columns(rig):
            try:
                match_column(column, wanted)
            except PamidError as error:
                hint = "Name the column with such an ending; the source may be in any unit."
                raise _fault(f"{where}: signals: {error.message}", hint, "unit") from None
        hold = column in held or (
            rig is None and split_column(column)[0].split("_")[0] in ("command", "reference")
        )
        hold = mapping.between.get(column, "held" if hold else "") == "held"
        hold = hold if signal.interpolation is None else signal.interpolation == "hold"
        place, logged = f"{where}: signals.{column}", units.get(signal.source, "")
        source = _source_unit(signal, split_column(column)[1], logged, place)
        absolute = _is_absolute(column, signal, source, place)
        events = signal.interpolation == "hold"
        mapped.append(MappedSignal(column, signal, source, absolute, hold, events))
    return tuple(mapped)


def named_by_units(mapping: Mapping, rig: Rig | None) -> Mapping:
    """Mapping with the stated units in the column names: `angle` in deg becomes `angle_deg`.

    Columns that the rig names without a unit are not changed.
    """
    stems = {split_column(name)[0] for name in _columns(rig)}
    names: dict[str, str] = {}
    for column, signal in mapping.signals.items():
        symbol = NONE
        plain = split_column(column)[1] == NONE and column not in stems
        if plain and signal.scale is not None and signal.unit != NONE:
            raise _fault(
                f"signals.{column} has a scale, but its name has no unit for the result.",
                f"Add that unit to the name, for example [signals.{column}_deg] if scale is in "
                'degrees per count: 360 / (4 * lines) for an encoder. For a ratio give unit = "1".',
                "unit",
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
    """One sentence per column that the rig does not have; such columns are kept."""
    stems = {name: split_column(name)[0] for name in columns}
    known = {name: split_column(name)[0] for name in _columns(rig)}
    lacking = [name for name, stem in known.items() if stem not in stems.values()]
    return [
        f"rig {rig.name!r} has no column {name!r}; it is kept. {nearest(name, lacking)}".rstrip()
        for name, stem in stems.items()
        if stem not in known.values()
    ]


def _source_unit(signal: SignalMap, symbol: str, logged: str, place: str) -> SourceUnit | None:
    """Unit of a channel, by the mapping or the log; None if a scale replaces it."""
    example = _EXAMPLES.get(unit(symbol).quantity)
    if signal.scale is not None:
        if signal.scale == 0.0:
            raise _fault(
                f"{place}.scale is 0, which makes the column constant.",
                "Give another scale, or leave the signal out.",
            )
        return None
    if signal.unit is None and not logged and symbol != NONE:
        hint = "The log does not state it either. For example " + (example or '"1"') + "."
        raise _fault(f"{place}.unit is missing.", hint)
    text = logged if signal.unit is None else signal.unit
    if text == UNANSWERED:
        fitting = '"1", "percent"; the unit of a quantity becomes part of the column\'s name'
        raise _fault(
            f'{place}.unit is "?": give the unit that the channel has in the log.',
            f"For example {example or fitting}.",
            "unit",
        )
    try:
        source = read_unit(text)
        require_same_quantity(source, symbol)
    except FileError as error:
        message = f"{place}.unit is {text!r}: {error.message}"
        raise _fault(message, error.hint, "unit") from None
    stated = logged.strip() not in ("", "1", "-") and is_readable(logged)
    if stated and read_unit(logged).dimension != source.dimension:
        raise _fault(
            f"{place}.unit is {text!r}, but the log has {logged!r}.",
            f"Give scale, {symbol} per {logged}, in place of unit. If the log is wrong, give "
            "scale = 1.0.",
            "unit",
        )
    return source


def _is_absolute(column: str, signal: SignalMap, source: SourceUnit | None, place: str) -> bool:
    """Whether the values are absolute pressures, by the key or by the unit."""
    implied, pressure = source.pressure if source is not None else "", _is_pressure(column)
    if not pressure and signal.pressure is not None:
        raise _fault(
            f"{place}.pressure is {signal.pressure!r}, but {column!r} is not a pressure.",
            "Delete the key.",
        )
    if source is not None and implied and signal.pressure not in (None, implied):
        raise _fault(
            f"{place}.pressure is {signal.pressure!r}, but the unit {source.text!r} "
            f"means {implied} pressure.",
            "Correct one of the two.",
        )
    if pressure and not (implied or signal.pressure):
        message = f'{place}.pressure is missing; allowed: "gauge", "absolute".'
        raise _fault(message, _GAUGE, "pressure")
    return (signal.pressure or implied) == "absolute"


def _check_column(column: str, where: str) -> None:
    if column == TIME:
        raise _fault(
            f"{where}: signals.time_s: the time is not a signal.",
            "Name its channel in [time] source.",
        )
    if not _COLUMN.fullmatch(column):
        raise _fault(
            f"{where}: signals has the name {column!r}.",
            "A name has letters, digits and _, and ends in its unit: angle_deg, pressure_1_kpa, "
            "command.",
        )
    tail = column.rpartition("_")[2]
    if split_column(column)[1] == NONE and tail != column and is_foreign_unit(tail):
        # the column would be read as a column without a unit
        raise _fault(
            f"{where}: signals.{column}: {tail!r} is not a unit of pamid's columns.",
            "Use another unit in the name of the column, such as _kpa, _deg, _n, _nm. The source "
            "may have any unit.",
            "unit",
        )


def _explain(error: ValidationError, where: str) -> FileError:
    """First validation error as a sentence with the path of the key."""
    first = error.errors(include_url=False)[0]
    path, kind = [str(part) for part in first["loc"]], first["type"]
    place, shown = f"{where}: {'.'.join(path)}", _shown(first["input"])
    if kind == "extra_forbidden":
        models: dict[str, type[_Table]] = {
            "time": TimeMap,
            "atmosphere": Atmosphere,
            "signals": SignalMap,
        }
        keys = list((models[path[0]] if path[1:] else Mapping).model_fields)
        hint = nearest(path[-1], keys) or "Keys here are: " + ", ".join(keys) + "."
        return _fault(f"{place} is not a key of a mapping.", hint)
    if kind == "missing":
        source = path[-1] == "source"
        hint = "Give the name of the channel in the log."
        hint = hint if source else "Write a table [signals.NAME] with a source."
        return _fault(f"{place} is missing.", hint)
    if kind == "literal_error":
        words = re.findall(r"'[^']*'|-?\d+", first["ctx"]["expected"])
        allowed = [word.replace("'", '"') for word in words]
        near = nearest(str(first["input"]), [word.strip('"') for word in allowed])
        hint = _GAUGE if path[-1] == "pressure" else near
        return _fault(f"{place} is {shown}; allowed: {', '.join(allowed)}.", hint)
    wanted = {
        "float_type": "a number",
        "finite_number": "a finite number",
        "greater_than": "a number above 0",
        "string_type": "text in quotes",
        "too_short": "a [signals.NAME]",
    }
    need = wanted.get(kind, "a table" if "type" in kind else first["msg"])
    return _fault(f"{place} is {shown}; {need} is needed.")


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    return f"{value}" if len(f"{value}") < 40 else "a number of " + f"{len(str(value))} digits"
