"""ROS 1 bags, ROS 2 bags (folder, sqlite or MCAP): every number in every message, stamped when it
was measured.

Stamps are those of the message's header; the time at which the recorder got it, which jitters, is
used only where there is no header, and said.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.metrics import FloatArray
from pamid.ingest.channels import Log
from pamid.ingest.gathering import MAX_COLUMNS, Gathering
from pamid.ingest.log_kinds import Kind

#: header and recorder further apart than this, in s, do not tell the same time
CLOCKS_APART = 60.0


@dataclass
class _Topic:
    """Messages of one topic: numbers by the path of their field, and both stamps, ns."""

    rows: list[dict[str, float]] = field(default_factory=list)
    # of the header; fewer than rows where there is none
    measured: list[int] = field(default_factory=list)
    received: list[int] = field(default_factory=list)

    @property
    def stamped(self) -> bool:
        return len(self.measured) == len(self.rows) and any(self.measured)

    @property
    def stamps(self) -> list[int]:
        return self.measured if self.stamped else self.received


def read_ros(path: Path) -> Log:
    """Channels "topic/field/field", elements of arrays by the names the message gives them
    (JointState) or numbered from 1; stamps in s since the earliest of all topics."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    gathering = Gathering()
    topics: dict[str, _Topic] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        known = [
            connection
            for connection in reader.connections
            if connection.msgtype in reader.typestore.types
        ]
        for connection in reader.connections:
            if connection not in known:
                gathering.leave_out(
                    connection.topic, f"its type {connection.msgtype} is not described in the bag"
                )
        for connection, received, data in reader.messages(known) if known else ():
            message = reader.deserialize(data, connection.msgtype)
            topic = topics.setdefault(connection.topic, _Topic())
            row: dict[str, float] = {}
            _flatten(gathering, message, connection.topic, row)
            topic.rows.append(row)
            topic.received.append(received)
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            if stamp is not None:
                topic.measured.append(int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec))
    if topics:
        zero = min(min(topic.stamps) for topic in topics.values())
        gathering.note(f"stamps: in s since {np.datetime64(zero, 'ns')}")
        for name, topic in topics.items():
            _enter(gathering, name, topic, zero)
    return gathering.log(path, "ros")


def _enter(gathering: Gathering, name: str, topic: _Topic, zero: int) -> None:
    if topic.stamped:
        difference_s = abs(topic.measured[0] - topic.received[0]) / 1e9
        if difference_s > CLOCKS_APART:
            gathering.note(
                f"{name}: its header is {difference_s:.0f} s away from the clock of the recorder"
            )
    else:
        gathering.note(
            f"{name} has no header: its stamps tell when it was recorded, not when it was measured"
        )
    stamps: FloatArray = np.array([stamp - zero for stamp in topic.stamps], dtype=np.float64) / 1e9
    for path in dict.fromkeys(path for row in topic.rows for path in row):
        gathering.add(path, np.array([row.get(path, np.nan) for row in topic.rows]), stamps)


def _flatten(gathering: Gathering, value: Any, path: str, row: dict[str, float]) -> None:
    """Numbers in `value`, by path, into `row`."""
    if isinstance(value, bool | int | float | np.number):
        row[path] = float(value)
    elif is_dataclass(value):
        names = getattr(value, "name", None)
        for part in fields(value):
            if part.name == "header":
                continue
            inside = getattr(value, part.name)
            if inside is names:
                continue
            labels = names if isinstance(names, list) and _length(inside) == len(names) else None
            _flatten_field(gathering, inside, f"{path}/{part.name}", row, labels)
    else:
        gathering.leave_out(path, "text")


def _flatten_field(
    gathering: Gathering, value: Any, path: str, row: dict[str, float], labels: list[str] | None
) -> None:
    count = _length(value)
    if count is None:
        _flatten(gathering, value, path, row)
    elif count > MAX_COLUMNS:
        gathering.leave_out(path, f"more than {MAX_COLUMNS} elements")
    else:
        for index in range(count):
            _flatten(
                gathering, value[index], f"{path}/{labels[index] if labels else index + 1}", row
            )


def _length(value: Any) -> int | None:
    """Elements of an array or list; None for anything else."""
    return len(value) if isinstance(value, list | np.ndarray) else None


KIND = Kind(
    "ros",
    (".bag", ".db3", ".mcap"),
    read_ros,
    (b"#ROSBAG V2.0", b"SQLite format 3\0", b"\x89MCAP0\r\n"),
    "ros",
    ("rosbags",),
)
