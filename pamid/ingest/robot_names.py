"""Assignment of a robot's channels to the columns of a rig, by the names of joints and motors, and
by their order in the vectors of a simulator.

A name fits if it is equal, has the same words (Shoulder-Pan, shoulder_pan), is equal without words
like "joint", or is the end of a longer one (panda_joint1, joint1). A column that fits two channels
equally well is an error.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pamid.base.errors import FileError, listed, nearest
from pamid.base.units import split_column, unit
from pamid.ingest.channel_words import names_command, tokens
from pamid.ingest.channels import Channel, Log, RobotValue
from pamid.model.log_names import LogName
from pamid.model.rig import Rig

Words = tuple[str, ...]
#: scores of names
WHOLE_ALIKE, WORDS_ALIKE, PLAIN_ALIKE, SAME_PLACE, ENDING_ALIKE = 95, 90, 80, 70, 60
_AS_EFFORT = 40  # reduction for a measured effort in place of a command
_NO_QUANTITY = 5  # reduction if the log does not state the quantity

_GENERIC = frozenset(
    ["joint", "joints", "j", "jnt", "motor", "motors", "servo", "actuator", "act", "axis", "main"]
)
_OF_QUANTITY = {
    "position": ["position", "pos", "angle", "angles", "q", "qpos", "encoder", "enc"],
    "velocity": ["velocity", "vel", "speed", "omega", "qd", "dq", "qvel"],
    "effort": ["effort", "torque", "tau", "force", "moment"],
}
_QUANTITY_WORDS = {word: quantity for quantity, words in _OF_QUANTITY.items() for word in words}
#: vectors of a simulator -> their quantity, and whether they are commands
_VECTORS = {
    "qpos": ("position", False),
    "qvel": ("velocity", False),
    "qfrc_actuator": ("effort", False),
    "actuator_force": ("effort", False),
    "ctrl": ("", True),
    "sensordata": ("", False),
}
_ELEMENT = re.compile(rf"(.*(?:^|[/._ ]))?({'|'.join(_VECTORS)})(?:[/_. \[(]*(\d+)[\])]?)?")
_NUMBERED = re.compile(r"(.+)/data/(\d+)")
_QUANTITY_OF = {
    unit(symbol).dimension: quantity
    for quantity, symbols in (
        ("position", ("rad", "m")),
        ("velocity", ("rad/s", "m/s")),
        ("effort", ("N m", "N")),
    )
    for symbol in symbols
}


@dataclass(frozen=True)
class NameFit:
    """Fit of a channel to a column.

    why     explanation, if the names differ
    scale   column's unit per unit of the channel, if the model gives it
    si      whether the format of the log prescribes SI units
    """

    score: int
    why: str = ""
    scale: float | None = None
    si: bool = False


def fits_by_name(channels: Sequence[Channel], rig: Rig) -> dict[tuple[int, str], NameFit]:
    """Fits of channels (by index) to columns, without those that do not fit."""
    names, values = log_names(rig), robot_values(channels)
    fits = {}
    for i, value in values.items():
        if not rig.log_names and channels[i].robot is None:
            continue  # column names of other rigs are not names of joints
        for column, name in names.items():
            fit = _fit(value, name, rig.vector_sizes)
            if fit is not None:
                fits[i, column] = fit
    return fits


def log_names(rig: Rig) -> dict[str, LogName]:
    """Names of the rig's columns in a robot's log, as declared by the rig, or from the columns."""
    if rig.log_names:
        return dict(rig.log_names)
    names = {}
    for column in (*rig.inputs, *rig.outputs):
        stem, symbol = split_column(column)
        words = [w for w in tokens(stem) if w not in _QUANTITY_WORDS and not names_command(w)]
        quantity = _QUANTITY_OF.get(unit(symbol).dimension, "")
        names[column] = LogName(("_".join(words) or stem,), quantity, sent=column in rig.inputs)
    return names


def robot_values(channels: Sequence[Channel]) -> dict[int, RobotValue]:
    """Roles of channels in a robot's log, as the log states them, or by their names."""
    vectors: dict[str, list[tuple[int, int]]] = {}
    roles: dict[int, RobotValue] = {}
    for i, channel in enumerate(channels):
        if channel.robot is not None:
            roles[i] = channel.robot
        elif element := _place(channel.name):
            vectors.setdefault(element[0], []).append((i, element[1]))
        elif role := _role_by_words(channel.name):
            roles[i] = role
    for group, members in vectors.items():
        kind = re.split(r"[/._ ]", group)[-1] if group not in _VECTORS else group
        kind = next((word for word in _VECTORS if group.endswith(word)), kind)
        quantity, sent = _VECTORS.get(kind, ("", True))
        first = min(place for _, place in members)
        for i, place in members:
            whole = max(p for _, p in members) - min(first, 1) + 1
            roles[i] = RobotValue(
                group, "", place - min(first, 1), whole, quantity, sent, si=kind in _VECTORS
            )
    return roles


