"""Output of a log reader: channels, each with its unit and, where the log has them, its time
stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError, listed, nearest
from pamid.base.metrics import FloatArray
from pamid.ingest.stated_period import StatedPeriod
from pamid.recording.recording import MIN_SAMPLES

MOST_ROWS = 0.9  # share of the rows that a channel which has its turn is in, at most
ANY = "*"  # stands in a name for the part of a log that a channel is in


@dataclass(frozen=True)
class RobotValue:
    """Role of a channel as a robot's log states it.

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


def rows_in_turns(channels: Sequence[Channel]) -> dict[str, NDArray[np.bool_]]:
    """The rows, as masks, of channels that take turns in a table: every message of a bus has a row
    of its own, and empty cells for what the others send."""
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
    """Content of a log. details: what it decided, in words (encoding, delimiter, header lines,
    which stamps). part: which of several recordings in the file it is, "" for all of it. stated:
    the sampling period that the text around the numbers states, if it does."""

    path: Path
    kind: str  # "csv", "mat", "tdms", "mdf", "ros", "parquet", "hdf5", ...
    channels: tuple[Channel, ...]
    details: tuple[str, ...] = ()
    part: str = ""
    stated: StatedPeriod | None = None

    def channel(self, name: str) -> Channel:
        """The channel `name`; FileError with the nearest name if there is none."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        names = [channel.name for channel in self.channels]
        hint = nearest(name, names) or f"Its channels are: {listed(names)}."
        raise FileError(f"{self.path}: there is no channel {name!r}.", hint, code="missing-channel")
