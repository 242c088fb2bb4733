"""Column names for the channels of a log without a rig: names and units of the channels, in the
spelling of recordings."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.base.errors import PamidError
from pamid.base.units import NONE, is_unit, known_symbols, split_column, unit, with_unit
from pamid.intake.logs.channel_words import meanings, tokens
from pamid.intake.logs.channels import ANY, Channel
from pamid.intake.logs.source_units import is_readable, read_unit

#: preferred units among those of equal size
FIRST = ("N m", "deg", "rpm", "kPa", "mm", "N", "A", "V", "W", "s", "degC")
TURNS = "U/min"  # meaning of 1/min for a speed
_SI_BASES = ("kg", "m", "s", "A", "K", "rad")
_PER_TIME = (0, 0, -1, 0, 0, 0)
_LATIN = str.maketrans({"а": "a", "е": "e", "о": "o", "с": "c", "р": "p", "х": "x"})


def channel_columns(
    channels: Sequence[Channel], angles: str = ""
) -> dict[str, tuple[Channel, str]]:
    """Column -> (channel, its unit in the log, "" if not stated); a second column of the same name
    is numbered.

    angles: unit of angles for which the log states none.
    """
    columns: dict[str, tuple[Channel, str]] = {}
    for channel in channels:
        text = logged_unit(channel)
        if not text and meanings(channel.name.rpartition("/")[2]) == {"angle"}:
            text = angles
        symbol = column_unit(text) if text else NONE
        stem, count = _apart(_stem(channel), symbol), 1
        column = with_unit(stem, symbol)
        while column in columns:
            count += 1
            column = with_unit(f"{stem}_{count}", symbol)
        columns[column] = (channel, text)
    return columns


def logged_unit(channel: Channel) -> str:
    """Unit of a channel, by the log or by its name; a speed in 1/min is in turns per minute."""
    name, text = channel.name.rpartition("/")[2], channel.unit.strip()
    if not text or not is_readable(text):
        return _named_unit(name)[1]
    turns = read_unit(text).dimension == _PER_TIME and "velocity" in meanings(name)
    return TURNS if turns else text


def _named_unit(name: str) -> tuple[str, str]:
    """A name without the unit at its end, and the unit, "" if it has none.

    The unit is that of a column ("angle_deg") or in a log's spelling ("angle_degrees").
    """
    stem, symbol = split_column(name)
    if symbol != NONE:
        return stem, symbol
    stem, _, tail = name.rpartition("_")
    return (stem, tail) if stem and is_foreign_unit(tail) else (name, "")


def is_foreign_unit(tail: str) -> bool:
    """Whether the last word of a name is a unit of logs that columns do not support."""
    readable = len(tail) > 2 and not is_unit(tail) and is_readable(tail)
    return readable and any(read_unit(tail).dimension)


def _apart(stem: str, symbol: str) -> str:
    """Stem with its last words joined until the unit is unambiguous: "channel_a" in V becomes
    "channela_v", because "channel_a_v" would be in A V."""
    while "_" in stem:
        foreign = symbol == NONE and is_foreign_unit(stem.rpartition("_")[2])
        if split_column(with_unit(stem, symbol)) == (stem, symbol) and not foreign:
            break
        head, _, tail = stem.rpartition("_")
        stem = head + tail
    return stem


def column_unit(text: str) -> str:
    """Unit of a column for a channel in this unit: a unit of the same size, else that of SI."""
    wanted = read_unit(text)
    for same_size in (True, False):
        for symbol in (*FIRST, *known_symbols()):
            target = unit(symbol)
            factor = wanted.factor if same_size else 1.0
            near = abs(target.factor - factor) <= 1e-9 * target.factor
            near = near and abs(target.offset - wanted.offset) <= 1e-9 * target.offset
            if target.dimension == wanted.dimension and near:
                return symbol
    try:
        return unit(text).symbol
    except PamidError:
        # SI unit as a product of base units
        powers = list(zip(_SI_BASES, wanted.dimension, strict=True))
        above = [f"{base}{n if n > 1 else ''}" for base, n in powers if n > 0]
        below = [f"{base}{-n if n < -1 else ''}" for base, n in powers if n < 0]
        if not below:
            return " ".join(above) or NONE
        under = below[0] if len(below) == 1 else f"({' '.join(below)})"
        return f"{' '.join(above) or 1}/{under}"


def _stem(channel: Channel) -> str:
    """Stem of a column name, without the unit: "Winkel Abtrieb" -> "winkel_abtrieb", "data/1" ->
    "data_1"."""
    group, _, name = channel.name.rpartition("/")
    if name.isdigit():
        name = f"{group.rpartition('/')[2].strip(ANY)}_{name}"
    words = [w.translate(_LATIN) for w in tokens(_named_unit(name)[0])]
    plain = [w for w in words if w.isascii()] or ["channel"]
    text = "_".join(plain)
    return text if not text[0].isdigit() and text != "time" else f"channel_{text}"