def _place(name: str) -> tuple[str, int] | None:
    """(vector, index in the log's counting) of a channel that is an element of a vector."""
    if match := _ELEMENT.fullmatch(name):
        return (match[1] or "") + match[2], int(match[3] or 0)
    numbered = _NUMBERED.fullmatch(name)
    if numbered and names_command(numbered[1].rpartition("/")[2]):
        return numbered[1], int(numbered[2])
    return None


def _role_by_words(name: str) -> RobotValue | None:
    """Role by a plain name: "shoulder_pos", "elbow command"."""
    group, _, last = name.rpartition("/")
    words = tokens(split_column(last)[0])
    rest = [word for word in words if word not in _QUANTITY_WORDS and not names_command(word)]
    if not rest or all(word.isdigit() for word in rest):
        return None
    quantity = next((_QUANTITY_WORDS[word] for word in words if word in _QUANTITY_WORDS), "")
    return RobotValue(group, "_".join(rest), 0, 1, quantity, names_command(last))


# ---- one channel and one column ------------------------------------------------------------------


def _fit(value: RobotValue, name: LogName, sizes: Mapping[str, int]) -> NameFit | None:
    effort = value.quantity == "effort" and not value.sent and name.sent
    if effort and name.per_effort is None:
        return None
    if not effort and not _same_kind(value, name):
        return None
    score, why = (
        _by_name(value.element, name.names) if value.element else _by_place(value, name, sizes)
    )
    if not score:
        return None
    if not value.quantity and value.element:
        score -= _NO_QUANTITY
    if value.quantity == "effort" and name.sent and name.per_effort is not None:
        if not effort and not value.si:
            return NameFit(score, why, si=value.si)
        reason = f"{1.0 / name.per_effort:.6g} of effort per unit of the command, by the model"
        reason = "; ".join(filter(None, (why, reason)))
        return NameFit(score - (_AS_EFFORT if effort else 0), reason, name.per_effort)
    # prefer the unfiltered topic joint_states
    return NameFit(score + (value.group.rpartition("/")[2] == "joint_states"), why, si=value.si)


def _same_kind(value: RobotValue, name: LogName) -> bool:
    # a name may belong to a command even without a word for commands
    sent = value.sent == name.sent or (name.sent and not value.quantity and not value.group)
    return sent and (not value.quantity or not name.quantity or value.quantity == name.quantity)


def _by_name(element: str, names: Iterable[str]) -> tuple[int, str]:
    """Best score of the names; later names score slightly less."""
    best = (0, "")
    for later, name in enumerate(names):
        score = _alike(element, name)
        if score and score - later > best[0]:
            best = (score - later, f"{element} is {name}" if score < WORDS_ALIKE else "")
    return best


def _alike(text: str, other: str) -> int:
    if text == other:
        return WHOLE_ALIKE
    a, b = tokens(text), tokens(other)
    if a == b:
        return WORDS_ALIKE
    plain_a, plain_b = _plain(a), _plain(b)
    if plain_a == plain_b:
        return PLAIN_ALIKE
    return ENDING_ALIKE if _ends(a, b) or _ends(plain_a, plain_b) else 0


def _ends(a: Words, b: Words) -> bool:
    """Whether the words of one name are the last ones of the other; a number alone does not
    count."""
    short, long = sorted((a, b), key=len)
    matches = len(short) < len(long) and not all(word.isdigit() for word in short)
    return matches and long[-len(short) :] == short


def _plain(words: Words) -> Words:
    return tuple(w for w in words if w not in _GENERIC and w not in _QUANTITY_WORDS) or words


def _by_place(value: RobotValue, name: LogName, sizes: Mapping[str, int]) -> tuple[int, str]:
    """Score by the index in a vector of the same length as the model's."""
    vector = next((word for word in _VECTORS if value.group.endswith(word)), "")
    if not vector:
        vector = "ctrl" if value.sent else "qpos"
    if sizes.get(vector) != value.size or name.places.get(vector) != value.place:
        return 0, ""
    return SAME_PLACE, f"by its place in the model's {vector}"


# ---- what does not fit ---------------------------------------------------------------------------


