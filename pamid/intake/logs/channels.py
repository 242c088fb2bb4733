"""Output of a log reader: channels with their units and time stamps, as far as the log has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError, listed, nearest
from pamid.intake.logs.stated_period import StatedPeriod
from pamid.recording.recording import MIN_SAMPLES

MOST_ROWS = 0.9  # largest share of rows of an interleaved channel
ANY = "*"  # in a name: the part of a log that a channel belongs to


@dataclass(frozen=True)
class RobotValue:
    """Role of a channel in a robot's log.

    group     topic or column of vectors that contains it
    element   joint or motor by the log's name, "" if only the order identifies it
    place, size  index in the vector, from 0, and length of the vector
    quantity  position, velocity or effort, "" if the log does not state it
    sent      whether it is a command, not a measurement
    si        whether the format prescribes rad, m, rad/s, m/s, N m or N
    """

    group: str
    element: str
    place: int
    size: int
    quantity: str = ""
    sent: bool = False
    si: bool = False


@dataclass(frozen=True, eq=False)
class Channel:
    """A signal of a log.

    values  (n,) float64, NaN for missing values
    stamps  (n,) s, or None if the channel shares the log's rows
    unit    as the log writes it, "" if it states none
    robot   role of the channel in a robot's log
    """

    name: str  # groups joined by "/"
    values: Array
    stamps: Array | None = None
    unit: str = ""
    robot: RobotValue | None = None

    @property
    def finite(self) -> Array:
        return self.values[np.isfinite(self.values)]


def interleaved_rows(channels: Sequence[Channel]) -> dict[str, NDArray[np.bool_]]:
    """Row masks of interleaved channels: each message of a bus has a separate row of the table,
    with empty cells for the other messages."""
    masks: dict[bytes, NDArray[np.bool_]] = {}
    members: dict[bytes, list[str]] = {}
    for channel in channels:
        there = np.isfinite(channel.values)
        if channel.stamps is None and MIN_SAMPLES <= there.sum() < MOST_ROWS * there.size:
            masks.setdefault(there.tobytes(), there)
            members.setdefault(there.tobytes(), []).append(channel.name)
    return {
        name: mask
        for key, mask in masks.items()
        if any(
            mask.size == other.size
            and (mask & other).sum() <= (1.0 - MOST_ROWS) * min(mask.sum(), other.sum())
            for other in masks.values()
        )
        for name in members[key]
    }


@dataclass(frozen=True, eq=False)
class Log:
    """Content of a log.

    details  decisions of the reader, in words (encoding, delimiter, header lines, stamps)
    part     name of the recording, if the file has several, "" for the whole file
    stated   sampling period that the text around the numbers states, if any
    """

    path: Path
    kind: str  # "csv", "mat", "tdms", "mdf", "ros", "parquet", "hdf5", ...
    channels: tuple[Channel, ...]
    details: tuple[str, ...] = ()
    part: str = ""
    stated: StatedPeriod | None = None

    def channel(self, name: str, place: str = "The channel") -> Channel:
        """Channel by name; FileError with its place in a mapping, and the nearest name."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        names = [channel.name for channel in self.channels]
        hint = nearest(name, names) or f"Its channels are: {listed(names)}."
        message = f"{place} is {name!r}; {self.path} has no such channel."
        raise FileError(message, hint, code="missing-channel")
