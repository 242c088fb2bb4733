"""The clocks of a log: which channels share stamps, what these look like, and the cure each time
base gets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.errors import DataError, FileError, listed, nearest
from pamid.base.metrics import FloatArray
from pamid.base.units import unit
from pamid.ingest.channels import Channel, Log, rows_in_turns
from pamid.ingest.mapping import UNANSWERED, MappedSignal, Mapping
from pamid.ingest.source_units import in_unit, read_unit
from pamid.ingest.stamps import Rows, usable_rows
from pamid.ingest.time_base import (
    Cure,
    StampDiagnosis,
    TimeBase,
    diagnose_stamps,
    reconstructed_time_base,
)
from pamid.model.rig import Rig
from pamid.recording.file_checks import HUGE, UNIFORM_TO
from pamid.recording.recording import MIN_SAMPLES

FAR_FROM_USUAL = 100.0  # times the usual period: then the unit of the stamps is in doubt
NEAR_USUAL = 30.0  # times the usual period: what another unit of the stamps would have to give
_TIME_UNITS = ("ns", "us", "ms", "s", "min")


@dataclass(frozen=True, eq=False)
class SampledColumn:
    """A channel as a column of the recording: values (n,) in the column's unit at the rows of its
    clock, NaN where the log has none."""

    signal: MappedSignal
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Group:
    """Columns that share stamps (s): those of the log's rows, or their own."""

    name: str
    stamps: FloatArray
    of_rows: bool
    sampled: list[SampledColumn]


@dataclass(frozen=True, eq=False)
class Clock:
    """Channels that share their stamps: what these look like, the cure, and the instants of the
    rows that stay."""

    name: str
    sampled: tuple[SampledColumn, ...]  # values at the rows that stay
    rows: Rows
    found: StampDiagnosis | None  # None: events, whose stamps are taken as they are
    cure: Cure
    base: TimeBase
    notes: tuple[str, ...] = ()


def clocks_of(
    log: Log,
    mapping: Mapping,
    signals: Sequence[MappedSignal],
    rig: Rig | None,
    where: str,
    repair: str,
) -> tuple[Clock, ...]:
    """The clocks of the mapped channels, diagnosed and cured. `where` names the mapping in errors;
    `repair` overrules its [time] repair. FileError for what is wrong, DataError where the data do
    not decide."""
    groups = _by_stamps(log, mapping, signals, where)
    clocks = tuple(_clock(group, log, mapping, rig, where, repair) for group in groups)
    for clock in clocks:
        if len(clock.rows.starts) > 1 and len(clocks) > 1:
            raise FileError(
                f"{log.path}: {clock.name}: the clock was set back, and other channels have other "
                "stamps.",
                "Cut the log there: how the two go together afterwards is not known.",
                code="stamps-unsorted",
            )
    return clocks


def channel_of(log: Log, name: str, place: str) -> Channel:
    """The channel `name`; FileError naming the key of the mapping that asks for it, and the nearest
    name."""
    for channel in log.channels:
        if channel.name == name:
            return channel
    names = [channel.name for channel in log.channels]
    hint = nearest(name, names) or f"Its channels are: {listed(names)}."
    raise FileError(
        f"{place} is {name!r}; {log.path} has no such channel.", hint, code="missing-channel"
    )


def _by_stamps(
    log: Log, mapping: Mapping, signals: Sequence[MappedSignal], where: str
) -> list[Group]:
    groups: list[Group] = []
    rows: FloatArray | None = None
    turns = rows_in_turns([c for c in log.channels if c.name != mapping.time.source])
    for signal in signals:
        channel = channel_of(log, signal.source, f"{where}: signals.{signal.column}.source")
        of_rows = channel.stamps is None
        if of_rows and rows is None:
            rows = _row_stamps(log, mapping, channel.values.size, where)
        stamps = rows if channel.stamps is None else channel.stamps
        assert stamps is not None
        if stamps.size != channel.values.size:
            raise FileError(
                f"{log.path}: {channel.name!r} has {channel.values.size} values, its clock "
                f"{stamps.size} stamps.",
                "Choose as time.source a channel with as many rows.",
                code="rows",
            )
        _require_sane(channel, log)
        if (turn := turns.get(channel.name)) is not None:
            stamps, channel = stamps[turn], replace(channel, values=channel.values[turn])
        course = SampledColumn(
            signal, _in_column(channel.values, signal, mapping.atmosphere.pressure_kpa * 1e3)
        )
        for group in groups:
            if group.of_rows == of_rows and np.array_equal(group.stamps, stamps, equal_nan=True):
                group.sampled.append(course)
                break
        else:
            name = mapping.time.source or "rows" if of_rows else f"stamps of {channel.name}"
            groups.append(Group(name, stamps, of_rows, [course]))
    return groups


