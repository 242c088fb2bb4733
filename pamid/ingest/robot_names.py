"""Which channel of a robot's log is which column of a rig: by the names of joints and motors, and
by their order in the vectors of a simulator.

A name fits whole, as the same words (Shoulder-Pan, shoulder_pan), without words like "joint", or as
the end of a longer one (panda_joint1, joint1). What fits two channels equally well is not chosen.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pamid.base.errors import FileError, listed, nearest
from pamid.base.units import split_column, unit
from pamid.ingest.channel_words import says_sent, tokens
from pamid.ingest.channels import Channel, Log, RobotValue
from pamid.model.log_names import LogName
from pamid.model.rig import Rig

Words = tuple[str, ...]
#: how well names fit
WHOLE_ALIKE, WORDS_ALIKE, PLAIN_ALIKE, SAME_PLACE, ENDING_ALIKE = 95, 90, 80, 70, 60
_AS_EFFORT = 40  # taken off where a measured effort stands for what was sent
_UNSAID = 5  # where the log does not say what of a joint it is

_GENERIC = frozenset(
    ["joint", "joints", "j", "jnt", "motor", "motors", "servo", "actuator", "act", "axis", "main"]
)
_OF_QUANTITY = {
    "position": ["position", "pos", "angle", "angles", "q", "qpos", "encoder", "enc"],
    "velocity": ["velocity", "vel", "speed", "omega", "qd", "dq", "qvel"],
    "effort": ["effort", "torque", "tau", "force", "moment"],
}
_MEANT = {word: quantity for quantity, words in _OF_QUANTITY.items() for word in words}
#: vectors of a simulator -> what they hold, and are they sent?
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
    """How well a channel fits a column: score; why, where the name alone does not say it; scale:
    column's unit per unit of the channel, where that follows from the model; si: the channel is in
    SI by the definition of such a log."""

    score: int
    why: str = ""
    scale: float | None = None
    si: bool = False


def fits_by_name(channels: Sequence[Channel], rig: Rig) -> dict[tuple[int, str], NameFit]:
    """How well channels (by number) fit columns, those that fit at all."""
    names, values = log_names(rig), robot_values(channels)
    fits = {}
    for i, value in values.items():
        if not rig.log_names and channels[i].robot is None:
            continue  # what a rig that is no robot calls its columns says nothing of such a log
        for column, name in names.items():
            fit = _fit(value, name, rig.vector_sizes)
            if fit is not None:
                fits[i, column] = fit
    return fits


def log_names(rig: Rig) -> dict[str, LogName]:
    """Names of the rig's columns in a robot's log: as the rig declares them, or by the words of the
    columns."""
    if rig.log_names:
        return dict(rig.log_names)
    names = {}
    for column in (*rig.inputs, *rig.outputs):
        stem, symbol = split_column(column)
        own = [word for word in tokens(stem) if word not in _MEANT and not says_sent(word)]
        quantity = _QUANTITY_OF.get(unit(symbol).dimension, "")
        names[column] = LogName(("_".join(own) or stem,), quantity, sent=column in rig.inputs)
    return names


def robot_values(channels: Sequence[Channel]) -> dict[int, RobotValue]:
    """Roles of channels on a robot: as the log states them, or by their names."""
    vectors: dict[str, list[tuple[int, int]]] = {}
    roles: dict[int, RobotValue] = {}
    for i, channel in enumerate(channels):
        if channel.robot is not None:
            roles[i] = channel.robot
        elif element := _place(channel.name):
            vectors.setdefault(element[0], []).append((i, element[1]))
        elif spoken := _spoken(channel.name):
            roles[i] = spoken
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
    """(vector, number as the log counts) of a channel that is an element of one."""
    if match := _ELEMENT.fullmatch(name):
        return (match[1] or "") + match[2], int(match[3] or 0)
    numbered = _NUMBERED.fullmatch(name)
    if numbered and says_sent(numbered[1].rpartition("/")[2]):
        return numbered[1], int(numbered[2])
    return None


def _spoken(name: str) -> RobotValue | None:
    """Role by a plain name: "shoulder_pos", "elbow command"."""
    group, _, own = name.rpartition("/")
    words = tokens(split_column(own)[0])
    rest = [word for word in words if word not in _MEANT and not says_sent(word)]
    if not rest or all(word.isdigit() for word in rest):
        return None
    quantity = next((_MEANT[word] for word in words if word in _MEANT), "")
    return RobotValue(group, "_".join(rest), 0, 1, quantity, says_sent(own))


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
        score -= _UNSAID
    if value.quantity == "effort" and name.sent and name.per_effort is not None:
        if not effort and not value.si:
            return NameFit(score, why, si=value.si)
        reason = f"{1.0 / name.per_effort:.6g} of effort per unit that is sent, by the model"
        reason = "; ".join(filter(None, (why, reason)))
        return NameFit(score - (_AS_EFFORT if effort else 0), reason, name.per_effort)
    # of a state before and after a filter the plain one
    return NameFit(score + (value.group.rpartition("/")[2] == "joint_states"), why, si=value.si)


def _same_kind(value: RobotValue, name: LogName) -> bool:
    # what only a name says may be a command without a word for it
    sent = value.sent == name.sent or (name.sent and not value.quantity and not value.group)
    return sent and (not value.quantity or not name.quantity or value.quantity == name.quantity)


def _by_name(element: str, names: Iterable[str]) -> tuple[int, str]:
    """The best score of the names, each later one a little less."""
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
    """Are the words of one name the last ones of the other? A number alone says nothing."""
    short, long = sorted((a, b), key=len)
    matches = len(short) < len(long) and not all(word.isdigit() for word in short)
    return matches and long[-len(short) :] == short


def _plain(words: Words) -> Words:
    return tuple(w for w in words if w not in _GENERIC and w not in _MEANT) or words


def _by_place(value: RobotValue, name: LogName, sizes: Mapping[str, int]) -> tuple[int, str]:
    """By the order in a vector that is as long as the model's."""
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
    """FileError (code "ambiguous") where a column fits two channels equally well: two robots in one
    log."""
    for column in dict.fromkeys(column for _, column in fits):
        scores = {i: fit.score for (i, c), fit in fits.items() if c == column}
        best = [i for i, score in scores.items() if score == max(scores.values())]
        if len(best) > 1:
            shown = " and ".join(repr(channels[i].name) for i in best[:4])
            one, other = (channels[i].name for i in best[:2])
            raise FileError(
                f"{log.path}: {shown} may all be {column}: there seems to be more than one robot "
                "in the log.",
                f"Say which one is meant: --only {_apart(one, other)}",
                code="ambiguous",
            )


