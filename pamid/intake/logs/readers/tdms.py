"""TDMS files of LabVIEW. Stamps come from a waveform's increment and start; channels may begin at
different times."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.memory_budget import FLOAT


def read_tdms(builder: ChannelBuilder) -> None:
    """Channels "group/channel"; with stamps in s since the earliest start where they are
    waveforms."""
    from nptdms import TdmsFile

    # a segment of a few bytes can declare any number of values: count them before reading any
    for channel in _channels(TdmsFile.read_metadata(builder.path)):
        builder.reserve(f"{channel.group_name}/{channel.name}", (len(channel),), FLOAT)
        if _is_waveform(channel):
            builder.budget.charge(f"{channel.group_name}/{channel.name}", len(channel))
    file = TdmsFile.read(builder.path)
    if file.file_status.incomplete_final_segment:
        builder.note("the last segment is incomplete, as after a crash; its written part is read")
    channels = _channels(file)
    starts = [
        channel.properties["wf_start_time"]
        for channel in channels
        if _is_waveform(channel)
        and isinstance(channel.properties.get("wf_start_time"), np.datetime64)
    ]
    zero = min(starts) if starts else None
    for channel in channels:
        name = f"{channel.group_name}/{channel.name}"
        if len(channel):
            stamps = _stamps(builder, name, channel, zero) if _is_waveform(channel) else None
            unit = channel.properties.get(
                "unit_string", channel.properties.get("NI_UnitDescription", "")
            )
            builder.add(name, channel[:], stamps, str(unit))
        else:
            builder.leave_out(name, "empty")


def _channels(file: Any) -> list[Any]:
    return [channel for group in file.groups() for channel in group.channels()]


def _is_waveform(channel: Any) -> bool:
    increment = channel.properties.get("wf_increment", 0)
    return isinstance(increment, int | float | np.number) and bool(increment > 0)


def _stamps(builder: ChannelBuilder, name: str, channel: Any, zero: Any) -> Any:
    properties = channel.properties
    offset = float(properties.get("wf_start_offset", 0.0))
    start = properties.get("wf_start_time")
    if zero is not None and isinstance(start, np.datetime64):
        offset += float((start - zero) / np.timedelta64(1, "ns")) / 1e9
        builder.note(f"stamps: increment and start of each waveform, in s since {zero}")
    elif zero is not None:
        builder.note(f"{name} has no start time: its stamps count from its beginning")
    else:
        builder.note("stamps: increment of each waveform, without start time")
    return offset + np.arange(len(channel)) * float(properties["wf_increment"])


KIND = Kind("tdms", (".tdms",), read_tdms, (b"TDSm",), "tdms", ("nptdms",))
