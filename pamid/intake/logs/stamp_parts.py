"""Stamps in several columns: whole seconds and nanoseconds (ROS, timeval), or hours, minutes and
seconds. They are joined into a channel in seconds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.units import unit
from pamid.intake.logs.channel_builder import SINCE_1970_NS
from pamid.intake.logs.channel_words import TIME_WORDS, tokens
from pamid.intake.logs.channels import Channel, Log
from pamid.intake.logs.source_units import is_readable, read_unit

_SECOND = unit("s").dimension
_DAY_S = 86400.0
_FRACTIONS = ("ms", "us", "ns")


def join_stamp_parts(log: Log) -> Log:
    """Replace the parts of each clock of a log by a single channel.

    The names of the parts differ only in a unit of time. Columns without names must be adjacent,
    with seconds since 1970 first. The finer part is always below a unit of the coarser part, and
    falls only where that advances.
    """
    rows = [c for c in log.channels if c.stamps is None]
    # channels with equal names except for the unit of time, by that unit
    named: dict[tuple[str, ...], dict[str, Channel]] = {}
    for channel in rows:
        words = tokens(channel.name)
        symbol = TIME_WORDS.get(words[-1], "") if words else ""
        stem = words[:-1] if symbol else words
        if is_readable(channel.unit) and read_unit(channel.unit).dimension == _SECOND:
            symbol = channel.unit
        if symbol:
            named.setdefault(stem, {}).setdefault(symbol, channel)
    groups = [[(c, s) for s, c in group.items()] for group in named.values() if len(group) > 1]
    channels, details = list(log.channels), list(log.details)
    for parts in groups or _epoch_pair(rows):
        ordered = sorted(parts, key=lambda part: -_size(part[1]))
        values = _joined([(channel.values, _size(symbol)) for channel, symbol in ordered])
        if values is None:
            continue
        names = [channel.name for channel, _ in ordered]
        name = os.path.commonprefix(names).rstrip("./_ -:[(") or "time"
        if any(name == channel.name for channel in channels):
            name = f"{name} ({' + '.join(names)})"
        place = next(i for i, c in enumerate(channels) if c is ordered[0][0])
        channels[place] = Channel(name, values, unit="s")
        channels = [c for c in channels if all(c is not part for part, _ in ordered)]
        details.append(f"{name}: {' + '.join(names)}, in s since the first")
    return replace(log, channels=tuple(channels), details=tuple(details))


def _epoch_pair(channels: Sequence[Channel]) -> list[list[tuple[Channel, str]]]:
    """Seconds since 1970 and the next column, whose values show its fraction of a second."""
    low, high = (1e-9 * moment for moment in SINCE_1970_NS)
    for seconds, fraction in zip(channels, channels[1:], strict=False):
        first, most = seconds.values[:1], np.max(fraction.values, initial=0.0)
        named = {seconds.name, fraction.name} - {f"column_{i}" for i in range(len(channels) + 9)}
        symbol = next((fraction for fraction in _FRACTIONS if most * _size(fraction) < 1.0), "")
        if not named and symbol and (low <= first).all() and (first <= high).all():
            return [[(seconds, "s"), (fraction, symbol)]]
    return []


def _joined(parts: Sequence[tuple[Array, float]]) -> Array | None:
    """Sum of the parts, coarsest first, each with its size in s, from the first instant on; None if
    they are separate clocks."""
    for (coarse, size), (fine, finer) in zip(parts, parts[1:], strict=False):
        whole = np.array_equal(coarse, np.round(coarse))
        below = bool(((fine >= 0.0) & (fine * finer < size)).all())
        falls = np.diff(fine) < 0.0
        if not whole or not below or (falls & (np.diff(coarse) == 0.0)).any():
            return None
    total = sum(((values - values[0]) * size for values, size in parts), np.zeros(len(parts[0][0])))
    return total + _DAY_S * np.cumsum(np.diff(total, prepend=total[:1]) < -_DAY_S / 2.0)


def _size(symbol: str) -> float:
    """Seconds in a unit of time."""
    return read_unit(symbol).factor
