"""Columns for the channels of a log that no rig has names for yet: their own names and units, as a
recording spells them."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.base.errors import PamidError
from pamid.base.units import (
    NONE,
    Dimension,
    is_unit,
    known_symbols,
    split_column,
    unit,
    with_unit,
)
from pamid.ingest.channel_words import meanings, tokens
from pamid.ingest.channels import ANY, Channel
from pamid.ingest.source_units import is_readable, read_unit

#: of units alike the ones that recordings mostly have
FIRST = ("N m", "deg", "rpm", "kPa", "mm", "N", "A", "V", "W", "s", "degC")
TURNS = "U/min"  # what a speed in 1/min is
_SI_BASES = ("kg", "m", "s", "A", "K", "rad")
_PER_TIME = (0, 0, -1, 0, 0, 0)
_LATIN = str.maketrans({"а": "a", "е": "e", "о": "o", "с": "c", "р": "p", "х": "x"})


def own_columns(channels: Sequence[Channel], angles: str = "") -> dict[str, tuple[Channel, str]]:
    """Column -> (channel, unit in which the log has it, "" where it does not say); of two that
    would be called alike the second is numbered. angles: unit of those whose unit the log does not
    say."""
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
    """The unit of a channel, by the log or by its name; a speed per minute is one of turns."""
    name, text = channel.name.rpartition("/")[2], channel.unit.strip()
    if not text or not is_readable(text):
        return _named_unit(name)[1]
    turns = read_unit(text).dimension == _PER_TIME and "velocity" in meanings(name)
    return TURNS if turns else text


def _named_unit(name: str) -> tuple[str, str]:
    """A name without the unit at its end, and the unit: of a column ("angle_deg") or as logs write
    it ("angle_degrees"); "" where it has none."""
    stem, symbol = split_column(name)
    if symbol != NONE:
        return stem, symbol
    stem, _, tail = name.rpartition("_")
    return (stem, tail) if stem and is_foreign_unit(tail) else (name, "")


def is_foreign_unit(tail: str) -> bool:
    """Is the last word of a name a unit that logs write and columns do not have?"""
    readable = len(tail) > 2 and not is_unit(tail) and is_readable(tail)
    return readable and any(read_unit(tail).dimension)


def _apart(stem: str, symbol: str) -> str:
    """The stem, its last words joined until the column's unit is read as it was meant: "channel_a"
    in V is "channela_v", since "channel_a_v" would be in A V."""
    while "_" in stem:
        foreign = symbol == NONE and is_foreign_unit(stem.rpartition("_")[2])
        if split_column(with_unit(stem, symbol)) == (stem, symbol) and not foreign:
            break
        head, _, tail = stem.rpartition("_")
        stem = head + tail
    return stem


def column_unit(text: str) -> str:
    """The unit of a column for what a log has in this unit: of the same size, else that of SI."""
    wanted = read_unit(text)
    for same_size in (True, False):
        for symbol in (*FIRST, *known_symbols()):
            one = unit(symbol)
            near = abs(one.factor - (wanted.factor if same_size else 1.0)) <= 1e-9 * one.factor
            near = near and abs(one.offset - wanted.offset) <= 1e-9 * one.offset
            if one.dimension == wanted.dimension and near:
                return symbol
    try:
        return unit(text).symbol
    except PamidError:
        return _of_bases(wanted.dimension)


def _of_bases(dimension: Dimension) -> str:
    """The unit of SI as a product of its bases: "m3/s"."""
    powers = list(zip(_SI_BASES, dimension, strict=True))
    above = [f"{base}{n if n > 1 else ''}" for base, n in powers if n > 0]
    below = [f"{base}{-n if n < -1 else ''}" for base, n in powers if n < 0]
    if not below:
        return " ".join(above) or NONE
    under = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return f"{' '.join(above) or 1}/{under}"


def _stem(channel: Channel) -> str:
    """ "Winkel Abtrieb" -> "winkel_abtrieb", "data/1" -> "data_1"; what only stands for the unit
    goes."""
    group, _, name = channel.name.rpartition("/")
    if name.isdigit():
        name = f"{group.rpartition('/')[2].strip(ANY)}_{name}"
    words = [w.translate(_LATIN) for w in tokens(_named_unit(name)[0])]
    plain = [w for w in words if w.isascii()] or ["channel"]
    text = "_".join(plain)
    return text if not text[0].isdigit() and text != "time" else f"channel_{text}"