def require_clear(
    fits: Mapping[tuple[int, str], NameFit], channels: Sequence[Channel], log: Log
) -> None:
    """Raise FileError (code "ambiguous") if a column fits two channels equally well, as with two
    robots in one log."""
    for column in dict.fromkeys(column for _, column in fits):
        scores = {i: fit.score for (i, c), fit in fits.items() if c == column}
        best = [i for i, score in scores.items() if score == max(scores.values())]
        if len(best) > 1:
            shown = " and ".join(repr(channels[i].name) for i in best[:4])
            first, second = (channels[i].name for i in best[:2])
            raise FileError(
                f"{log.path}: {shown} fit {column} equally well; the log may have several robots.",
                f"Choose one of them: --only {_distinctive_part(first, second)}",
                code="ambiguous",
            )


def _distinctive_part(text: str, other: str) -> str:
    """First part of a name that the other name does not contain."""
    parts = [part for part in re.split(r"[/_.]", text) if part and part not in other]
    return parts[0] if parts else text


def chosen_by(only: str, channels: Sequence[Channel], log: Log) -> list[Channel]:
    """Channels whose names contain `only`; FileError if there is none."""
    chosen = [channel for channel in channels if only in channel.name]
    if not chosen:
        names = [channel.name for channel in channels]
        words = list(dict.fromkeys(part for name in names for part in name.split("/") if part))
        raise FileError(
            f"{log.path}: no channel name contains {only!r}.",
            nearest(only, words) or f"Its channels are: {', '.join(names[:20])}.",
            code="missing-channel",
        )
    return chosen


def refuse_foreign_joints(log: Log, channels: Sequence[Channel], rig: Rig) -> None:
    """Raise FileError (code "joints"), because the log has no joint of this rig."""
    logged, modelled = _elements(robot_values(channels).values()), _joints(rig)
    if not logged:
        logged = [channel.name for channel in channels]
    raise FileError(
        f"{log.path}: none of its names is in the model {rig.name!r}: the log has "
        f"{listed(logged) or 'none'}, the model {listed(modelled) or 'none'}.",
        _nearest_pairs(modelled, logged)
        or "Check that it is the model of this robot, or write the mapping by hand.",
        code="joints",
    )


def notes_on(channels: Sequence[Channel], rig: Rig, chosen: Mapping[str, Channel]) -> list[str]:
    """Sentences about columns without a channel, and joints of the log without a column."""
    values = robot_values(channels)
    if not rig.log_names and not any(channel.robot for channel in channels):
        return []
    names, notes = log_names(rig), []
    theirs = _elements(values.values())
    elements = {
        values[i].element
        for i, channel in enumerate(channels)
        if i in values and any(channel is other for other in chosen.values())
    }
    free = [name for name in theirs if name not in elements]
    for column in (c for c in names if c not in chosen):
        name = names[column]
        needed = column in rig.inputs and column not in rig.optional
        what = f"{name.quantity or 'value'}{' sent to' if name.sent else ' of'} {name.names[-1]}"
        note = f"no channel found for {column} ({what})"
        note += ", which a recording needs" if needed else ""
        other = _other_quantity(name, values.values())
        hint = other or _nearest_pairs(name.names, free)
        notes.append(f"{note}. {hint}" if hint else f"{note}.")
    foreign = [name for name in free if any(channel.robot for channel in channels)]
    if foreign:
        notes.append(f"in the log, not in the model: {listed(foreign)}.")
    return notes


def _other_quantity(name: LogName, values: Iterable[RobotValue]) -> str:
    """Sentence about a command of another quantity than the model's, or ""."""
    for value in values:
        other = bool(value.quantity and name.quantity) and value.quantity != name.quantity
        if other and value.sent and name.sent and _by_name(value.element, name.names)[0]:
            return (
                f"{value.group} sends a {value.quantity} to {value.element}, but the command of "
                f"the model's {name.names[0]} is {name.quantity}."
            )
    return ""


def _elements(values: Iterable[RobotValue]) -> list[str]:
    return list(dict.fromkeys(value.element for value in values if value.element))


def _joints(rig: Rig) -> list[str]:
    """Joints or other elements of the columns, once each."""
    return list(dict.fromkeys(name.names[-1] for name in log_names(rig).values()))


def _nearest_pairs(modelled: Iterable[str], logged: Sequence[str]) -> str:
    pairs = []
    for name in modelled:
        near = _near(name, logged)
        if near:
            pairs.append(f"{near!r} for {name!r}")
    return f"Nearest: {', '.join(pairs[:6])}." if pairs else ""


def _near(name: str, logged: Sequence[str]) -> str:
    """Name in the log that shares a word with `name`, or has a similar spelling."""
    words = set(_plain(tokens(name)))
    shared = [other for other in logged if words & set(_plain(tokens(other)))]
    if shared:
        return shared[0]
    hint = nearest(name, logged)
    return next((other for other in logged if repr(other) in hint), "")