def _apart(text: str, other: str) -> str:
    """The first part of a name that the other does not have: to tell the two apart."""
    parts = [part for part in re.split(r"[/_.]", text) if part and part not in other]
    return parts[0] if parts else text


def chosen_by(only: str, channels: Sequence[Channel], log: Log) -> list[Channel]:
    """The channels whose names contain `only`; FileError where none does."""
    chosen = [channel for channel in channels if only in channel.name]
    if not chosen:
        names = [channel.name for channel in channels]
        words = list(dict.fromkeys(part for name in names for part in name.split("/") if part))
        raise FileError(
            f"{log.path}: no channel's name contains {only!r}.",
            nearest(only, words) or f"Its channels are: {', '.join(names[:20])}.",
            code="missing-channel",
        )
    return chosen


def refuse_strangers(log: Log, channels: Sequence[Channel], rig: Rig) -> None:
    """FileError (code "joints"): nothing in the log is of this rig."""
    theirs, own = _elements(robot_values(channels).values()), _own(rig)
    if not theirs:
        theirs = [channel.name for channel in channels]
    raise FileError(
        f"{log.path}: none of its names is in the model {rig.name!r}: the log has "
        f"{listed(theirs) or 'none'}, the model {listed(own) or 'none'}.",
        _nearest_pairs(own, theirs)
        or "Is it the model of this robot? Otherwise name the channels in a mapping by hand.",
        code="joints",
    )


def notes_on(channels: Sequence[Channel], rig: Rig, chosen: Mapping[str, Channel]) -> list[str]:
    """Of columns that found no channel, and joints of the log that found no column, a sentence
    each."""
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
        note = f"nothing found for {column} ({what})"
        note += ", which a recording must have" if needed else ""
        other = _other_quantity(name, values.values())
        hint = other or _nearest_pairs(name.names, free)
        notes.append(f"{note}. {hint}" if hint else f"{note}.")
    strangers = [c for c in free if any(channel.robot for channel in channels)]
    if strangers:
        notes.append(f"in the log, not in the model: {listed(strangers)}.")
    return notes


def _other_quantity(name: LogName, values: Iterable[RobotValue]) -> str:
    """A command of another quantity than the one that the model takes."""
    for value in values:
        other = bool(value.quantity and name.quantity) and value.quantity != name.quantity
        if other and value.sent and name.sent and _by_name(value.element, name.names)[0]:
            return (
                f"{value.group} sends a {value.quantity} to {value.element}; what the model's "
                f"{name.names[0]} takes is {name.quantity}."
            )
    return ""


def _elements(values: Iterable[RobotValue]) -> list[str]:
    return list(dict.fromkeys(value.element for value in values if value.element))


def _own(rig: Rig) -> list[str]:
    """Joints, or what else columns belong to, once each."""
    return list(dict.fromkeys(name.names[-1] for name in log_names(rig).values()))


def _nearest_pairs(own: Iterable[str], theirs: Sequence[str]) -> str:
    pairs = []
    for name in own:
        near = _near(name, theirs)
        if near:
            pairs.append(f"{near!r} for {name!r}")
    return f"Nearest: {', '.join(pairs[:6])}." if pairs else ""


def _near(name: str, theirs: Sequence[str]) -> str:
    """The one of theirs that shares a word with the name, or is spelt much like it."""
    words = set(_plain(tokens(name)))
    shared = [other for other in theirs if words & set(_plain(tokens(other)))]
    if shared:
        return shared[0]
    hint = nearest(name, theirs)
    return next((other for other in theirs if repr(other) in hint), "")
