"""Match of channels, or of recorded columns, to the columns of a rig: a score from 0 to 1.

    name    joint, motor or sensor: equal, of the same words (Shoulder-Pan, shoulder_pan), equal
            without words like "joint", or the end of a longer name (panda_joint1, joint1)
    place   index in a vector of a simulator that is as long as the model's
    words   quantity and part of the machine, in several languages
    unit    quantity, of a channel whose name has no such word

The best evidence counts. A contradiction of number, unit or direction (command, reading) excludes a
pair. A measured effort stands for a motor's command where the model gives the factor.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

from pamid.base.errors import FileError, listed, nearest
from pamid.base.units import NONE, Dimension, quantity_of, split_column, unit
from pamid.intake.logs.channel_words import (
    JOINT_QUANTITIES,
    is_generic,
    meanings,
    names_command,
    number,
    plain_words,
    tokens,
)
from pamid.intake.logs.channels import Channel, Log, RobotValue
from pamid.intake.logs.source_units import is_readable, read_unit
from pamid.model.rig import LogName, Rig
from pamid.recording.recording import Recording, match_column

Words = tuple[str, ...]
Candidate = TypeVar("Candidate", bound=Hashable)

SAME_NAME, SHARED_WORD, SAME_MEANING, SAME_UNIT = 1.0, 0.7, 0.5, 0.3
UNSCALED = 0.4  # reduction for the raw signal of a sensor or an amplifier
DRIVEN = 0.25  # command of a drive, for the quantity that the drive applies
SET_POINT = 0.45  # set-point of a drive, for the quantity that the drive produces
#: scores of names of joints, in per cent: whole numbers, since equal ones are an error
WHOLE_ALIKE, WORDS_ALIKE, PLAIN_ALIKE, SAME_PLACE, ENDING_ALIKE = 95, 90, 80, 70, 60
_AS_EFFORT = 40  # reduction for a measured effort in place of a command
_NO_QUANTITY = 5  # reduction if the log does not state the quantity

RAW = (unit("V").dimension, unit("A").dimension)
RATIO = unit(NONE).dimension
APPLIED = ("voltage", "current", "power", "force", "torque")
_QUANTITY_OF = {
    unit(symbol).dimension: quantity
    for quantity, symbols in (
        ("position", ("rad", "m")),
        ("velocity", ("rad/s", "m/s")),
        ("effort", ("N m", "N")),
    )
    for symbol in symbols
}
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


class ColumnFit(NamedTuple):
    """Fit of a channel to a column.

    score    from 0 to 1
    by       strongest evidence: "name", "number" of a joint, "place", "word" or "unit"
    scaled   whether a gain is needed
    why      explanation, if the names differ
    scale    column's unit per unit of the channel, if the model gives it
    si       whether the format of the log prescribes SI units
    """

    score: float
    by: str
    scaled: bool = False
    why: str = ""
    scale: float | None = None
    si: bool = False


NO_FIT = ColumnFit(0.0, "")


def match_channels(
    channels: Sequence[Channel], rig: Rig, log: Log
) -> dict[str, tuple[Channel, ColumnFit]]:
    """Column of the rig -> channel and its fit, best fits first, in the rig's order.

    Raises FileError (code "ambiguous") if the name of a joint fits two channels equally well, as
    with two robots in a log.
    """
    fits = channel_fits(channels, rig)
    joints = {pair: fit.score for pair, fit in fits.items() if fit.by in ("name", "place")}
    for column in dict.fromkeys(column for column, _ in fits):
        named = {i: score for (c, i), score in joints.items() if c == column}
        best = [i for i, score in named.items() if score == max(named.values())]
        if len(best) > 1:
            shown = " and ".join(repr(channels[i].name) for i in best[:4])
            first, second = (channels[i].name for i in best[:2])
            parts = [part for part in re.split(r"[/_.]", first) if part and part not in second]
            raise FileError(
                f"{log.path}: {shown} fit {column} equally well; the log may have several robots.",
                f"Choose among them: --only {parts[0] if parts else first}",
                code="ambiguous",
            )
    pairs = best_pairs(fits)
    return {
        column: (channels[pairs[column]], fits[column, pairs[column]])
        for column in _columns(rig)
        if column in pairs
    }


def with_stand_ins(recording: Recording, rig: Rig) -> tuple[Recording, list[str]]:
    """Recording with other columns as the inputs that it lacks, and a sentence about each.

    A column is only taken where the model gives the factor: a torque for the command of its motor.
    """
    lacking = [c for c in rig.inputs if c not in rig.optional and not recording.has(c)]
    if not lacking or not rig.log_names:
        return recording, []
    used = {match_column(recording.columns, column) for column in _columns(rig)}
    free = [Channel(n, values) for n, values in recording.columns.items() if n not in used]
    fits = {
        (column, i): fit
        for (column, i), fit in channel_fits(free, rig).items()
        if column in lacking and fit.scale is not None
    }
    pairs = best_pairs(fits)
    stand_ins = {free[i].name: (column, fits[column, i]) for column, i in pairs.items()}
    columns = {}
    for name, values in recording.columns.items():
        column, fit = stand_ins.get(name, (name, NO_FIT))
        columns[column] = values if fit.scale is None else values * fit.scale
    notes = [f"{name} is taken as {column}: {fit.why}" for name, (column, fit) in stand_ins.items()]
    return replace(recording, columns=columns), notes


def channel_fits(channels: Sequence[Channel], rig: Rig) -> dict[tuple[str, int], ColumnFit]:
    """Fits of columns and channels (by index), without pairs that do not fit."""
    names, roles, fits = log_names(rig), robot_values(channels), {}
    for i, channel in enumerate(channels):
        stem, symbol = split_column(channel.name.rpartition("/")[2])
        text = channel.unit if channel.unit and is_readable(channel.unit) else symbol
        source = read_unit(text) if text != NONE else None
        dimension = source.dimension if source is not None else None
        role = roles.get(i)
        # column names of other rigs are not names of joints
        joint = role if rig.log_names or channel.robot is not None else None
        # a name that only has a quantity and a number: "torque_1"
        numbered = (
            role is not None
            and channel.robot is None
            and all(
                word.isdigit() or word in JOINT_QUANTITIES
                for word in tokens(role.element) or ("?",)
            )
        )
        for column in sorted(_columns(rig), key=rig.optional.__contains__):
            sent = column in rig.inputs and column not in rig.optional
            fit = words_fit(stem, dimension, column, sent, percent=True)
            if rig.log_names and role is not None and not numbered and fit.score < SAME_NAME:
                fit = NO_FIT  # names of joints identify a column better than words
            if joint is not None and column in names:
                named = _joint_fit(joint, names[column], rig.vector_sizes, dimension)
                if named.scale is not None and source is not None:
                    named = named._replace(scale=named.scale * source.factor)
                if named.score and numbered:
                    named = named._replace(by="number")
                fit = named._replace(score=max(named.score, fit.score)) if named.score else fit
            if fit.score > 0.0:
                fits[column, i] = fit
    return fits


def best_pairs(fits: Mapping[tuple[str, Candidate], ColumnFit]) -> dict[str, Candidate]:
    """Column of the rig -> candidate, each at most once. The best fits are assigned first; of equal
    fits the first candidate."""
    pairs: dict[str, Candidate] = {}
    for (column, given), fit in sorted(fits.items(), key=lambda pair: -pair[1].score):
        if fit.score > 0.0 and column not in pairs and given not in pairs.values():
            pairs[column] = given
    return pairs


def recorded_fit(name: str, wanted: str, sent: bool = False) -> ColumnFit:
    """Fit of a recorded column to a column of a rig, by words and units."""
    stem, symbol = split_column(name)
    return words_fit(stem, unit(symbol).dimension, wanted, sent, symbol != NONE)


def _columns(rig: Rig) -> list[str]:
    return list(dict.fromkeys([*(loop.reference for loop in rig.loops), *rig.inputs, *rig.outputs]))


# ---- words and units ---------------------------------------------------------------------------


def words_fit(
    stem: str, dimension: Dimension | None, wanted: str, sent: bool = False, percent: bool = False
) -> ColumnFit:
    """Fit of a channel called `stem` to a column of a rig.

    dimension: None if unknown; percent: whether its unit is a ratio; sent: whether the column is a
    required input, which a drive applies.
    """
    fit = _quantity_fit(stem, dimension, wanted)
    if not sent:
        return fit
    wanted_stem, wanted_symbol = split_column(wanted)
    drive, words = NO_FIT, meanings(stem)
    if dimension == RATIO and quantity_of(wanted_symbol) in APPLIED:
        # a command without a unit, or in percent: a drive, a heater or an amplifier is a gain
        called = "command" in words or plain_words(stem) & plain_words(wanted_stem)
        if called or percent:
            drive = ColumnFit(DRIVEN, "word" if called else "unit", True)
    elif wanted_symbol != NONE and dimension == unit(wanted_symbol).dimension:
        drive = ColumnFit(SET_POINT, "word") if "reference" in words else drive
    electric = dimension in RAW and words & {"voltage", "current"}
    if electric and meanings(wanted_stem) & {"force", "torque"}:
        drive = max(drive, ColumnFit(DRIVEN, "word", True))
    return max(fit, drive)


def _quantity_fit(stem: str, dimension: Dimension | None, wanted: str) -> ColumnFit:
    wanted_stem, wanted_symbol = split_column(wanted)
    same = dimension in (None, unit(wanted_symbol).dimension)
    if not same and (dimension not in RAW or wanted_symbol == NONE):
        return NO_FIT
    given, wanted_number = number(stem), number(wanted_stem)
    if given and wanted_number and given != wanted_number:
        return NO_FIT
    recorded, sought = meanings(stem), meanings(wanted_stem)
    if ("reference" in recorded) != ("reference" in sought):
        return NO_FIT
    shared, score, by = recorded & sought, 0.0, ""
    if stem == wanted_stem:
        score, by = SAME_NAME, "name"
    elif dimension is None and recorded and sought and not shared:
        return NO_FIT  # without a unit, the speed of a shoulder must not become its angle
    elif plain_words(stem) & plain_words(wanted_stem):
        score, by = SHARED_WORD, "word"
    elif shared:
        if not same and shared == {"reference"}:
            return NO_FIT  # set-points of different quantities: a goal current is not an angle
        score, by = SAME_MEANING, "word"
    elif dimension is not None and same and wanted_symbol != NONE:
        score, by = SAME_UNIT, "unit"
    return ColumnFit(score if same else max(score - UNSCALED, 0.0), by, not same)


# ---- names of joints, and places in vectors ----------------------------------------------------


def log_names(rig: Rig) -> dict[str, LogName]:
    """Names of the rig's columns in a robot's log, as declared by the rig, or from the columns."""
    if rig.log_names:
        return dict(rig.log_names)
    names = {}
    for column in (*rig.inputs, *rig.outputs):
        stem, symbol = split_column(column)
        words = [w for w in tokens(stem) if w not in JOINT_QUANTITIES and not names_command(w)]
        quantity = _QUANTITY_OF.get(unit(symbol).dimension, "")
        names[column] = LogName(("_".join(words) or stem,), quantity, sent=column in rig.inputs)
    return names


def robot_values(channels: Sequence[Channel]) -> dict[int, RobotValue]:
    """Roles of channels in a robot's log, as the log states them, or by their names."""
    vectors: dict[str, list[tuple[int, int]]] = {}
    roles: dict[int, RobotValue] = {}
    for i, channel in enumerate(channels):
        numbered = _NUMBERED.fullmatch(channel.name)
        if channel.robot is not None:
            roles[i] = channel.robot
        elif match := _ELEMENT.fullmatch(channel.name):
            vectors.setdefault((match[1] or "") + match[2], []).append((i, int(match[3] or 0)))
        elif numbered and names_command(numbered[1].rpartition("/")[2]):
            vectors.setdefault(numbered[1], []).append((i, int(numbered[2])))
        elif role := _role_by_words(channel.name):
            roles[i] = role
    for group, members in vectors.items():
        vector = _vector_of(group)
        quantity, sent = _VECTORS.get(vector, ("", True))
        places = [place for _, place in members]
        first = min(*places, 1)
        for i, place in members:
            size = max(places) - first + 1
            roles[i] = RobotValue(group, "", place - first, size, quantity, sent, bool(vector))
    return roles