def _row_stamps(log: Log, mapping: Mapping, count: int, where: str) -> FloatArray:
    """The stamps (s) of the log's rows, by [time]."""
    settings = mapping.time
    if settings.source is None:
        if settings.period_s is None:
            hint = (
                "Name the channel with the time in time.source, or the sampling period in "
                "time.period_s."
            )
            raise FileError(
                f"{where}: time says neither source nor period_s.", hint, code="mapping"
            )
        return np.arange(count, dtype=np.float64) * settings.period_s
    channel = channel_of(log, settings.source, f"{where}: time.source")
    text = settings.unit if settings.unit is not None else channel.unit or "s"
    if text == UNANSWERED:
        raise FileError(
            f'{where}: time.unit is "?": say in which unit {settings.source!r} counts.',
            'For example "s", "ms".',
            code="unit",
        )
    try:
        stamps = in_unit(channel.values, read_unit(text), "s")
    except FileError as error:
        raise FileError(
            f"{where}: time.unit is {text!r}: {error.message}", error.hint, code="unit"
        ) from None
    # a clock that counts from 1970 is kept only where channels with stamps of their own may count
    # so too
    finite = stamps[np.isfinite(stamps)]
    own = any(other.stamps is not None for other in log.channels)
    return np.asarray(stamps if own or not finite.size else stamps - finite[0], dtype=np.float64)


def _require_sane(channel: Channel, log: Log) -> None:
    """FileError for a number that no sensor sends: some loggers mark a missing value so."""
    far = np.flatnonzero(np.isfinite(channel.values) & (np.abs(channel.values) > HUGE))
    if far.size:
        raise FileError(
            f"{log.path}: {channel.name!r} is {channel.values[far[0]]:g} in data row {far[0] + 1} "
            f"({far.size} such).",
            "If that marks a missing value, empty these cells.",
            code="cell",
        )


def _in_column(values: FloatArray, signal: MappedSignal, atmosphere: float) -> FloatArray:
    pressure = atmosphere if signal.absolute else 0.0
    if signal.unit is not None:
        converted = in_unit(values, signal.unit, signal.symbol, pressure)
    else:
        converted = values * signal.scale - (
            pressure / unit(signal.symbol).factor if pressure else 0.0
        )
    converted = converted if signal.sign == 1 else -converted
    return converted + signal.offset if signal.offset else converted


def _clock(
    group: Group, log: Log, mapping: Mapping, rig: Rig | None, where: str, repair: str
) -> Clock:
    """Diagnose one clock and settle when its rows were sampled."""
    place, wanted = f"{log.path}: {group.name}", repair or mapping.time.repair
    if (
        not group.of_rows
        and all(c.signal.hold for c in group.sampled)
        and not _regular(group.stamps)
    ):
        return _events(group, place)
    rows = usable_rows(group.stamps, [c.values for c in group.sampled], place)
    staying = tuple(replace(c, values=c.values[rows.keep]) for c in group.sampled)
    try:
        diagnosis = diagnose_stamps(
            rows, {c.signal.column: c.values for c in staying if not c.signal.hold}
        )
    except DataError as error:
        raise DataError(f"{place}: {error.message}", error.hint, code=error.code) from None
    if group.of_rows and mapping.time.source is not None:
        _require_plausible(diagnosis.period, mapping, rig, where)
    elif group.of_rows:
        diagnosis = replace(diagnosis, why="the log has no clock: its rows are time.period_s apart")
    if mapping.time.max_gap_s is not None and mapping.time.max_gap_s < 1.5 * diagnosis.period:
        raise FileError(
            f"{where}: time.max_gap_s is {mapping.time.max_gap_s:g}, but samples are "
            f"{diagnosis.period:.4g} s apart.",
            "A gap is longer than a few samples.",
            code="mapping",
        )
    cure, notes = _choose(diagnosis, wanted, rows, place)
    return Clock(
        group.name,
        staying,
        rows,
        diagnosis,
        cure,
        reconstructed_time_base(rows, diagnosis, cure, mapping.time.max_gap_s),
        notes,
    )


