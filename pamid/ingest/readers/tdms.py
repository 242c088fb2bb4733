"""TDMS files of LabVIEW. Stamps come from a waveform's increment and start; channels may begin at
different times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pamid.ingest.channels import Log
from pamid.ingest.gathering import Gathering
from pamid.ingest.log_kinds import Kind
from pamid.ingest.memory_budget import FLOAT


def read_tdms(path: Path) -> Log:
    """Channels "group/channel"; with stamps in s since the earliest start where they are
    waveforms."""
    from nptdms import TdmsFile

    gathering = Gathering(path)
    # a segment of a few bytes can declare any number of values: count them before reading any
    for channel in _channels(TdmsFile.read_metadata(path)):
        gathering.reserve(f"{channel.group_name}/{channel.name}", (len(channel),), FLOAT)
        if _is_waveform(channel):
            gathering.budget.charge(f"{channel.group_name}/{channel.name}", len(channel))
    file = TdmsFile.read(path)
    if file.file_status.incomplete_final_segment:
        gathering.note(
            "the last segment is incomplete, as after a crash: what was written of it is read"
        )
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
            stamps = _stamps(gathering, name, channel, zero) if _is_waveform(channel) else None
            unit = channel.properties.get(
                "unit_string", channel.properties.get("NI_UnitDescription", "")
            )
            gathering.add(name, channel[:], stamps, str(unit))
        else:
            gathering.leave_out(name, "empty")
    return gathering.log(path, "tdms")


def _channels(file: Any) -> list[Any]:
    return [channel for group in file.groups() for channel in group.channels()]


def _is_waveform(channel: Any) -> bool:
    increment = channel.properties.get("wf_increment", 0)
    return isinstance(increment, int | float | np.number) and bool(increment > 0)


def _stamps(gathering: Gathering, name: str, channel: Any, zero: Any) -> Any:
    properties = channel.properties
    offset = float(properties.get("wf_start_offset", 0.0))
    start = properties.get("wf_start_time")
    if zero is not None and isinstance(start, np.datetime64):
        offset += float((start - zero) / np.timedelta64(1, "ns")) / 1e9
        gathering.note(f"stamps: increment and start of each waveform, in s since {zero}")
    elif zero is not None:
        gathering.note(
            f"{name} does not say when it starts: its stamps count from its own beginning"
        )
    else:
        gathering.note("stamps: increment of each waveform, none says when it starts")
    return offset + np.arange(len(channel)) * float(properties["wf_increment"])


KIND = Kind("tdms", (".tdms",), read_tdms, (b"TDSm",), "tdms", ("nptdms",))
