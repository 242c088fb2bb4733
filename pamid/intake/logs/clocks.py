"""Clocks of a log: groups of channels with common stamps, the diagnosis of the stamps, and the
repair of each time base."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError
from pamid.intake.logs.channels import Log, interleaved_rows
from pamid.intake.logs.mapping import UNANSWERED, MappedSignal, Mapping
from pamid.intake.logs.source_units import in_unit, read_unit
from pamid.intake.logs.stamps import Rows, usable_rows
from pamid.intake.logs.time_base import (
    Cure,
    StampDiagnosis,
    TimeBase,
    diagnose_stamps,
    reconstructed_time_base,
)
from pamid.model.rig import Rig
from pamid.recording.file_checks import HUGE, UNIFORM_TO
from pamid.recording.recording import MIN_SAMPLES

FAR_FROM_USUAL = 100.0  # times the usual period: beyond it the unit of the stamps is doubtful
NEAR_USUAL = 30.0  # times the usual period: another unit must give a period within it
_TIME_UNITS = ("ns", "us", "ms", "s", "min")


@dataclass(frozen=True, eq=False)
class SampledColumn:
    """A channel as a column of the recording: values (n,) in the column's unit at the rows of its
    clock, NaN for missing values."""

    signal: MappedSignal
    values: Array


@dataclass(frozen=True, eq=False)
class Group:
    """Columns with common stamps (s): those of the log's rows, or separate ones."""

    name: str
    stamps: Array
    of_rows: bool
    sampled: list[SampledColumn]

    @property
    def regular(self) -> bool:
        """Whether the stamps are those of a sampled signal, not of events."""
        steps = np.diff(self.stamps)
        usual = float(np.median(steps)) if steps.size >= MIN_SAMPLES else 0.0
        return usual > 0.0 and float(np.mean(np.abs(steps - usual) <= UNIFORM_TO * usual)) > 0.5


@dataclass(frozen=True, eq=False)
class Clock:
    """Channels with common stamps: their diagnosis, the repair, and the instants of the rows."""

    name: str
    sampled: tuple[SampledColumn, ...]  # values at the usable rows
    rows: Rows
    diagnosis: StampDiagnosis | None  # None: events, whose stamps are used unchanged
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
    """Clocks of the mapped channels, diagnosed and repaired.

    where: name of the mapping in errors. repair: overrides its [time] repair. Raises FileError for
    a fault of log or mapping, DataError if the data do not determine the repair.
    """
    wanted = repair or mapping.time.repair
    groups = _by_stamps(log, mapping, signals, where)
    clocks = tuple(
        _clock(group, f"{log.path}: {group.name}", mapping, rig, where, wanted) for group in groups
    )
    for clock in clocks:
        if len(clock.rows.starts) > 1 and len(clocks) > 1:
            raise FileError(
                f"{log.path}: {clock.name}: the clock was set back, and other channels have other "
                "stamps.",
                "Cut the log there. The offset between the two clocks afterwards is unknown.",
                code="stamps-unsorted",
            )
    return clocks


def _by_stamps(
    log: Log, mapping: Mapping, signals: Sequence[MappedSignal], where: str
) -> list[Group]:
    groups: list[Group] = []
    rows: Array | None = None
    turns = interleaved_rows([c for c in log.channels if c.name != mapping.time.source])
    for signal in signals:
        channel = log.channel(signal.stated.source, f"{where}: signals.{signal.column}.source")
        of_rows = channel.stamps is None
        if of_rows and rows is None:
            rows = _row_stamps(log, mapping, channel.values.size, where)
        stamps = rows if channel.stamps is None else channel.stamps
        assert stamps is not None
        if stamps.size != channel.values.size:
            raise FileError(
                f"{log.path}: {channel.name!r} has {channel.values.size} values, but its time "
                f"channel has {stamps.size} time stamps.",
                "Choose a time.source with the same number of rows.",
                code="rows",
            )
        far = np.flatnonzero(np.isfinite(channel.values) & (np.abs(channel.values) > HUGE))
        if far.size:
            raise FileError(
                f"{log.path}: {channel.name!r} is {channel.values[far[0]]:g} in data row "
                f"{far[0] + 1} ({far.size} such values).",
                "If it marks missing values, empty these cells.",
                code="cell",
            )
        if (turn := turns.get(channel.name)) is not None:
            stamps, channel = stamps[turn], replace(channel, values=channel.values[turn])
        values = signal.in_column(channel.values, mapping.atmosphere.pressure_kpa * 1e3)
        course = SampledColumn(signal, values)
        for group in groups:
            if group.of_rows == of_rows and np.array_equal(group.stamps, stamps, equal_nan=True):
                group.sampled.append(course)
                break
        else:
            name = mapping.time.source or "rows" if of_rows else f"stamps of {channel.name}"
            groups.append(Group(name, stamps, of_rows, [course]))
    return groups