def _regular(stamps: FloatArray) -> bool:
    """Whether stamps (s) are a sampling, not events."""
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if steps.size >= MIN_SAMPLES else 0.0
    return usual > 0.0 and float(np.mean(np.abs(steps - usual) <= UNIFORM_TO * usual)) > 0.5


def _events(group: Group, place: str) -> Clock:
    """A clock of its own for values that hold until the next one: any spacing is right."""
    stamps = group.stamps
    keep = np.flatnonzero(np.isfinite(stamps))
    keep = keep[np.argsort(stamps[keep], kind="stable")]
    if not keep.size:
        raise DataError(f"{place}: no value has a stamp.", code="too-short")
    last = np.append(np.diff(stamps[keep]) > 0.0, True)
    keep = keep[last]
    latest = tuple(
        replace(c, values=c.values[keep], signal=replace(c.signal, events=True))
        for c in group.sampled
    )
    times = stamps[keep]
    rows = Rows(keep, times, (0,), False, ())
    step = float(np.median(np.diff(times))) if times.size > 1 else math.inf
    return Clock(
        group.name, latest, rows, None, "none", TimeBase(times, (slice(0, times.size),), step)
    )


def _choose(
    diagnosis: StampDiagnosis, wanted: str, rows: Rows, place: str
) -> tuple[Cure, tuple[str, ...]]:
    """The cure of a time base, and what to say about it; DataError where only the user can tell."""
    if diagnosis.state == "even":
        return "none", ()
    if wanted == "none":
        raise FileError(
            f'{place}: time.repair is "none", but the stamps are uneven: {diagnosis.why}.',
            'A recording is uniform to 1 %: choose "late-stamps", "jittered-sampling" or "ask".',
            code="time-base",
        )
    if wanted == "ask":
        if diagnosis.cure is None:
            hint = (
                'Say which with --time-base or time.repair. "late-stamps": a device samples '
                "evenly and a host "
                "writes the time when a sample arrives; the even clock is restored. "
                '"jittered-sampling": the '
                "samples are taken when their stamps say, as in a loop on a PC; they are resampled "
                "by the stamps. The wrong one does harm."
            )
            raise DataError(
                f"{place}: the stamps are uneven, and the data do not tell why: {diagnosis.why}.",
                hint,
                code="time-base",
            )
        return diagnosis.cure, ()
    if rows.blocks and wanted == "jittered-sampling":
        raise FileError(
            f"{place}: {diagnosis.why}. Samples cannot be told apart by such stamps.",
            'Choose "late-stamps".',
            code="time-base",
        )
    cure: Cure = "late-stamps" if wanted == "late-stamps" else "jittered-sampling"
    against = diagnosis.cure is not None and diagnosis.cure != cure
    return cure, ((f"the data speak against {cure}: {diagnosis.why}",) if against else ())


def _require_plausible(period: float, mapping: Mapping, rig: Rig | None, where: str) -> None:
    """FileError where the stamps' unit gives a sampling period far from the usual one."""
    usual = mapping.time.period_s or (rig.period_s if rig else None)
    if usual is None or 1.0 / FAR_FROM_USUAL < period / usual < FAR_FROM_USUAL:
        return
    factor = read_unit(mapping.time.unit or "s").factor
    unit_text = (
        f'time.unit is "{mapping.time.unit}"' if mapping.time.unit else "time.unit is not given"
    )
    for name in _TIME_UNITS:
        other = period / factor * read_unit(name).factor
        if 1.0 / NEAR_USUAL < other / usual < NEAR_USUAL:
            raise FileError(
                f'{where}: {unit_text}: samples would be {period:.4g} s apart; in "{name}" '
                "they would "
                f"be {other:.4g} s apart, and {usual:g} s are usual.",
                "Correct time.unit; if they really are so far apart, say so in time.period_s.",
                code="time-unit",
            )
    if mapping.time.period_s is not None:
        raise FileError(
            f"{where}: time.period_s is {usual:g}, but samples are {period:.4g} s apart.",
            "Correct period_s or time.unit.",
            code="time-unit",
        )
