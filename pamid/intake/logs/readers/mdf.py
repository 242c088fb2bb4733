"""MDF files, versions 3 and 4, channel by channel with the stamps of its group: nothing is
filled in."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder
from pamid.intake.logs.log_kinds import Kind

#: conversion_type of formulas (not evaluated: a log shall not bring code) and of texts (raw numbers
#: are read instead)
_FORMULA = {True: (3,), False: (10,)}
_TEXT = {True: (7, 8, 9, 10, 11), False: (11, 12)}
_TIME_MASTER = (0, 1)  # sync_type of a master: unknown, time


def read_mdf(builder: ChannelBuilder) -> None:
    """Channels by their name, or "group 2/name" where several groups have it; stamps in s since the
    measurement began. A value marked invalid is NaN."""
    from asammdf import MDF

    with MDF(builder.path) as file:
        groups: list[Any] = list(file.groups)
        wanted = [
            (number, index)
            for number, group in enumerate(groups)
            for index in range(len(group.channels))
            if index != file.masters_db.get(number)
        ]
        names = Counter(groups[number].channels[index].name for number, index in wanted)
        reserved = []
        for number, index in wanted:
            channel = groups[number].channels[index]
            name = (
                channel.name if names[channel.name] == 1 else f"group {number + 1}/{channel.name}"
            )
            if _reserve(builder, groups[number].channel_group, name):
                reserved.append((number, index, name))
        for number, index, name in reserved:  # the sum of all is known before any is read
            _add(builder, file, number, index, name)
        builder.note(f"measured from {file.start_time}")


def _add(builder: ChannelBuilder, file: Any, number: int, index: int, name: str) -> None:
    group = file.groups[number]
    four = file.version >= "4.00"
    conversion = getattr(group.channels[index].conversion, "conversion_type", None)
    if conversion in _FORMULA[four]:
        builder.leave_out(name, "its conversion is a formula")
        return
    if _clock_conversion(file, number) in _FORMULA[four]:
        builder.leave_out(name, "the conversion of its clock is a formula")
        return
    words = conversion in _TEXT[four]
    signal = file.get(group=number, index=index, raw=words, ignore_invalidation_bits=True)
    values = np.asarray(signal.samples)
    if values.ndim != 1 or values.dtype.kind not in "biuf":
        builder.leave_out(name, "text" if values.dtype.kind in "SUO" else "not plain numbers")
        return
    if words:
        builder.note(f"{name}: raw numbers, because its conversion gives words")
    if signal.invalidation_bits is not None:
        invalid = np.asarray(signal.invalidation_bits, dtype=bool)
        if invalid.any():
            builder.note(f"{name}: {int(invalid.sum())} values are marked invalid and become empty")
            values = np.where(invalid, np.nan, values.astype(np.float64))
    stamps = _stamps(builder, file, number, signal, name)
    builder.add(name, values, stamps, signal.unit or "")


def _reserve(builder: ChannelBuilder, group: Any, name: str) -> bool:
    """Reserve memory for a channel and its stamps by the records that its group declares."""
    cycles = int(group.cycles_nr)
    record = int(group.samples_byte_nr) + int(getattr(group, "invalidation_bytes_nr", 0))
    if not builder.reserve(name, (cycles,), record):
        return False
    builder.budget.charge(name, cycles)
    return True


def _clock_conversion(file: Any, number: int) -> Any:
    """The conversion_type of the channel that stamps a group: whoever reads another channel
    evaluates it, too."""
    master = file.masters_db.get(number)
    clock = None if master is None else file.groups[number].channels[master]
    return getattr(getattr(clock, "conversion", None), "conversion_type", None)


def _stamps(builder: ChannelBuilder, file: Any, number: int, signal: Any, name: str) -> Any:
    master = file.masters_db.get(number)
    if master is None:
        builder.note(f"{name}: its group has no clock")
        return None
    channel = file.groups[number].channels[master]
    if getattr(channel, "sync_type", 1) not in _TIME_MASTER:
        builder.note(f"{name}: its group counts in {channel.name!r}, not in time")
        return None
    return np.asarray(signal.timestamps, dtype=np.float64)


KIND = Kind(
    "mdf", (".mf4", ".mdf", ".mf3"), read_mdf, (b"MDF     ", b"UnFinMF "), "mdf", ("asammdf",)
)