def _row_stamps(log: Log, mapping: Mapping, count: int, where: str) -> Array:
    settings = mapping.time
    if settings.source is None:
        if settings.period_s is None:
            raise FileError(
                f"{where}: [time] has neither source nor period_s.",
                "Name the channel with the time in time.source, or the sampling period in "
                "time.period_s.",
                code="mapping",
            )
        return np.arange(count, dtype=np.float64) * settings.period_s
    channel = log.channel(settings.source, f"{where}: time.source")
    text = settings.unit if settings.unit is not None else channel.unit or "s"
    if text == UNANSWERED:
        raise FileError(
            f'{where}: time.unit is "?".',
            f'Replace it by the unit of {settings.source!r}, for example "s" or "ms".',
            code="unit",
        )
    try:
        stamps = in_unit(channel.values, read_unit(text), "s")
    except FileError as error:
        message = f"{where}: time.unit is {text!r}: {error.message}"
        raise FileError(message, error.hint, code="unit") from None
    # separate stamps of other channels may also count from 1970; else the first row becomes 0,
    # which keeps the digits of a float for the differences
    finite = stamps[np.isfinite(stamps)]
    several = any(other.stamps is not None for other in log.channels)
    first = 0.0 if several or not finite.size else finite[0]
    return np.asarray(stamps - first, dtype=np.float64)


def _clock(
    group: Group, place: str, mapping: Mapping, rig: Rig | None, where: str, wanted: str
) -> Clock:
    """Diagnose a clock and determine the sampling instants of its rows."""
    held = all(c.signal.hold for c in group.sampled)
    if held and not group.of_rows and not group.regular:
        # events: each value holds until the next, so any spacing is valid
        keep = np.flatnonzero(np.isfinite(group.stamps))
        keep = keep[np.argsort(group.stamps[keep], kind="stable")]
        if not keep.size:
            raise DataError(f"{place}: no value has a stamp.", code="too-short")
        keep = keep[np.append(np.diff(group.stamps[keep]) > 0.0, True)]
        latest = tuple(
            replace(c, values=c.values[keep], signal=replace(c.signal, events=True))
            for c in group.sampled
        )
        times = group.stamps[keep]
        rows = Rows(keep, times, (0,), False, ())
        step = float(np.median(np.diff(times))) if times.size > 1 else math.inf
        base = TimeBase(times, (slice(0, times.size),), step)
        return Clock(group.name, latest, rows, None, "none", base)
    rows = usable_rows(group.stamps, [c.values for c in group.sampled], place)
    staying = tuple(replace(c, values=c.values[rows.keep]) for c in group.sampled)
    measured = {c.signal.column: c.values for c in staying if not c.signal.hold}
    try:
        diagnosis = diagnose_stamps(rows, measured)
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
            "Give a longer max_gap_s, or delete it.",
            code="mapping",
        )
    cure, notes = _choose(diagnosis, wanted, rows, place)
    base = reconstructed_time_base(rows, diagnosis, cure, mapping.time.max_gap_s)
    return Clock(group.name, staying, rows, diagnosis, cure, base, notes)


def _choose(
    diagnosis: StampDiagnosis, wanted: str, rows: Rows, place: str
) -> tuple[Cure, tuple[str, ...]]:
    """Repair of a time base, with notes; DataError if only the user can decide."""
    if diagnosis.state == "even":
        return "none", ()
    if wanted == "none":
        raise FileError(
            f'{place}: time.repair is "none", but the stamps are uneven: {diagnosis.why}.',
            'A recording is uniform to 1 %: choose "late-stamps", "jittered-sampling" or "ask".',
            code="time-base",
        )
    if wanted == "ask" and diagnosis.cure is None:
        raise DataError(
            f"{place}: the stamps are uneven, and the data do not show why: {diagnosis.why}.",
            'Choose with --time-base or time.repair. "late-stamps": a device samples evenly, and a '
            "host writes the time when a sample arrives; the even clock is restored. "
            '"jittered-sampling": the stamps are the true sampling instants, as in a loop on a PC; '
            "the signals are resampled. The wrong choice distorts the signals.",
            code="time-base",
        )
    if wanted == "ask" and diagnosis.cure is not None:
        return diagnosis.cure, ()
    if rows.blocks and wanted == "jittered-sampling":
        raise FileError(
            f"{place}: {diagnosis.why}. Such stamps do not separate samples.",
            'Choose "late-stamps".',
            code="time-base",
        )
    cure: Cure = "late-stamps" if wanted == "late-stamps" else "jittered-sampling"
    against = diagnosis.cure is not None and diagnosis.cure != cure
    return cure, ((f"the data speak against {cure}: {diagnosis.why}",) if against else ())


def _require_plausible(period: float, mapping: Mapping, rig: Rig | None, where: str) -> None:
    """Raise FileError if the unit of the stamps gives a sampling period far from the usual
    period."""
    usual = mapping.time.period_s or (rig.period_s if rig else None)
    if usual is None or 1.0 / FAR_FROM_USUAL < period / usual < FAR_FROM_USUAL:
        return
    stated = mapping.time.unit
    factor = read_unit(stated or "s").factor
    unit_text = f'time.unit is "{stated}"' if stated else "time.unit is not given"
    for name in _TIME_UNITS:
        other = period / factor * read_unit(name).factor
        if 1.0 / NEAR_USUAL < other / usual < NEAR_USUAL:
            raise FileError(
                f'{where}: {unit_text}: samples would be {period:.4g} s apart; in "{name}" '
                f"they would be {other:.4g} s apart, and {usual:g} s are usual.",
                "Correct time.unit. If the period is right, state it in time.period_s.",
                code="time-unit",
            )
    if mapping.time.period_s is not None:
        raise FileError(
            f"{where}: time.period_s is {usual:g}, but samples are {period:.4g} s apart.",
            "Correct period_s or time.unit.",
            code="time-unit",
        )