def _vector_of(group: str) -> str:
    return next((word for word in _VECTORS if group.endswith(word)), "")


def _role_by_words(name: str) -> RobotValue | None:
    """Role by a plain name: "shoulder_pos", "elbow command", "torque_1"."""
    group, _, last = name.rpartition("/")
    words = [w for w in tokens(split_column(last)[0]) if not names_command(w)]
    rest = [word for word in words if word not in JOINT_QUANTITIES]
    quantity = next((JOINT_QUANTITIES[word] for word in words if word in JOINT_QUANTITIES), "")
    if all(word.isdigit() for word in rest):
        if not rest or not quantity:
            return None
        rest = words
    return RobotValue(group, "_".join(rest), 0, 1, quantity, names_command(last))


def _joint_fit(
    value: RobotValue, name: LogName, sizes: Mapping[str, int], dimension: Dimension | None
) -> ColumnFit:
    """Fit of a role to a column. dimension: of the channel's unit, None if unknown."""
    in_effort = _QUANTITY_OF.get(dimension) == "effort" if dimension is not None else value.si
    effort = value.quantity == "effort" and not value.sent and name.sent
    if effort and (name.per_effort is None or dimension is not None and not in_effort):
        return NO_FIT
    # a name may belong to a command even without a word for commands
    sent = value.sent == name.sent or (name.sent and not value.quantity and not value.group)
    same_kind = not value.quantity or not name.quantity or value.quantity == name.quantity
    if not effort and not (sent and same_kind):
        return NO_FIT
    if value.element:
        by, (score, why) = "name", _by_name(value.element, name.names)
    else:
        # index in a vector of the same length as the model's
        vector = _vector_of(value.group) or ("ctrl" if value.sent else "qpos")
        same = (sizes.get(vector), name.places.get(vector)) == (value.size, value.place)
        by, score, why = "place", SAME_PLACE * same, f"by its place in the model's {vector}"
    if not score:
        return NO_FIT
    score -= _NO_QUANTITY if not value.quantity and value.element else 0
    if value.quantity != "effort" or not name.sent or name.per_effort is None:
        # prefer the unfiltered topic joint_states
        score += value.group.rpartition("/")[2] == "joint_states"
    elif effort or in_effort:
        reason = f"{1.0 / name.per_effort:.6g} of effort per unit of the command, by the model"
        why, score = "; ".join(filter(None, (why, reason))), score - (_AS_EFFORT if effort else 0)
        return ColumnFit(score / 100.0, by, True, why, name.per_effort)
    return ColumnFit(score / 100.0, by, why=why, si=value.si)


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
    """Whether the words of a name are the last words of another name; a number alone does not
    count."""
    short, long = sorted((a, b), key=len)
    matches = len(short) < len(long) and not all(word.isdigit() for word in short)
    return matches and long[-len(short) :] == short


