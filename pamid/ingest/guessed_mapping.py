"""A first mapping for a log, with a comment on everything that was guessed, for the user to look
through.

What only the user can know stays open ("?"): a unit that the log does not say, gauge or absolute
pressure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pamid.base.errors import PamidError
from pamid.base.metrics import FloatArray
from pamid.base.units import NONE, quantity_of, split_column, unit
from pamid.ingest.channel_words import meanings, number
from pamid.ingest.channels import Channel, Log
from pamid.ingest.conversion import round_period
from pamid.ingest.mapping import UNANSWERED
from pamid.ingest.own_names import own_columns
from pamid.ingest.robot_names import (
    NameFit,
    chosen_by,
    fits_by_name,
    notes_on,
    refuse_strangers,
    require_clear,
    robot_values,
)
from pamid.ingest.source_units import PRESSURE_DIMENSION, is_readable, read_unit
from pamid.ingest.stamps import Rows, usable_rows
from pamid.ingest.time_base import GAP_PERIODS, StampDiagnosis, diagnose_stamps
from pamid.model.rig import Loop, Rig
from pamid.recording.held_signal import held_by_jumps, moves_in_steps
from pamid.recording.recording import toml_string

WHOLE_NAME = 100  # score of a channel that is called as the column is
PAUSE = 100.0  # times the usual step
EQUAL_TO = 1.05  # what is sent stays within -1 to 1, or is in per cent
BELIEVED_WITHIN = 30.0  # times the rig's period: a unit of the stamps within that is believed
_LIKELY_TIME_UNITS = ("s", "ms", "us", "ns", "min")
_RAW = (unit("V").dimension, unit("A").dimension)  # a sensor's signal that nobody has scaled
_SI = ("rad", "m", "rad/s", "m/s", "N m", "N", NONE)
_TURNING = (unit("rad").dimension, unit("rad/s").dimension)
_RISING = 0.98  # share of steps up: then a channel may be the time


@dataclass(frozen=True)
class GuessedMapping:
    """The text of a mapping, the keys that are left open, how many channels were taken of how many,
    and what to know of those that were not."""

    text: str
    open: tuple[str, ...]
    mapped: int
    channels: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ChosenChannel:
    """A channel that was taken for a column, and how it fits by its robot's names, if it does."""

    channel: Channel
    fit: NameFit | None = None


@dataclass(frozen=True)
class Answers:
    """What the user has said of all channels: pressures are "gauge" or "absolute", angles without a
    unit are in "deg" or "rad"; "" leaves them open."""

    pressures: str = ""
    angles: str = ""


@dataclass(frozen=True, eq=False)
class TimeGuess:
    """The channel with the stamps (None: channels have their own, or there is none), its unit ("?":
    unknown), the stamps in s, and what was found out about them."""

    source: Channel | None
    unit: str
    stamps: FloatArray | None
    reason: str = ""
    found: StampDiagnosis | None = None
    trouble: str = ""


def guess_of(
    log: Log,
    rig_name: str,
    rig: Rig,
    pressures: str | None = None,
    known: Mapping[str, float] | None = None,
    angles: str | None = None,
    only: str = "",
) -> GuessedMapping:
    """A mapping of a log for a rig. pressures: "gauge" or "absolute" for all of them, None leaves
    them open; angles: "deg" or "rad" for all whose unit the log does not say, likewise; only: text
    that the names of the channels to take contain; known: what is known of the rig in these
    recordings.

    FileError where no joint of the log is one of the rig's, or a column may be one of several.
    """
    answers = Answers(pressures or "", angles or "")
    time = _time(log, rig)
    every = [channel for channel in log.channels if channel is not time.source]
    rest = chosen_by(only, every, log) if only else every
    taken = _assign(rest, rig, log)
    if rig.log_names and not taken:
        refuse_strangers(log, rest, rig)
    chosen = {column: one.channel for column, one in taken.items()}
    notes = notes_on(rest, rig, chosen)
    time = _diagnosed(time, log, [chosen[c] for c in rig.outputs if c in chosen] or rest)
    lines, left = _head(log, rig_name, rig, chosen), list[str]()
    if notes:
        lines[-1:] = [*(f"# {note}" for note in notes), ""]
    period = _period(time, rig)
    lines += _time_lines(time, period)
    if time.unit == UNANSWERED:
        left.append("time.unit")
    for column, one in taken.items():
        lines += _signal_lines(column, one, answers, left, time)
    lines += _tail(rig, chosen, every, known or {})
    text = "\n".join(lines) + "\n"
    return GuessedMapping(text, tuple(left), len(chosen), len(every), tuple(notes))


