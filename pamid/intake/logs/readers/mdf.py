"""MDF files, versions 3 and 4, channel by channel with the stamps of its group: nothing is
filled in."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder, Kind

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
            # memory for a channel and its stamps, by the records that its group declares
            group = groups[number].channel_group
            cycles = int(group.cycles_nr)
            record = int(group.samples_byte_nr) + int(getattr(group, "invalidation_bytes_nr", 0))
            if builder.reserve(name, (cycles,), record):
                builder.budget.charge(name, cycles)
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
    # whoever reads a channel evaluates the conversion of the clock of its group, too
    master = file.masters_db.get(number)
    clock = None if master is None else group.channels[master]
    clock_conversion = getattr(clock, "conversion", None)
    if getattr(clock_conversion, "conversion_type", None) in _FORMULA[four]:
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
    stamps = None
    if clock is None:
        builder.note(f"{name}: its group has no clock")
    elif getattr(clock, "sync_type", 1) not in _TIME_MASTER:
        builder.note(f"{name}: its group counts in {clock.name!r}, not in time")
    else:
        stamps = np.asarray(signal.timestamps, dtype=np.float64)
    builder.add(name, values, stamps, signal.unit or "")


KIND = Kind(
    "mdf", (".mf4", ".mdf", ".mf3"), read_mdf, (b"MDF     ", b"UnFinMF "), "mdf", ("asammdf",)
)
