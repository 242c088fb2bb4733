"""What a reader of raw logs hands on: channels, each with its unit and, where the log has them, its
own stamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError, listed, nearest
from pamid.base.metrics import FloatArray

ANY = "*"  # stands in a name for the part of a log that a channel is in


@dataclass(frozen=True)
class RobotValue:
    """What the log of a robot says itself that a channel is.

    group     the topic, or the column of vectors, that it is a part of
    element   joint or motor by the log's name, "" where only the order tells
    place, size  in the vector: from 0, and of how many
    quantity  position, velocity or effort, "" where it is not said
    sent      a command, not a measurement
    si        in rad, m, rad/s, m/s, N m or N, as the format demands
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
    """One signal as the log has it. values (n,) float64, NaN where the log has none; stamps (n,) s
    of its own, or None where it shares the log's rows; unit as the log writes it, "" if it says
    none; robot: of a robot's log, what it is there."""

    name: str  # groups joined by "/"
    values: FloatArray
    stamps: FloatArray | None = None
    unit: str = ""
    robot: RobotValue | None = None


@dataclass(frozen=True, eq=False)
class Log:
    """What a reader found. details: what it decided, in words (encoding, delimiter, header lines,
    which stamps). part: which of several recordings in the file it is, "" for all of it."""

    path: Path
    kind: str  # "csv", "mat", "tdms", "mdf", "ros", "parquet", "hdf5", ...
    channels: tuple[Channel, ...]
    details: tuple[str, ...] = ()
    part: str = ""

    def channel(self, name: str) -> Channel:
        """The channel `name`; FileError with the nearest name if there is none."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        names = [channel.name for channel in self.channels]
        hint = nearest(name, names) or f"Its channels are: {listed(names)}."
        raise FileError(f"{self.path}: there is no channel {name!r}.", hint, code="missing-channel")
