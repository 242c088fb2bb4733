"""Clock of a log, as far as the log shows it: channel with the stamps, their unit and diagnosis.

A sampling period that the log does not show is requested from the user, and never assumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import PamidError, listed
from pamid.base.units import NONE, split_column, unit
from pamid.intake.logs.channel_builder import SINCE_1970_NS
from pamid.intake.logs.channel_words import TIME_WORDS, meanings, tokens
from pamid.intake.logs.channels import Channel
from pamid.intake.logs.conversion import NOMINAL, round_period
from pamid.intake.logs.mapping import UNANSWERED
from pamid.intake.logs.source_units import is_readable, read_unit
from pamid.intake.logs.stamps import usable_rows
from pamid.intake.logs.stated_period import StatedPeriod
from pamid.intake.logs.time_base import GAP_PERIODS, StampDiagnosis, diagnose_stamps
from pamid.recording.recording import toml_string

BELIEVED_WITHIN = 30.0  # times the rig's period, within which a unit of the stamps is plausible
_LIKELY_UNITS = ("s", "ms", "us", "ns", "min")
_SECOND = unit("s").dimension
_RISING = 0.98  # smallest share of steps of a clock that are not negative
_EVEN = 0.5  # of the usual step: largest median deviation of the steps of an unnamed clock
FEWEST_STAMPS = 10  # distinct ones
EPOCH_STEP_S = 3600.0  # longest step of a clock that counts from 1970
NAMED_CLOCK = 3  # score of a clock by its name that also is even
BY_SPACING = "by the spacing"
FRACTION_S = 0.5  # a channel called time with smaller steps counts s


@dataclass(frozen=True, eq=False)
class ClockGuess:
    """Clock of a log.

    source   channel with the stamps; None without stamps, or if channels have separate stamps
    unit     its unit, "?" if unknown
    stamps   (n,) s
    others   further channels that are clocks
    stated   sampling period that the log states
    """

    source: Channel | None
    unit: str
    stamps: Array | None
    reason: str = ""
    diagnosis: StampDiagnosis | None = None
    trouble: str = ""
    others: tuple[Channel, ...] = ()
    stated: StatedPeriod | None = None

    def period(self, usual: float | None) -> float | None:
        """Sampling period (s) by the stamps, or the usual period of the rig if the two agree.

        Without stamps it is the stated period, and None if nothing shows it.
        """
        if self.stamps is None and self.stated is not None:
            return self.stated.period_s
        if self.diagnosis is None or self.unit == UNANSWERED:
            return None
        if usual is not None and abs(self.diagnosis.period / usual - 1.0) < NOMINAL:
            return usual
        return round_period(self.diagnosis.period)

    @property
    def notes(self) -> list[str]:
        """Sentences about a guessed unit, other clocks, and a contradicted period."""
        notes, name = [], self.source.name if self.source is not None else ""
        if self.reason.startswith(BY_SPACING):
            notes.append(
                f"the unit of {name} is assumed to be {self.unit}, {self.reason}: correct "
                "time.unit if that is wrong"
            )
        if self.others:
            others = listed(channel.name for channel in self.others)
            notes.append(f"{name} is the clock; not mapped, clocks as well: {others}")
        known = self.diagnosis if self.unit != UNANSWERED else None
        if known is not None and self.stated is not None and not self.stated.agrees(known.period):
            notes.append(
                f"the log states {self.stated.quote!r}, its clock shows {known.period:.4g} s "
                "between samples: correct time.unit, or give time.period_s in place of time.source"
            )
        return notes


def guess_clock(
    channels: Sequence[Channel], usual: float | None = None, stated: StatedPeriod | None = None
) -> ClockGuess:
    """Clock among the channels of the log's rows.

    Of several the most even clock is chosen: a device samples evenly, while the time at which a
    host receives a sample jitters. usual: sampling period of the rig in s, None without a rig;
    stated: that of the log.
    """
    scored = {i: _likeness(channel) for i, channel in enumerate(channels)}
    best = max(scored.values(), default=0)
    if best == 0:
        return ClockGuess(None, "s", None, stated=stated)
    clocks = [channels[i] for i, likeness in scored.items() if likeness == best]
    source = min(clocks, key=lambda channel: round(_unevenness(channel.values, np.mean), 3))
    symbol, reason = _unit_of(source, usual, stated)
    factor = read_unit(symbol).factor if symbol != UNANSWERED else 1.0
    first = source.finite[0]
    likewise = clocks if best >= NAMED_CLOCK else []
    others = tuple(
        c
        for c in channels
        if c is not source
        and (c in likewise or np.array_equal(c.values, source.values, equal_nan=True))
    )
    stamps = (source.values - first) * factor
    return ClockGuess(source, symbol, stamps, reason, others=others, stated=stated)


def counts_rows(values: Array) -> bool:
    return values.size > 1 and bool((np.diff(values) == 1.0).all())


def _unevenness(values: Array, of: Callable[[Array], Any] = np.median) -> float:
    """Relative deviation of the steps from the usual step; a pause counts as a step."""
    steps = np.diff(values[np.isfinite(values)])
    usual = float(np.median(steps))
    return float(of(np.minimum(np.abs(steps / usual - 1.0), 1.0))) if usual > 0.0 else math.inf


def _likeness(channel: Channel) -> int:
    """Score of a channel as a clock: 2 by name or unit, 1 more for even steps, 0 for no clock."""
    values = channel.finite
    if values.size <= FEWEST_STAMPS:
        return 0
    steps = np.diff(values)
    if np.mean(steps >= 0.0) <= _RISING or np.unique(values).size < FEWEST_STAMPS:
        return 0
    name = channel.name.rpartition("/")[2]
    logged = read_unit(channel.unit) if channel.unit and is_readable(channel.unit) else None
    runs = _unevenness(values) <= _EVEN and float(np.mean(steps > 0.0)) > _RISING
    if logged is not None and any(logged.dimension):
        return 2 + runs if logged.dimension == _SECOND else 0
    if "time" in meanings(name) or _named_unit(name):
        return 2 + runs
    other = meanings(name) or split_column(name)[1] != NONE
    return int(runs and not other and not counts_rows(values))


def _named_unit(name: str) -> str:
    """Unit in the name of a clock, or ""."""
    suffix = split_column(name)[1]
    if unit(suffix).dimension == _SECOND:
        return suffix
    words = tokens(name)
    return TIME_WORDS.get(words[-1], "") if words else ""


def _unit_of(channel: Channel, usual: float | None, stated: StatedPeriod | None) -> tuple[str, str]:
    """(unit of the stamps or "?", how it is known)."""
    name = channel.name.rpartition("/")[2]
    if channel.unit and is_readable(channel.unit) and read_unit(channel.unit).dimension == _SECOND:
        return channel.unit, ""
    if named := _named_unit(name):
        return named, "by the channel's name"
    values = channel.finite
    steps = np.diff(values)
    step, level = float(np.median(steps[steps > 0.0])), float(np.median(values))
    low, high = (1e-9 * moment for moment in SINCE_1970_NS)
    for symbol in ("s", "ms", "us", "ns"):
        factor = read_unit(symbol).factor
        if low <= level * factor <= high and step * factor <= EPOCH_STEP_S:
            return symbol, "it counts from 1970"
    for symbol in _LIKELY_UNITS if stated is not None else ():
        if stated is not None and stated.agrees(step * read_unit(symbol).factor):
            return symbol, f"the log states {toml_string(stated.quote)}"
    if usual is not None:
        for symbol in _LIKELY_UNITS:
            ratio = step * read_unit(symbol).factor / usual
            if 1.0 / BELIEVED_WITHIN < ratio < BELIEVED_WITHIN:
                return symbol, f"{BY_SPACING} of {step:.4g}"
    elif "time" in meanings(name) and step < FRACTION_S:
        return "s", f"{BY_SPACING} of {step:.4g}"
    periods = {key: step * read_unit(key).factor for key in ("s", "ms", "us", "ns", "day")}
    likely = [f'{t:.4g} s in "{key}"' for key, t in periods.items() if 1e-5 < t < 1e3]
    return UNANSWERED, f"not in the log; samples would be {', '.join(likely)} apart"


def with_diagnosis(clock: ClockGuess, measured: Sequence[Channel]) -> ClockGuess:
    """The clock with a diagnosis of its stamps, based on the measured channels.

    If no channel has the log's rows, the stamps are those of the first channel that has any.
    """
    stamps, moving = clock.stamps, [c for c in measured if c.stamps is None]
    apart = [(c, c.stamps) for c in measured if c.stamps is not None]
    if apart and (stamps is None or not moving):
        stamps = apart[0][1]
        moving = [c for c, times in apart if np.array_equal(times, stamps, equal_nan=True)]
    if stamps is None:
        return clock
    try:
        rows = usable_rows(stamps, [c.values for c in moving], "the stamps")
        diagnosis = diagnose_stamps(rows, {c.name: c.values[rows.keep] for c in moving})
    except PamidError as error:
        return replace(clock, stamps=stamps, trouble=str(error))
    trouble = "; ".join(repair.detail for repair in rows.repairs)
    return replace(clock, stamps=stamps, diagnosis=diagnosis, trouble=trouble)


def clock_lines(clock: ClockGuess, period: float | str | None) -> list[str]:
    """Lines of the [time] table of a mapping.

    period: s, "?" if the user must give it, None if the stamps will show it.
    """
    lines, diagnosis = ["[time]"], clock.diagnosis
    if clock.source is not None:
        reason = f"  # {clock.reason}" if clock.reason else ""
        lines.append(f"source = {toml_string(clock.source.name)}")
        lines.append(f"unit = {toml_string(clock.unit)}{reason}")
    elif clock.stamps is not None:
        lines.append("# channels have separate stamps")
    if clock.stamps is None and clock.stated is not None and isinstance(period, float):
        lines.append(f"# no channel is a clock; the log states {toml_string(clock.stated.quote)}")
    if period == UNANSWERED:
        lines += [
            "# no channel is a clock: rows are assumed to be evenly spaced, by this period in s",
            f"period_s = {toml_string(UNANSWERED)}",
        ]
    elif isinstance(period, float):
        longest = float(f"{GAP_PERIODS * period:.6g}")
        lines.append(f"period_s = {period!r}  # of the recording to write")
        lines.append(f"max_gap_s = {longest!r}  # longer gaps split the recording")
    if clock.trouble:
        lines.append(f"# {' '.join(clock.trouble.split())}")
    if diagnosis is not None:
        lines.append(f"# {diagnosis.why}")
    if diagnosis is not None and diagnosis.state == "undecided":
        lines += [
            "# late-stamps: a device samples evenly, a host writes the time when a sample arrives",
            "# jittered-sampling: the stamps are the true sampling instants, as in a loop on a PC",
        ]
    cure = diagnosis.cure if diagnosis is not None else None
    repair = cure if cure not in (None, "none") else "ask"
    choice = f'repair = "{repair}"  # "ask" | "late-stamps" | "jittered-sampling" | "none"'
    return [*lines, choice, ""]
