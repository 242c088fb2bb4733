"""ROS 1 bags, ROS 2 bags (folder, sqlite or MCAP): every number in every message, stamped when it
was measured.

Stamps are those of the message's header; the time at which the recorder got it, which jitters, is
used only where there is no header, with a note. Arrays with a value per joint (JointState and its
like) become a channel per joint, whatever their order in a message; a joint that is not in every
message has the stamps of those that it is in.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.intake.logs.channel_builder import MAX_COLUMNS, ChannelBuilder, Kind
from pamid.intake.logs.channel_words import names_command
from pamid.intake.logs.channels import RobotValue

#: header and recorder further apart than this, in s, do not tell the same time
CLOCKS_APART = 60.0
#: fields of sensor_msgs, trajectory_msgs and control_msgs with a value per joint
_PER_JOINT = {
    "position": "position",
    "positions": "position",
    "velocity": "velocity",
    "velocities": "velocity",
    "effort": "effort",
    "efforts": "effort",
}
#: parts of a controller's state that hold such fields -> are they commands?
_CONTROLLER_PARTS = {
    "desired": True,
    "reference": True,
    "output": True,
    "actual": False,
    "feedback": False,
}
#: memory in sizes of a float64: two stamps of a message; a number, its place and their channel
MESSAGE_FLOATS, NUMBER_FLOATS = 12, 4
_NAMES = ("name", "names", "joint_names")


@dataclass
class _Topic:
    """Messages of a topic.

    count   messages
    values  numbers by the path of their field, and in `places` which messages have it
    """

    count: int = 0
    values: dict[str, array[float]] = field(default_factory=dict)
    places: dict[str, array[int]] = field(default_factory=dict)
    # stamps in ns: of the header, fewer than messages if there is none; of the recorder
    measured: list[int] = field(default_factory=list)
    received: list[int] = field(default_factory=list)
    robot: dict[str, RobotValue] = field(default_factory=dict)

    def append(self, row: dict[str, float]) -> None:
        """Enter the numbers of the next message by the path of their field."""
        for path, value in row.items():
            self.values.setdefault(path, array("d")).append(value)
            self.places.setdefault(path, array("q")).append(self.count)
        self.count += 1

    @property
    def stamped(self) -> bool:
        return len(self.measured) == self.count and any(self.measured)

    @property
    def stamps(self) -> list[int]:
        return self.measured if self.stamped else self.received


def read_ros(builder: ChannelBuilder) -> None:
    """Channels "topic/field/field", elements of arrays by the names the message gives them
    (JointState) or numbered from 1; stamps in s since the earliest of all topics."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    topics: dict[str, _Topic] = {}
    with AnyReader([builder.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        known = [
            connection
            for connection in reader.connections
            if connection.msgtype in reader.typestore.types
        ]
        for connection in reader.connections:
            if connection not in known:
                builder.leave_out(
                    connection.topic, f"its type {connection.msgtype} is not described in the bag"
                )
        for connection, received, data in reader.messages(known) if known else ():
            message = reader.deserialize(data, connection.msgtype)
            topic = topics.setdefault(connection.topic, _Topic())
            flat = _Flat(builder, connection.topic, topic.robot)
            flat.enter(message, connection.topic)
            floats = MESSAGE_FLOATS + NUMBER_FLOATS * len(flat.row)
            builder.budget.charge(connection.topic, floats)
            topic.append(flat.row)
            topic.received.append(received)
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            if stamp is not None:
                topic.measured.append(int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec))
    if topics:
        zero = min(min(topic.stamps) for topic in topics.values())
        builder.note(f"stamps: in s since {np.datetime64(zero, 'ns')}")
        for name, topic in topics.items():
            _enter(builder, name, topic, zero)


def _enter(builder: ChannelBuilder, name: str, topic: _Topic, zero: int) -> None:
    if topic.stamped:
        difference_s = abs(topic.measured[0] - topic.received[0]) / 1e9
        if difference_s > CLOCKS_APART:
            builder.note(
                f"{name}: its header differs by {difference_s:.0f} s from the clock of the recorder"
            )
    else:
        builder.note(f"{name} has no header: its stamps are times of recording, not of measurement")
    stamps: Array = np.array([stamp - zero for stamp in topic.stamps], dtype=np.float64) / 1e9
    partly: dict[int, list[str]] = {}
    shared: dict[bytes, Array] = {}  # two nodes may send their joints under the same topic
    for path, numbers in topic.values.items():
        places = np.frombuffer(topic.places[path], dtype=np.int64)
        used_stamps = shared.setdefault(places.tobytes(), stamps[places])
        partly.setdefault(used_stamps.size, []).append(path)
        builder.add(path, np.array(numbers), used_stamps, robot=topic.robot.get(path))
    for count, paths in partly.items():
        if count < stamps.size:
            builder.note(f"in {count} of {stamps.size} messages: {', '.join(paths)}")


@dataclass
class _Flat:
    """The numbers of a message by the path of their field, and what they are to a robot."""

    builder: ChannelBuilder
    topic: str
    robot: dict[str, RobotValue]
    row: dict[str, float] = field(default_factory=dict)

    def enter(self, value: Any, path: str, names: list[str] | None = None) -> None:
        """Enter the numbers in `value`. names: of the joints, as what it lies in gives them."""
        if isinstance(value, bool | int | float | np.number):
            self.row[path] = float(value)
        elif is_dataclass(value):
            names_of_fields = (part.name for part in fields(value))
            parts = {n: getattr(value, n) for n in names_of_fields if not n.startswith("__")}
            parts.pop("header", None)
            for word in _NAMES:
                if isinstance(parts.get(word), list):
                    names = parts.pop(word)
                    if not all(isinstance(name, str) for name in names):
                        names = None
                    elif len(set(names)) < len(names):
                        self.builder.leave_out(path, "messages that name a joint twice")
                        names = []
            for word, inside in parts.items():
                self._field(inside, path, word, names)
        else:
            self.builder.leave_out(path, "text")

    def _field(self, value: Any, path: str, word: str, names: list[str] | None) -> None:
        inside = f"{path}/{word}"
        count = len(value) if isinstance(value, list | np.ndarray) else None
        if count is None:
            self.enter(value, inside, names)
        elif count > MAX_COLUMNS:
            self.builder.leave_out(inside, f"more than {MAX_COLUMNS} elements")
        elif names is not None and len(names) == count:
            part = path.removeprefix(self.topic).strip("/")
            of_robot = word in _PER_JOINT and (not part or part in _CONTROLLER_PARTS)
            for index, name in enumerate(names):
                element = f"{inside}/{name}"
                self.enter(value[index], element, names)
                if of_robot and element not in self.robot:
                    topic = self.topic.rpartition("/")[2]
                    sent = _CONTROLLER_PARTS.get(part, names_command(topic))
                    role = RobotValue(path, name, index, count, _PER_JOINT[word], sent, si=True)
                    self.robot[element] = role
        elif names and word in _PER_JOINT:
            if count:
                self.builder.leave_out(
                    inside, "messages with different numbers of values and names"
                )
        elif names != []:
            for index in range(count):
                self.enter(value[index], f"{inside}/{index + 1}", names)


KIND = Kind(
    "ros",
    (".bag", ".db3", ".mcap"),
    read_ros,
    (b"#ROSBAG V2.0", b"SQLite format 3\0", b"\x89MCAP0\r\n"),
    "ros",
    ("rosbags",),
)
