"""First mapping of a log, with a comment on every guess, for the user to check.

Facts that only the user has stay open ("?"): a unit that the log does not state, and whether a
pressure is gauge or absolute.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pamid.base.errors import FileError, listed, nearest
from pamid.base.units import NONE, quantity_of, split_column, unit
from pamid.intake.logs.channel_columns import channel_columns
from pamid.intake.logs.channels import Channel, Log, interleaved_rows
from pamid.intake.logs.guessed_clock import (
    ClockGuess,
    clock_lines,
    counts_rows,
    guess_clock,
    with_diagnosis,
)
from pamid.intake.logs.mapping import UNANSWERED
from pamid.intake.logs.matcher import ColumnFit, match_channels, notes_on, refuse_foreign_joints
from pamid.intake.logs.parts import merged_parts
from pamid.intake.logs.source_units import PRESSURE_DIMENSION, is_readable, read_unit
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps, moves_in_steps
from pamid.recording.recording import MIN_SAMPLES, toml_string

PAUSE = 100.0  # times the usual step
EQUAL_TO = 1.05  # largest amplitude of a ratio; larger commands are in per cent
_SI = ("rad", "m", "rad/s", "m/s", "N m", "N", NONE)
#: channel of a column, and its fit by names, words and unit; None without a rig
Match = tuple[Channel, ColumnFit | None]
_TURNING = (unit("rad").dimension, unit("rad/s").dimension)


@dataclass(frozen=True)
class GuessedMapping:
    """Text of a mapping, its open keys, the numbers of mapped and of all channels, and notes on the
    others."""

    text: str
    open: tuple[str, ...]
    mapped: int
    channels: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Answers:
    """Answers of the user for all channels; "" and None leave a question open.

    pressures   "gauge" or "absolute"
    angles      unit of angles without a unit, "deg" or "rad"
    period_s    sampling period of a log without a clock
    known       parameters of the rig in these recordings
    """

    pressures: str = ""
    angles: str = ""
    period_s: float | None = None
    known: Mapping[str, float] = field(default_factory=dict)


def guess_of(
    log: Log,
    rig: Rig | None = None,
    rig_name: str = "",
    answers: Answers | None = None,
    only: str = "",
) -> GuessedMapping:
    """Mapping of a log for a rig; without a rig every channel keeps its name.

    only: text in the names of the channels to use. Raises FileError if the log has no joint of the
    rig, or if several channels fit a column.
    """
    answers = answers or Answers()
    log, parts = merged_parts(log)
    usual = rig.period_s if rig is not None else None
    clock, every, notes = _clock_and_channels(log, usual)
    rest = [channel for channel in every if only in channel.name]
    if not rest and only:
        names = [channel.name for channel in every]
        words = list(dict.fromkeys(part for name in names for part in name.split("/") if part))
        raise FileError(
            f"{log.path}: no channel name contains {only!r}.",
            nearest(only, words) or f"Its channels are: {', '.join(names[:20])}.",
            code="missing-channel",
        )
    matched: dict[str, Match] = {}
    measured = rest
    if rig is None:
        matched |= {
            column: (replace(channel, unit=text or channel.unit), None)
            for column, (channel, text) in channel_columns(rest, answers.angles).items()
        }
    else:
        matched |= match_channels(rest, rig, log)
        if rig.log_names and not matched:
            refuse_foreign_joints(log, rest, rig)
        chosen = {column: channel for column, (channel, _) in matched.items()}
        notes += notes_on(rest, rig, chosen)
        unmapped = [c.name for c in rest if all(c is not other for other in chosen.values())]
        if unmapped and not rig.log_names:
            notes.append(f"not mapped, rig {rig.name!r} has no column for them: {listed(unmapped)}")
        measured = [chosen[c] for c in rig.outputs if c in chosen] or rest
    if not matched:
        if rig is None or not rest:
            why = f" ({'; '.join(notes)})" if notes else ""
            raise FileError(
                f"{log.path}: there is no channel to map{why}.",
                "Is it a table of numbers?",
                code="no-signals",
            )
        raise FileError(
            f"{log.path}: none of its channels ({listed(c.name for c in rest)}) fits a column of "
            f"rig {rig.name!r} ({listed([*rig.inputs, *rig.outputs])}).",
            "Leave --rig out to map every channel under its name. In that mapping give the signals "
            "the rig's names, as [signals.angle_deg].",
            code="no-signals",
        )
    clock = with_diagnosis(clock, measured)
    notes += clock.notes
    period: float | str | None = answers.period_s or clock.period(usual)
    if period is None and clock.stamps is None:
        period = UNANSWERED
    lines, left = _head(log, rig_name, rig, matched, [*([parts] if parts else []), *notes]), []
    lines += clock_lines(clock, period)
    if clock.unit == UNANSWERED:
        left.append("time.unit")
    if period == UNANSWERED:
        left.append("time.period_s")
    if clock.diagnosis is not None and clock.diagnosis.state == "undecided":
        left.append("time.repair")
    for column, choice in matched.items():
        lines += _signal_lines(column, choice, answers, left, clock)
    lines += _tail(rig, matched, every, answers.known)
    text = "\n".join(lines) + "\n"
    return GuessedMapping(text, tuple(left), len(matched), len(every), tuple(notes))


def _clock_and_channels(
    log: Log, usual: float | None
) -> tuple[ClockGuess, list[Channel], list[str]]:
    """Clock of a log, channels to map, and notes on the others.

    Channels of the log's rows need the number of values that most have, and enough for a recording.
    Interleaved channels get separate stamps. usual: sampling period of the rig in s.
    """
    notes = [detail for detail in log.details if detail.startswith("left out")]
    rows, lengths = log.channels, Counter(c.values.size for c in log.channels if c.stamps is None)
    if len(lengths) > 1:
        # of as many channels the longer ones
        most = max(lengths, key=lambda length: (lengths[length], length))
        others = [c for c in rows if c.stamps is None and c.values.size != most]
        names = listed(f"{c.name} ({c.values.size})" for c in others)
        rows = tuple(c for c in rows if c.stamps is not None or c.values.size == most)
        notes.append(f"not mapped, of other lengths than the {most} rows of the others: {names}")
    rare = [c for c in rows if c.stamps is None and c.finite.size < MIN_SAMPLES <= c.values.size]
    if rare:
        notes.append(f"not mapped, fewer than {MIN_SAMPLES} values: {listed(c.name for c in rare)}")
        rows = tuple(c for c in rows if all(c is not few for few in rare))
    clock = guess_clock([c for c in rows if c.stamps is None], usual, log.stated)
    clocks, stamps = [clock.source, *clock.others], clock.stamps
    channels = [channel for channel in rows if all(channel is not item for item in clocks)]
    turns = interleaved_rows(channels)
    if stamps is None or not turns:
        return clock, channels, notes
    whole = [c.name for c in channels if c.stamps is None and c.name not in turns]
    if whole:
        notes.append(f"not mapped, in every row while the others alternate: {listed(whole)}")
    apart = [
        replace(c, values=c.values[turns[c.name]], stamps=stamps[turns[c.name]])
        for c in channels
        if c.name in turns
    ]
    return clock, [*apart, *(c for c in channels if c.stamps is not None)], notes


# ---- the text ----------------------------------------------------------------------------------


def _head(
    log: Log, rig_name: str, rig: Rig | None, chosen: Mapping[str, Match], notes: Sequence[str]
) -> list[str]:
    name = toml_string(log.path.name)
    details = [detail for detail in log.details if detail not in notes]
    named = '# rig = "..."                # a rig of the catalogue; give a rig file with --rig'
    named = f"rig = {toml_string(rig_name)}" if rig_name else named
    loop = '# loop = "open"              # "closed" if a controller produced the command'
    if any(k.reference in chosen and k.command in chosen for k in (rig.loops if rig else ())):
        loop = 'loop = "closed"              # a controller produced the command? otherwise "open"'
    return [
        f"# First mapping of {name} ({log.kind}), guessed: please check it.",
        *(f"#   {' '.join(detail.split())}" for detail in (*details, *notes)),
        named,
        loop,
        "",
    ]


def _signal_lines(
    column: str, chosen: Match, answers: Answers, left: list[str], clock: ClockGuess
) -> list[str]:
    symbol, (channel, fit) = split_column(column)[1], chosen
    lines = [f"[signals.{column}]  # {_about(channel, clock)}"]
    lines.append(f"source = {toml_string(channel.name)}")
    if fit is not None and fit.why:
        lines.append(f"# {fit.why}")
    if fit is not None and fit.scale is not None:
        return [*lines, f"scale = {float(f'{fit.scale:.12g}')!r}", ""]
    guessed, remark = _unit(column, chosen, answers.angles)
    if guessed == UNANSWERED:
        left.append(f"signals.{column}.unit")
    lines.append(f"unit = {toml_string(guessed)}" + (f"  # {remark}" if remark else ""))
    marked = guessed != UNANSWERED and read_unit(guessed).pressure
    if unit(symbol).dimension == PRESSURE_DIMENSION and not marked:
        hint = _pressure_hint(channel, guessed)
        lines.append(f"# gauge (0 is the air around) or absolute? {hint}")
        if not answers.pressures:
            left.append(f"signals.{column}.pressure")
        lines.append(f'pressure = "{answers.pressures or UNANSWERED}"')
    values = channel.finite
    if values.size and (moves_in_steps(values) or held_by_jumps(values)):
        lines.append('interpolation = "hold"  # it moves in steps')
    return [*lines, ""]


def _unit(column: str, chosen: Match, angles: str) -> tuple[str, str]:
    """(unit of the source or "?", remark)."""
    channel, fit = chosen
    symbol, logged = split_column(column)[1], channel.unit.strip()
    if logged and is_readable(logged) and read_unit(logged).dimension == unit(symbol).dimension:
        return logged, ""
    if fit is None:
        if counts_rows(channel.values):
            return NONE, "it counts rows"
        hint = f"the log has {toml_string(logged)}; " if logged else ""
        values = channel.finite
        whole = values.size and not logged and bool((values == np.round(values)).all())
        counts = f"; counts: [signals.{column}_deg] and scale = 360 / (4 * lines)" if whole else ""
        text = f'{hint}"deg" makes {column} a column {column}_deg; "1" is a ratio{counts}'
        return UNANSWERED, text
    suffix = split_column(channel.name.rpartition("/")[2])[1]
    if not logged and suffix != NONE and unit(suffix).dimension == unit(symbol).dimension:
        return suffix, "by the channel's name"
    if hint := logged or suffix.removeprefix(NONE):
        return UNANSWERED, (
            f"the log has {toml_string(hint)}, the column is a {quantity_of(symbol)}; or scale "
            f"= {symbol} per {toml_string(hint)} in place of it"
        )
    if fit.si:
        for si_symbol in _SI:
            if unit(si_symbol).dimension == unit(symbol).dimension:
                return si_symbol, "by the log's format" if symbol != NONE else ""
    if angles and unit(symbol).dimension in _TURNING:
        return angles + ("/s" if unit(symbol).dimension == _TURNING[1] else ""), "by --angles"
    if symbol == NONE:
        values = channel.finite
        if values.size and np.abs(values).max() <= EQUAL_TO:
            return NONE, "within -1 to 1"
        return UNANSWERED, '"1", "percent"? Of a quantity name the unit: [signals.NAME_UNIT]'
    return UNANSWERED, f"not in the log; a {quantity_of(symbol)}"


def _about(channel: Channel, time: ClockGuess | None = None) -> str:
    """Range, empty cells and rate of a channel."""
    values = channel.finite
    if not values.size:
        return "empty"
    unit_text = f" {channel.unit}" if channel.unit else ""
    text = f"{values.min():.4g} to {values.max():.4g}{unit_text}"
    if values.size < channel.values.size:
        text += f", {1.0 - values.size / channel.values.size:.2%} of the cells empty"
    stamps = channel.stamps
    if stamps is None and time is not None and time.unit != UNANSWERED:
        stamps = time.stamps
    if stamps is not None and stamps.size > 1 and stamps[-1] > stamps[0]:
        step = float(np.median(np.diff(stamps)))
        # pauses between the parts of a log do not affect the rate
        paused = bool((np.diff(stamps) > PAUSE * step).any()) and step > 0.0
        rate = 1.0 / step if paused else (values.size - 1) / (stamps[-1] - stamps[0])
        text += f", {rate:.4g} Hz"
    return " ".join(text.split())


def _pressure_hint(channel: Channel, guessed: str) -> str:
    """Kind of pressure that the values suggest; it is reported, never used."""
    values = channel.finite
    if guessed == UNANSWERED or not values.size:
        return "A gauge sensor reads 0 with the air off, an absolute sensor about 101 kPa."
    low = float(values.min()) * read_unit(guessed).factor / 1e3
    seen = f"The lowest value is {low:.0f} kPa: "
    if low < -2.0:
        return seen + "no absolute pressure is below 0."
    if low < 15.0:
        return seen + "a gauge sensor reads about 0 with the air off."
    if 90.0 < low < 115.0:
        return seen + "an absolute sensor reads about 101 kPa with the air off."
    return seen + "both are possible."


def _tail(
    rig: Rig | None,
    chosen: Mapping[str, Match],
    rest: Sequence[Channel],
    known: Mapping[str, float],
) -> list[str]:
    lines = []
    if missing := [column for column in (rig.outputs if rig else ()) if column not in chosen]:
        lines.append(f"# no channel found for: {', '.join(missing)}")
    mapped = {channel.name for channel, _ in chosen.values()}
    left = [channel for channel in rest if channel.name not in mapped]
    lines += ["# channels that are not mapped:"] if left else []
    lines += [f"#   {toml_string(channel.name)}: {_about(channel)}" for channel in left]
    lines += [
        "# value = sign * (scale * source) + offset; keys of a signal: sign = -1, scale = 0.18 (in",
        "#   place of unit, in the unit at the end of its name), offset = 12.0 (in that unit)",
        "# [atmosphere]                # subtracted from absolute pressures",
        "# pressure_kpa = 101.325",
        '# [between]                   # inputs: "held" until the next sample, or "linear" to it;',
        '#                             # outputs: "before", if read before the command of a row',
        f"{'' if known else '# '}[known]  # parameters of the rig known for these recordings",
        *(f"{key} = {value!r}" for key, value in known.items()),
    ]
    if rig is not None and rig.controller:
        lines += [
            '# [controller]                # for loop = "closed"',
            *(f"# {key} = {value!r}" for key, value in rig.controller.items()),
        ]
    return lines