def has_all(log: Log, rig: Rig) -> bool:
    """Has the log a channel for every input that the rig needs, and for an output?"""
    taken = _assign(log.channels, rig, log)
    needed = set(rig.inputs) - set(rig.optional)
    return needed <= set(taken) and bool(set(rig.outputs) & set(taken))


@dataclass(frozen=True)
class _NoRig:
    """As much of a rig as a mapping without one asks for."""

    outputs: Mapping[str, str]
    period_s: float = 0.005
    inputs: Mapping[str, str] = field(default_factory=dict)
    loops: tuple[Loop, ...] = ()
    controller: Mapping[str, float] = field(default_factory=dict)


def guess_without_rig(log: Log, pressures: str = "", angles: str = "") -> GuessedMapping:
    """A mapping of all channels of a log under their own names; arguments as of `guess_of`."""
    time = _time(log, _NoRig({}))
    every = [channel for channel in log.channels if channel is not time.source]
    columns = own_columns(every)
    rig = _NoRig({column: split_column(column)[1] for column in columns})
    time = _diagnosed(time, log, every)
    lines, left = _head(log, "", rig, {}), list[str]()
    lines += _time_lines(time, _period(time, rig))
    if time.unit == UNANSWERED:
        left.append("time.unit")
    answers = Answers(pressures, angles)
    for column, (channel, text) in columns.items():
        chosen = ChosenChannel(replace(channel, unit=text))
        lines += _signal_lines(column, chosen, answers, left, time)
    lines += _tail(rig, {column: channel for column, (channel, _) in columns.items()}, every, {})
    return GuessedMapping("\n".join(lines) + "\n", tuple(left), len(every), len(every))


# ---- which channel is what ---------------------------------------------------------------------


def _assign(channels: Sequence[Channel], rig: Rig, log: Log) -> dict[str, ChosenChannel]:
    """Column of the rig -> channel, best fits first, in the rig's order."""
    columns = list(
        dict.fromkeys([*(loop.reference for loop in rig.loops), *rig.inputs, *rig.outputs])
    )
    named = fits_by_name(channels, rig)
    require_clear(named, channels, log)
    nameless = robot_values(channels) if rig.log_names else {}
    scores = []
    for i, channel in enumerate(channels):
        for j, column in enumerate(columns):
            # a robot's own names say more than words for what is measured
            score = _score(channel, column)
            if score < WHOLE_NAME and i in nameless:
                score = 0
            fit = named.get((i, column))
            if score or fit:
                scores.append((-max(score, fit.score if fit else 0), i, j))
    taken: dict[int, int] = {}
    for _, i, j in sorted(scores):
        if i not in taken and j not in taken.values():
            taken[i] = j
    by_column = {
        columns[j]: ChosenChannel(channels[i], named.get((i, columns[j]))) for i, j in taken.items()
    }
    return {column: by_column[column] for column in columns if column in by_column}


