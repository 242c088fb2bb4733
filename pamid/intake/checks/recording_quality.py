"""Quality of a recording, as far as it shows before a model is fitted.

    examine(recording, rig)        issues, the worst first: fault, place (s), remedy and numbers
    before_a_fit(recording, rig)   those that spoil a fit

Gaps in the stamps and non-numeric cells are refused by the reader already.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np

from pamid.base.errors import DataError, PamidError
from pamid.base.units import quantity_of, size_to_si, split_column, to_si
from pamid.intake.checks.channel_quality import (
    CHANCE,
    PLUGGED,
    CheckedSignal,
    Mask,
    Stretches,
    clipping,
    has_noise_around,
    independent,
    interpolated_gaps,
    level_issues,
    measurable,
    repeat_chance,
    sampled_slowly,
    shows_only_noise,
    signal_of,
    spikes,
    standstill,
    standstills,
)
from pamid.intake.checks.findings import QualityIssue, issue, share_words
from pamid.intake.checks.input_echo import echoed_inputs
from pamid.intake.checks.rig_consistency import clock, contradictions, idle_input_issues
from pamid.intake.checks.sheet_comparison import compared_with_sheet
from pamid.intake.checks.slips import ORDER
from pamid.intake.logs.channel_words import names_command
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps, stands
from pamid.recording.recording import Recording, match_column
from pamid.simulation.data_split import shortfall_alone
from pamid.simulation.excitation.aprbs import coverage

MOVES = 4.2  # times the noise: three standard deviations of the difference of two readings
# lost rows: moves looked at on either side, by what share of their mean each may differ from it,
# resolutions of the channel that are missed at least, and what the first move behind makes up for
PACE, UNSTEADY, LOST_STEPS, MADE_UP = 2, 0.7, 1.5, (0.6, 1.6)
FEW_STEPS, FEW_LEVELS = 10, 2
TIMID = 0.1  # of the usual amplitude
IDLE = 0.5  # of the time without a change of the commands
AT_LIMITS = 0.6  # of the time
RANGE_SLACK = 0.01  # of a stated range: noise of a read-back input
# prefixes of commanded columns, in addition to the words of `names_command`
SENT = ("command", "reference", "setpoint", "external")
VACUUM_PA = -105e3  # gauge: lower pressures do not exist
# reading of an absolute sensor on a vented volume, up to 600 m above sea level
VENTED_PA = (94e3, 106e3)
COLD_K = 200.0  # lower temperatures need a cryostat, or another unit than kelvin
PRESSURES_PA = (1.5e4, 3e7)  # of fluid-driven machines, gauge or absolute


def examine(
    recording: Recording, rig: Rig | None = None, signals: Sequence[CheckedSignal] | None = None
) -> tuple[QualityIssue, ...]:
    """All issues of a recording: wrong ones first, then by the share of the time that they concern.

    rig: its rig; without it, issues that need a model are left out. signals: result of
    `signals_of`, if it has been computed already.
    """
    if absurd := _absurd(recording):
        return tuple(absurd)
    signals = signals_of(recording, rig) if signals is None else signals
    measured = [s for s in signals if not s.sent]
    sent = [s for s in signals if s.sent and s.span > 0.0]
    moving = [s for s in measured if s.span > 0.0]
    issues = _constant(recording, signals, rig)
    issues += _held_and_clipped(moving, sent) + standstill(measured, sent)
    # if most channels are dead, the rig rests, and no sensor is faulty
    alive = 2 * sum(shows_only_noise(s) for s in measured) < len(measured)
    usual = {} if rig is None else rig.noise
    for s in moving:
        issues += level_issues(s, alive, usual.get(s.name, 0.0), sent)
    issues += _pressures(measured)
    issues += [
        issue(
            "unit",
            s.name,
            f"{s.name} stays below {COLD_K:g} K, unusual for a machine in a room",
            "Check its unit: the values may be in degrees Celsius.",
            {"high_k": float(s.values.max())},
        )
        for s in signals
        if split_column(s.name)[1] == "K" and 0.0 < float(s.values.max()) < COLD_K
    ]
    issues += _sent(recording, rig)
    if rig is not None:
        against, judged = _rig_issues(recording, rig, thorough=True)
        issues = [f for f in issues if not judged.get(f.kind, set()) & set(f.columns)] + against
        issues += beyond_range(recording, rig)
    return tuple(
        sorted(issues, key=lambda i: (i.severity != "wrong", -i.figures.get("share", 1.0)))
    )


def before_a_fit(recording: Recording, rig: Rig) -> tuple[QualityIssue, ...]:
    """Issues that make a fit nonsense (wrong), or that it would take for the machine (advice)."""
    issues = _absurd(recording) or _rig_issues(recording, rig, thorough=False)[0]
    return tuple(i for i in issues if i.severity == "wrong" or i.kind in ORDER)


def _absurd(recording: Recording) -> list[QualityIssue]:
    names = tuple(name for name, values in recording.columns.items() if not measurable(values))
    message = f"{', '.join(names)}: the values are too large for any sensor"
    hint = "Check how the log was written and read."
    return [issue("range", names, message, hint, wrong=True)] if names else []


def _rig_issues(
    recording: Recording, rig: Rig, thorough: bool
) -> tuple[list[QualityIssue], dict[str, set[str]]]:
    """Issues that need the rig's model, and the columns that it has judged, by kind of issue.

    The judged columns need no guess from their values alone. thorough: include checks that take
    many runs of the model.
    """
    if issues := clock(recording, rig):
        return issues, {}
    try:
        evidence = compared_with_sheet(recording, rig)
    except PamidError:  # which another finding reports
        return [], {}
    if echoes := echoed_inputs(recording, rig, evidence):
        return echoes, {}  # because wrong signs and units would mislead further checks
    issues, judged = contradictions(recording, rig, evidence, thorough=thorough)
    if thorough:
        issues += idle_input_issues(recording, rig, evidence)
    return issues, judged


def signals_of(recording: Recording, rig: Rig | None = None) -> list[CheckedSignal]:
    """Every column with its noise and step."""
    sent = sent_columns(recording, rig)
    return [
        signal_of(name, recording.time, values, name in sent)
        for name, values in recording.columns.items()
    ]


def _constant(
    recording: Recording, signals: Sequence[CheckedSignal], rig: Rig | None
) -> list[QualityIssue]:
    spare = {match_column(recording.columns, name) for name in (rig.optional if rig else ())}
    issues = []
    # something moves far above its noise; an input is at work
    moving = any(s.span > 20.0 * max(s.noise, s.step, 1e-300) for s in signals)
    driven = any(s.sent and s.span > 0.0 for s in signals)
    for s in signals:
        if s.span or s.name in spare or (s.sent and rig is not None and driven):
            continue
        dead, value = not s.sent and moving, float(s.values[0])
        message = f"{s.name} is constant ({value:g}{s.unit}) throughout"
        kind, hint = ("dead", PLUGGED) if dead else ("constant", "")
        issues.append(issue(kind, s.name, message, hint, {"value": value}))
    return issues


def _held_and_clipped(
    measured: Sequence[CheckedSignal], sent: Sequence[CheckedSignal]
) -> list[QualityIssue]:
    """Causes of standstill: a slow sensor, lost rows, a limit, a dead channel; then bridges and
    spikes.

    While all commands are 0, the machine may rest, and a standstill is not a fault.
    """
    all_issues: list[QualityIssue] = []
    idle = np.logical_and.reduce([s.values == 0.0 for s in sent]) if sent else np.array(False)
    slow = {s.name: every for s in measured if (every := sampled_slowly(s)) > 1}
    for every in sorted(set(slow.values())):
        columns = tuple(name for name, n in slow.items() if n == every)
        period = every * float(np.diff(measured[0].time).mean())
        message = (
            f"{', '.join(columns)}: a new value only every {every} samples ({1.0 / period:.4g} "
            "Hz), held between"
        )
        hint = "Ingest the raw log with the period of its slowest channel, or leave `period_s` out."
        figures = {"every_samples": float(every)}
        all_issues.append(issue("sampled-slowly", columns, message, hint, figures))
    free = [s for s in measured if s.name not in slow]
    if not free:
        return all_issues
    lively = heapq.nsmallest(2, [*measured, *sent], key=lambda s: s.still_share)
    held = _rows_held(free) & ~idle
    if held.any():
        rows, columns = Stretches.of(measured[0].time, held), tuple(s.name for s in free)
        which = "all measured channels" if len(columns) > 1 else columns[0]
        message = (
            f"{int(held.sum())} samples were lost and filled by repeating the last sample in "
            f"{which}, {share_words(float(held.mean()))}"
        )
        hint = (
            "Check the logger's load and the bus; ingest the raw log without filling, or leave "
            "these stretches out."
        )
        figures = {"samples": float(held.sum()), **rows.figures}
        all_issues.append(issue("dropped", columns, message, hint, figures, rows.windows))
    for s in free:
        issues, at_limit = clipping(s, idle)
        other = next((o for o in lively if o is not s), None)
        stuck, still = standstills(s, held | at_limit | idle, other)
        all_issues += [*issues, *stuck, *interpolated_gaps(s, held | at_limit | still), *spikes(s)]
    return all_issues


def _rows_held(signals: Sequence[CheckedSignal]) -> Mask:
    """Rows in which every measured channel repeats the row before, although it should not.

    The motion of either then continues with a leap, or the noise of two stops and returns.
    """
    together = np.logical_and.reduce([s.still for s in signals])
    rows = Stretches.of(signals[0].time, together)
    lost = np.logical_or.reduce([_motion_lost(s, rows) for s in signals])
    noisy = [s for s in signals if independent(s, together)]
    if len(noisy) > 1:
        chance = math.prod(repeat_chance(s) for s in noisy)
        for k in np.flatnonzero(~lost & (chance**rows.lengths * rows.starts.size < CHANCE)):
            first, stop = int(rows.starts[k]), int(rows.stops[k])
            lost[k] = sum(has_noise_around(s, first, stop) for s in noisy) > 1
    return rows.only(lost).mask


def _motion_lost(s: CheckedSignal, rows: Stretches) -> Mask:
    """True if the first move after each interval equals the motion missed at the pace around it.

    A channel that mostly continues otherwise does not count: a sticking gauge, a slow sensor.
    """
    d = np.diff(s.values)
    resolution = max(s.step, s.grain, MOVES * s.noise if s.white else 0.0, 1e-4 * s.span)
    inside = (rows.starts > PACE) & (rows.stops < s.values.size - PACE)
    first = np.where(inside, rows.starts, PACE + 1)
    behind = np.where(inside, rows.stops, PACE + 1)
    # stretch a..b repeats value a - 1: d[a - 2] is the last move before it, d[b - 1] the first
    # behind it
    before = np.stack([d[first - 2 - k] for k in range(PACE)])
    after = np.stack([d[behind + k] for k in range(PACE)])
    around = np.concatenate([before, after])
    pace, missed = around.mean(axis=0), behind - first + 1
    onward = before.mean(axis=0) * after.mean(axis=0) > 0.0
    moving = inside & onward & (np.abs(pace) * missed > LOST_STEPS * resolution)
    steady = (np.abs(around - pace) <= UNSTEADY * np.abs(pace)).all(axis=0)
    ratio = d[behind - 1] / np.where(moving, pace * missed, 1.0)
    makes_up = moving & steady & (ratio > MADE_UP[0]) & (ratio < MADE_UP[1])
    travel = np.where(moving, np.abs(pace * missed), 0.0)
    return makes_up & (2.0 * travel[makes_up].sum() > travel.sum())


def _pressures(measured: Sequence[CheckedSignal]) -> list[QualityIssue]:
    """Impossible pressures: another unit, below vacuum, and absolute instead of gauge.

    An absolute sensor on a vented volume returns repeatedly to a floor at 1 atmosphere.
    """
    issues = []
    for s in measured:
        symbol = split_column(s.name)[1]
        if quantity_of(symbol) != "pressure" or shows_only_noise(s):
            continue
        y = np.asarray(to_si(s.values, symbol))
        size = float(np.quantile(np.abs(y), 0.99))
        if float(np.quantile(y, 0.01)) < VACUUM_PA:
            message = f"{s.name} falls to {s.values.min():.5g}{s.unit}, below the vacuum"
            hint, low = "Check its sign and its unit.", {"low_pa": float(y.min())}
            issues.append(issue("pressure", s.name, message, hint, low))
        elif not PRESSURES_PA[0] < size < PRESSURES_PA[1]:
            message = (
                f"{s.name} reaches {np.abs(s.values).max():.4g}{s.unit}, unusual for a "
                "driving pressure"
            )
            hint = "Check its unit: the values may be in bar or Pa."
            issues.append(issue("unit", s.name, message, hint, {"size_pa": size}))
        else:
            floor = float(np.quantile(y, 0.002))
            near = max(2e3, 4.0 * float(size_to_si(s.noise, symbol)))
            rests = Stretches.of(s.time, y < floor + near)
            rests = rests.only(rests.lengths * float(np.diff(s.time).mean()) >= 0.2)
            if VENTED_PA[0] < floor < VENTED_PA[1] and rests.starts.size:
                message = (
                    f"{s.name} rests at {floor / 1e3:.0f} kPa and never falls below: a vented "
                    "volume on an absolute sensor"
                )
                hint = (
                    'Recordings hold gauge pressures: set pressure = "absolute" in the mapping of '
                    "`pamid ingest`."
                )
                kpa, windows = {"floor_kpa": floor / 1e3}, rests.windows
                issues.append(issue("absolute-pressure", s.name, message, hint, kpa, windows))
    return issues


# ---- what is sent ------------------------------------------------------------------------------


def _sent(recording: Recording, rig: Rig | None) -> list[QualityIssue]:
    """Findings on too little excitation, or on an excitation that is too short."""
    issues = []
    if few := shortfall_alone(recording):
        hint = "Record for longer, or give several such episodes together: they are pooled."
        figures = {"samples": float(len(recording))}
        issues.append(issue("short", (), few, hint, figures, wrong=True))
    # references excite the rig in a closed loop, commands otherwise
    if rig is None:
        references = [n for n in recording.columns if n.startswith("reference")]
        commands = [n for n in recording.columns if n.startswith("command")]
    else:
        needed = [n for n in rig.inputs if n not in rig.optional]
        references, commands = (
            [c for n in names if (c := match_column(recording.columns, n)) is not None]
            for names in ([loop.reference for loop in rig.loops], needed)
        )
    for name in references if references and recording.loop != "open" else commands:
        issues += _excitation(recording, name, rig)
    for name in sent_columns(recording, rig):
        size = np.abs(recording.columns[name])
        at = size >= size.max()
        if (
            name.startswith("command")
            and np.unique(size).size > FEW_LEVELS
            and at.mean() > AT_LIMITS
        ):
            message = f"{name} is at its limit of {size.max():g} for {at.mean():.0%} of the time"
            hint = "Reduce the gains or the reference: a saturated command excites the rig little."
            windows = Stretches.of(recording.time, at).windows
            share = {"share": float(at.mean())}
            issues.append(issue("at-limits", name, message, hint, share, windows))
    return issues


def _excitation(recording: Recording, name: str, rig: Rig | None) -> list[QualityIssue]:
    values, period = recording.columns[name], recording.sampling_period_s
    try:
        seen = coverage(values, period)
    except DataError:
        return []  # constant: reported already
    amplitude = 0.5 * float(np.ptp(to_si(values, split_column(name)[1])))
    usual = max(  # SI; 0 if unknown
        (
            float(size_to_si(size, split_column(column)[1]))
            for column, size in (rig.excited if rig else {}).items()
            if match_column([name], column) is not None
        ),
        default=0.0,
    )
    messages = []
    if amplitude < TIMID * usual:
        messages.append(f"moves by only {amplitude / usual:.0%} of the usual range")
    if seen.steps < FEW_STEPS:
        messages.append(f"has only {seen.steps} {'step' if seen.steps == 1 else 'steps'}")
    elif seen.levels <= FEW_LEVELS:
        messages.append(f"has only {seen.levels} levels, which hide a curvature between them")
    rests = Stretches.of(recording.time, np.concatenate([[False], np.diff(values) == 0.0]))
    longest = rests.only(rests.lengths == rests.lengths.max(initial=0)).only(slice(1))
    windows: tuple[tuple[float, float], ...] = ()
    if longest.lengths.sum() > IDLE * values.size:
        windows = longest.windows
        messages.append("does not change for most of the time")
    if not messages:
        return []
    message = f"{name} {' and '.join(messages)}"
    hint = "`pamid generate-aprbs` makes an excitation that covers range and frequencies."
    numbers = {"steps": float(seen.steps), "levels": float(seen.levels), "visited": seen.visited}
    return [issue("excitation", name, message, hint, numbers, windows)]


def beyond_range(recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Findings on inputs beyond the range that the rig states."""
    issues = []
    for name, (low, high) in rig.ranges.items():
        column = match_column(recording.columns, name)
        if column is None:
            continue
        values, slack = recording.signal(name), RANGE_SLACK * (high - low)
        out = (values < low - slack) | (values > high + slack)
        if not out.any():
            continue
        share, least, most = float(out.mean()), float(values.min()), float(values.max())
        message = (
            f"{name} should be within {low:g} .. {high:g} by rig {rig.name!r}, but goes from "
            f"{least:.4g} to {most:.4g}, outside for {share:.0%} of the time"
        )
        hint = "Check its unit and its zero; if it really goes there, widen ranges in the rig file."
        figures = {"share": share, "low": least, "high": most}
        windows = Stretches.of(recording.time, out).windows
        issues.append(issue("beyond-range", column, message, hint, figures, windows))
    return issues


def sent_columns(recording: Recording, rig: Rig | None) -> set[str]:
    """Commanded columns, which may stand still, jump, and sit at their limits.

    They are the inputs and references of the rig, and of other columns those with the name or the
    course of a command.
    """
    columns = recording.columns
    inputs = () if rig is None else (*rig.inputs, *(loop.reference for loop in rig.loops))
    sent = {match_column(columns, name) for name in inputs}
    known = sent | {match_column(columns, name) for name in (rig.outputs if rig else ())}
    guessed = {
        name
        for name, values in columns.items()
        if name not in known
        and (
            name.startswith(SENT) or names_command(name) or stands(values) or held_by_jumps(values)
        )
    }
    return guessed | {name for name in sent if name is not None}