def _plain(words: Words) -> Words:
    return tuple(word for word in words if not is_generic(word)) or words


# ---- what does not fit ---------------------------------------------------------------------------


def refuse_foreign_joints(log: Log, channels: Sequence[Channel], rig: Rig) -> None:
    """Raise FileError (code "joints"), because the log has no joint of this rig."""
    logged = _elements(robot_values(channels)) or [channel.name for channel in channels]
    modelled = list(dict.fromkeys(name.names[-1] for name in log_names(rig).values()))
    raise FileError(
        f"{log.path}: none of its names is in the model {rig.name!r}: the log has "
        f"{listed(logged) or 'none'}, the model {listed(modelled) or 'none'}.",
        _nearest_pairs(modelled, logged)
        or "Check that it is the model of this robot, or write the mapping by hand.",
        code="joints",
    )


def notes_on(channels: Sequence[Channel], rig: Rig, chosen: Mapping[str, Channel]) -> list[str]:
    """Sentences about columns without a channel, and joints of the log without a column."""
    of_robot = any(channel.robot for channel in channels)
    if not rig.log_names and not of_robot:
        return []
    values, notes, used = robot_values(channels), [], {id(channel) for channel in chosen.values()}
    mapped = {value.element for i, value in values.items() if id(channels[i]) in used}
    free = [element for element in _elements(values) if element not in mapped]
    for column, name in log_names(rig).items():
        if column in chosen:
            continue
        what = f"{name.quantity or 'value'}{' sent to' if name.sent else ' of'} {name.names[-1]}"
        needed = column in rig.inputs and column not in rig.optional
        note = f"no channel found for {column} ({what})"
        note += ", which a recording needs." if needed else "."
        # a command of another quantity than the model's
        other = (
            f"{value.group} sends a {value.quantity} to {value.element}, but the model "
            f"commands the {name.quantity} of {name.names[0]}."
            for value in values.values()
            if value.quantity
            and name.quantity
            and value.quantity != name.quantity
            and value.sent
            and name.sent
            and _by_name(value.element, name.names)[0]
        )
        hint = next(other, "") or _nearest_pairs(name.names, free)
        notes.append(f"{note} {hint}".rstrip())
    if free and of_robot:
        notes.append(f"in the log, not in the model: {listed(free)}.")
    return notes


def _elements(values: Mapping[int, RobotValue]) -> list[str]:
    return list(dict.fromkeys(value.element for value in values.values() if value.element))


def _nearest_pairs(modelled: Iterable[str], logged: Sequence[str]) -> str:
    """Names in the log that share a word with those of the model, or have a similar spelling."""
    pairs = []
    for name in modelled:
        words = set(_plain(tokens(name)))
        near = next((other for other in logged if words & set(_plain(tokens(other)))), None)
        hint = nearest(name, logged)
        near = near or next((other for other in logged if repr(other) in hint), None)
        pairs += [f"{near!r} for {name!r}"] if near else []
    return f"Nearest: {', '.join(pairs[:6])}." if pairs else ""