def _score(channel: Channel, column: str) -> int:
    """How well a channel fits a column of the rig; 0 not at all."""
    name, (stem, symbol) = channel.name.rpartition("/")[2], split_column(column)
    if name == column or split_column(name)[0] == stem:
        return WHOLE_NAME
    target = next(
        (
            kind
            for kind in ("reference", "command", *sorted(meanings(stem)))
            if kind in meanings(stem)
        ),
        stem,
    )
    found, known = (
        meanings(name),
        read_unit(channel.unit) if is_readable(channel.unit) and channel.unit else None,
    )
    fits = known is not None and known.dimension == unit(symbol).dimension
    score = 0
    if target in found:
        score = 60 if known is None or fits else (20 if known.dimension in _RAW else 0)
    elif not found and fits and symbol != NONE:
        score = 20  # nothing but its unit speaks for it
    wanted, given = number(stem), number(name)
    if not score or (wanted and given and wanted != given):
        return 0
    return score + (10 if wanted == given else 0)


# ---- the time ----------------------------------------------------------------------------------


def _time(log: Log, rig: Rig | _NoRig) -> TimeGuess:
    rows = [channel for channel in log.channels if channel.stamps is None]
    rising = [channel for channel in rows if _rises(channel.values)]
    if not rising:
        return TimeGuess(None, "s", None)
    source = next((c for c in rising if "time" in meanings(c.name.rpartition("/")[2])), rising[0])
    reason = "as the log says"
    if (
        source.unit
        and is_readable(source.unit)
        and read_unit(source.unit).dimension == unit("s").dimension
    ):
        symbol = source.unit
    else:
        step = float(np.median(np.diff(source.values[np.isfinite(source.values)])))
        ratios = {name: step * read_unit(name).factor / rig.period_s for name in _LIKELY_TIME_UNITS}
        likely = [
            name
            for name, ratio in ratios.items()
            if 1.0 / BELIEVED_WITHIN < ratio < BELIEVED_WITHIN
        ]
        suffix = split_column(source.name)[1]
        named = unit(suffix).dimension == unit("s").dimension
        symbol = suffix if named else (likely[0] if likely else UNANSWERED)
        reason = "by the channel's name" if named else "by the spacing"
    factor = read_unit(symbol).factor if symbol != UNANSWERED else 1.0
    return TimeGuess(source, symbol, (source.values - source.values[0]) * factor, reason)


def _rises(values: FloatArray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps.size > 10 and np.mean(steps >= 0.0) > _RISING and (steps > 0.0).any())


def _diagnosed(time: TimeGuess, log: Log, measured: Sequence[Channel]) -> TimeGuess:
    """What the stamps look like, judged by the channels that seem to be measured."""
    stamps, moving = time.stamps, [c for c in measured if c.stamps is None]
    if stamps is None:
        own = next((c for c in measured if c.stamps is not None), None)
        if own is None or own.stamps is None:
            return time
        stamps, moving = (
            own.stamps,
            [
                c
                for c in measured
                if c.stamps is not None and np.array_equal(c.stamps, own.stamps, equal_nan=True)
            ],
        )
    try:
        rows, found = _judged(stamps, moving)
    except PamidError as error:
        return replace(time, stamps=stamps, trouble=str(error))
    return replace(
        time, stamps=stamps, found=found, trouble="; ".join(r.detail for r in rows.repairs)
    )


def _judged(stamps: FloatArray, moving: Sequence[Channel]) -> tuple[Rows, StampDiagnosis]:
    """The usable rows and what their stamps look like."""
    rows = usable_rows(stamps, [c.values for c in moving], "the stamps")
    return rows, diagnose_stamps(rows, {c.name: c.values[rows.keep] for c in moving})


def _period(time: TimeGuess, rig: Rig | _NoRig) -> float | None:
    if time.found is None or time.unit == UNANSWERED:
        return rig.period_s if time.stamps is None else None
    near = abs(time.found.period / rig.period_s - 1.0) < 1e-3
    return rig.period_s if near else round_period(time.found.period)


# ---- the text ----------------------------------------------------------------------------------


def _head(log: Log, rig_name: str, rig: Rig | _NoRig, chosen: dict[str, Channel]) -> list[str]:
    lines = [
        f"# First mapping of {toml_string(log.path.name)} ({log.kind}), guessed: look it through."
    ]
    lines += [f"#   {' '.join(detail.split())}" for detail in log.details]
    lines.append(
        f"rig = {toml_string(rig_name)}"
        if rig_name
        else '# rig = "..."                # a rig of the catalogue; one of your own is named later'
    )
    if any(loop.reference in chosen and loop.command in chosen for loop in rig.loops):
        lines.append(
            'loop = "closed"              # a controller produced the command? otherwise "open"'
        )
    else:
        lines.append('# loop = "open"              # "closed" if a controller produced the command')
    return [*lines, ""]


def _time_lines(time: TimeGuess, period: float | None) -> list[str]:
    lines = ["[time]"]
    if time.source is not None:
        said = "" if time.unit in (time.source.unit, UNANSWERED) else f"  # {time.reason}"
        lines += [
            f"source = {toml_string(time.source.name)}",
            f"unit = {toml_string(time.unit)}{said}",
        ]
    elif time.stamps is not None:
        lines.append("# channels have stamps of their own")
    else:
        lines.append(
            "# no channel looks like a clock: rows are taken to be evenly spaced, by period_s"
        )
    if period is not None:
        lines.append(f"period_s = {period!r}  # of the recording to write")
        lines.append(
            f"max_gap_s = {float(f'{GAP_PERIODS * period:.6g}')!r}  # longer gaps split the "
            "recording"
        )
    if time.trouble:
        lines.append(f"# {' '.join(time.trouble.split())}")
    if time.found is not None:
        lines.append(f"# {time.found.why}")
    cure = time.found.cure if time.found is not None else None
    if time.found is not None and time.found.state == "undecided":
        lines += [
            "# late-stamps: a device samples evenly, a host writes the time when a sample arrives",
            "# jittered-sampling: samples are taken when their stamps say, as in a loop on a PC",
        ]
    repair = cure if cure not in (None, "none") else "ask"
    return [
        *lines,
        f'repair = "{repair}"  # "ask" | "late-stamps" | "jittered-sampling" | "none"',
        "",
    ]


def _signal_lines(
    column: str, chosen: ChosenChannel, answers: Answers, left: list[str], time: TimeGuess
) -> list[str]:
    symbol, channel, fit = split_column(column)[1], chosen.channel, chosen.fit
    lines = [
        f"[signals.{column}]  # {_about(channel, time)}",
        f"source = {toml_string(channel.name)}",
    ]
    if fit is not None and fit.why:
        lines.append(f"# {fit.why}")
    if fit is not None and fit.scale is not None:
        return [*lines, f"scale = {float(f'{fit.scale:.12g}')!r}", ""]
    guessed, remark = _unit(column, channel, answers.angles, si=fit is not None and fit.si)
    if guessed == UNANSWERED:
        left.append(f"signals.{column}.unit")
    lines.append(f"unit = {toml_string(guessed)}" + (f"  # {remark}" if remark else ""))
    if unit(symbol).dimension == PRESSURE_DIMENSION and not (
        guessed != UNANSWERED and read_unit(guessed).pressure
    ):
        lines.append(
            f"# gauge (0 is the air around) or absolute? {_pressure_hint(channel, guessed)}"
        )
        if not answers.pressures:
            left.append(f"signals.{column}.pressure")
        lines.append(f'pressure = "{answers.pressures or UNANSWERED}"')
    values = channel.values[np.isfinite(channel.values)]
    if values.size and (moves_in_steps(values) or held_by_jumps(values)):
        lines.append('interpolation = "hold"  # it moves in steps')
    return [*lines, ""]


def _unit(column: str, channel: Channel, angles: str, *, si: bool) -> tuple[str, str]:
    """(unit of the source or "?", remark)."""
    symbol, logged = split_column(column)[1], channel.unit.strip()
    if logged and is_readable(logged) and read_unit(logged).dimension == unit(symbol).dimension:
        return logged, ""
    if logged:
        return UNANSWERED, (
            f"the log says {toml_string(logged)}, the column is a {quantity_of(symbol)}; or scale "
            f"= {symbol} per {toml_string(logged)}"
        )
    suffix = split_column(channel.name.rpartition("/")[2])[1]
    if suffix != NONE and unit(suffix).dimension == unit(symbol).dimension:
        return suffix, "by the channel's name"
    if si:
        for one in _SI:
            if unit(one).dimension == unit(symbol).dimension:
                return one, "as such logs have it" if symbol != NONE else ""
    if angles and unit(symbol).dimension in _TURNING:
        return angles + ("/s" if unit(symbol).dimension == _TURNING[1] else ""), "as you say"
    if symbol == NONE:
        values = channel.values[np.isfinite(channel.values)]
        if values.size and np.abs(values).max() <= EQUAL_TO:
            return NONE, "within -1 to 1"
        return UNANSWERED, '"1", "percent"? Of a quantity name the unit: [signals.NAME_UNIT]'
    return UNANSWERED, f"the log does not say it; a {quantity_of(symbol)}"


def _about(channel: Channel, time: TimeGuess) -> str:
    """Range, empty cells and rate of a channel."""
    values = channel.values[np.isfinite(channel.values)]
    if not values.size:
        return "empty"
    said = f"{values.min():.4g} to {values.max():.4g}" + (
        f" {channel.unit}" if channel.unit else ""
    )
    if values.size < channel.values.size:
        said += f", {1.0 - values.size / channel.values.size:.2%} of the cells empty"
    stamps = (
        channel.stamps
        if channel.stamps is not None
        else (time.stamps if time.unit != UNANSWERED else None)
    )
    if stamps is not None and stamps.size > 1 and stamps[-1] > stamps[0]:
        step = float(np.median(np.diff(stamps)))
        # pauses between the parts of a log say nothing of the rate
        paused = bool((np.diff(stamps) > PAUSE * step).any()) and step > 0.0
        rate = 1.0 / step if paused else (values.size - 1) / (stamps[-1] - stamps[0])
        said += f", {rate:.4g} Hz"
    return " ".join(said.split())


def _pressure_hint(channel: Channel, guessed: str) -> str:
    """What the values suggest; it is said, never used."""
    values = channel.values[np.isfinite(channel.values)]
    if guessed == UNANSWERED or not values.size:
        return "A gauge sensor reads 0 with the air off, an absolute one about 101 kPa."
    low = float(values.min()) * read_unit(guessed).factor / 1e3
    seen = f"The lowest value is {low:.0f} kPa: "
    if low < -2.0:
        return seen + "no absolute pressure is below 0."
    if low < 15.0:
        return seen + "a gauge sensor reads about 0 with the air off."
    if 90.0 < low < 115.0:
        return seen + "an absolute sensor reads about 101 kPa with the air off."
    return seen + "it does not tell."


def _tail(
    rig: Rig | _NoRig,
    chosen: dict[str, Channel],
    rest: Sequence[Channel],
    known: Mapping[str, float],
) -> list[str]:
    lines = []
    if missing := [column for column in rig.outputs if column not in chosen]:
        lines.append(f"# nothing found for: {', '.join(missing)}")
    mapped = {id(channel) for channel in chosen.values()}
    left = [channel for channel in rest if id(channel) not in mapped]
    if left:
        lines.append("# channels that are not mapped:")
        lines += [
            f"#   {toml_string(channel.name)}: {_about(channel, TimeGuess(None, UNANSWERED, None))}"
            for channel in left
        ]
    lines += [
        "# [atmosphere]                # taken off absolute pressures",
        "# pressure_kpa = 101.325",
        '# [between]                   # inputs: "held" until the next sample, or "linear" to it',
        f"{'' if known else '# '}[known]  # parameters of the rig known for these recordings",
        *(f"{key} = {value!r}" for key, value in known.items()),
    ]
    if rig.controller:
        lines += [
            '# [controller]                # for loop = "closed"',
            *(f"# {key} = {value!r}" for key, value in rig.controller.items()),
        ]
    return lines
