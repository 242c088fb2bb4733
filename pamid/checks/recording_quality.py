"""Quality of a recording, as far as it shows before a model is fitted.

    examine(recording, rig)           issues, the worst first: fault, place (s), remedy and numbers
    channel_figures(recording, rig)   step, noise and span of every column

Gaps in the stamps and non-numeric cells are refused by the reader already.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError
from pamid.base.metrics import runs_of
from pamid.base.units import quantity_of, size_to_si, split_column, to_si
from pamid.checks.channel_quality import (
    CHANCE,
    PLUGGED,
    CheckedSignal,
    Mask,
    Places,
    clipping,
    has_noise_around,
    independent,
    interpolated_gaps,
    interval_mask,
    level_issues,
    measurable,
    repeat_chance,
    sampled_slowly,
    shows_only_noise,
    signal_of,
    spikes,
    standstill,
    standstills,
    windows_of,
)
from pamid.checks.findings import QualityIssue, advice, issue, share_words
from pamid.excitation.aprbs import coverage
from pamid.ingest.channel_words import names_command
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps, stands
from pamid.recording.recording import Recording, match_column

__all__ = ["QualityIssue", "channel_figures", "examine"]

FloatArray = NDArray[np.float64]

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
    recording: Recording,
    rig: Rig | None = None,
    signals: Sequence[CheckedSignal] | None = None,
) -> tuple[QualityIssue, ...]:
    """All issues of a recording: wrong ones first, then by the share of the time that they concern.

    Parameters
    ----------
    recording
        Recording to check.
    rig
        Its rig; without a rig, issues that need a model are left out.
    signals
        Result of `signals_of`, if it has been computed already.
    """
    absurd = _absurd(recording)
    if absurd:
        return (absurd,)
    signals = signals_of(recording, rig) if signals is None else signals
    measured = [s for s in signals if not s.sent]
    issues = _constant(recording, signals, rig)
    sent = [s for s in signals if s.sent and s.span > 0.0]
    issues += _held_and_clipped([s for s in measured if s.span > 0.0], sent)
    issues += standstill(measured, sent)
    issues += _levels(measured, sent, rig)
    issues += _pressures(measured) + _temperatures(signals) + _sent(recording, rig)
    if rig is not None:
        against, judged = _rig_issues(recording, rig, thorough=True)
        issues = [f for f in issues if not judged.get(f.kind, set()) & set(f.columns)] + against
        issues += beyond_range(recording, rig)
    return tuple(
        sorted(
            issues, key=lambda issue: (issue.severity != "wrong", -issue.figures.get("share", 1.0))
        )
    )


def blocking(recording: Recording, rig: Rig) -> tuple[QualityIssue, ...]:
    """Issues that make any fit nonsense, and no others, which is quicker."""
    return tuple(issue for issue in before_a_fit(recording, rig) if issue.severity == "wrong")


def before_a_fit(recording: Recording, rig: Rig) -> tuple[QualityIssue, ...]:
    """Issues that make a fit nonsense (wrong), or that it would take for the machine (advice)."""
    from pamid.checks.slips import ORDER

    absurd = _absurd(recording)
    issues = [absurd] if absurd else _rig_issues(recording, rig, thorough=False)[0]
    return tuple(i for i in issues if i.severity == "wrong" or i.kind in ORDER)


def _absurd(recording: Recording) -> QualityIssue | None:
    names = tuple(name for name, values in recording.columns.items() if not measurable(values))
    return (
        issue(
            "range",
            names,
            "wrong",
            f"{', '.join(names)}: no sensor shows numbers of this size",
            "Check how the log was written and read.",
        )
        if names
        else None
    )


def _rig_issues(
    recording: Recording, rig: Rig, thorough: bool
) -> tuple[list[QualityIssue], dict[str, set[str]]]:
    """Issues that need the rig's model, and the columns that it has judged, by kind of issue.

    The judged columns need no guess from their values alone. thorough: include checks that take
    many runs of the model.
    """
    # the engine is needed only here
    from pamid.checks.input_echo import echoed_inputs
    from pamid.checks.rig_consistency import clock, contradictions, idle_input_issues
    from pamid.checks.sheet_comparison import compared_with_sheet

    if issues := clock(recording, rig):
        return issues, {}
    evidence = compared_with_sheet(recording, rig)
    if evidence is not None and (echoes := echoed_inputs(recording, rig, evidence)):
        return echoes, {}  # because wrong signs and units would mislead further checks
    issues, judged = contradictions(recording, rig, evidence, thorough=thorough)
    if thorough and evidence is not None:
        issues += idle_input_issues(recording, rig, evidence)
    return issues, judged


def channel_figures(
    recording: Recording,
    rig: Rig | None = None,
    signals: Sequence[CheckedSignal] | None = None,
) -> dict[str, dict[str, float]]:
    """Per column: span, step (0: none), noise; in the column's unit.

    Parameters
    ----------
    recording, rig, signals
        As in `examine`.
    """
    return {
        s.name: {"span": s.span, "step": s.step, "noise": s.noise}
        for s in (signals_of(recording, rig) if signals is None else signals)
    }


def signals_of(recording: Recording, rig: Rig | None = None) -> list[CheckedSignal]:
    """Every column with its noise and step."""
    sent = sent_columns(recording, rig)
    return [
        signal_of(name, recording.time, values, name in sent)
        for name, values in recording.columns.items()
    ]


def _levels(
    measured: Sequence[CheckedSignal], sent: Sequence[CheckedSignal], rig: Rig | None
) -> list[QualityIssue]:
    """Dead, coarse and noisy channels. If most are dead, the rig rests, and no sensor is faulty."""
    moving = 2 * sum(shows_only_noise(s) for s in measured) < len(measured)
    usual = {} if rig is None else rig.noise
    return [
        issue
        for s in measured
        if s.span > 0.0
        for issue in level_issues(s, moving, usual.get(s.name, 0.0), sent)
    ]


def _constant(
    recording: Recording, signals: Sequence[CheckedSignal], rig: Rig | None
) -> list[QualityIssue]:
    spare = (
        set() if rig is None else {match_column(recording.columns, name) for name in rig.optional}
    )
    issues = []
    # something moves far above its noise; an input is at work
    moving = any(s.span > 20.0 * max(s.noise, s.step, 1e-300) for s in signals)
    driven = any(s.sent and s.span > 0.0 for s in signals)
    for s in signals:
        if s.span == 0.0 and s.name not in spare:
            dead = not s.sent and moving
            hint = PLUGGED if dead else ""
            if s.sent and rig is not None and driven:
                continue
            issues.append(
                advice(
                    "dead" if dead else "constant",
                    s.name,
                    f"{s.name} is constant ({s.values[0]:g}{s.unit}) throughout",
                    hint,
                    {"value": float(s.values[0])},
                )
            )
    return issues


def _nothing_sent(sent: Sequence[CheckedSignal]) -> Mask:
    """Mask of the samples at which all commands are 0, so that the machine may rest."""
    return np.logical_and.reduce([s.values == 0.0 for s in sent]) if sent else np.array(False)


def _held_and_clipped(
    measured: Sequence[CheckedSignal], sent: Sequence[CheckedSignal]
) -> list[QualityIssue]:
    """Causes of standstill: a slow sensor, lost rows, a limit, a dead channel; then bridges and
    spikes.

    While all commands are 0, a standstill is not a fault.
    """
    all_issues: list[QualityIssue] = []
    idle = _nothing_sent(sent)
    slow = {s.name: every for s in measured if (every := sampled_slowly(s)) > 1}
    for every in sorted(set(slow.values())):
        columns = tuple(name for name, n in slow.items() if n == every)
        period = every * float(np.diff(measured[0].time).mean())
        message = (
            f"{', '.join(columns)}: a new value only every {every} samples ({1.0 / period:.4g} "
            "Hz), held between"
        )
        all_issues.append(
            advice(
                "sampled-slowly",
                columns,
                message,
                "Ingest the raw log with the period of its "
                "slowest channel, or leave `period_s` out.",
                {"every_samples": float(every)},
            )
        )
    free = [s for s in measured if s.name not in slow]
    if not free:
        return all_issues
    lively = heapq.nsmallest(2, [*measured, *sent], key=lambda s: s.still_share)
    held = _rows_held(free) & ~idle
    all_issues += _lost_rows(free, held)
    for s in free:
        issues, at_limit = clipping(s, idle)
        stuck, still = standstills(
            s, held | at_limit | idle, next((o for o in lively if o is not s), None)
        )
        all_issues += [*issues, *stuck, *interpolated_gaps(s, held | at_limit | still), *spikes(s)]
    return all_issues


def _rows_held(signals: Sequence[CheckedSignal]) -> Mask:
    """Rows in which every measured channel repeats the row before, although it should not.

    The motion of either then continues with a leap, or the noise of two stops and returns.
    """
    together = np.logical_and.reduce([s.still for s in signals])
    starts, stops = runs_of(together)
    lost = np.logical_or.reduce([_motion_lost(s, starts, stops) for s in signals])
    noisy = [s for s in signals if independent(s, together)]
    if len(noisy) > 1:
        chance = math.prod(repeat_chance(s) for s in noisy)
        for k in np.flatnonzero(~lost & (chance ** (stops - starts) * starts.size < CHANCE)):
            around = sum(has_noise_around(s, int(starts[k]), int(stops[k])) for s in noisy)
            lost[k] = around > 1
    return interval_mask(signals[0].values.size, starts[lost], stops[lost])


def _motion_lost(s: CheckedSignal, starts: Places, stops: Places) -> Mask:
    """True if the first move after each interval equals the motion missed at the pace around it.

    A channel that mostly continues otherwise does not count: a sticking gauge, a slow sensor.
    """
    d = np.diff(s.values)
    resolution = max(s.step, s.grain, MOVES * s.noise if s.white else 0.0, 1e-4 * s.span)
    inside = (starts > PACE) & (stops < s.values.size - PACE)
    first, behind = np.where(inside, starts, PACE + 1), np.where(inside, stops, PACE + 1)
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


def _lost_rows(measured: Sequence[CheckedSignal], held: Mask) -> list[QualityIssue]:
    if not held.any():
        return []
    starts, stops = runs_of(held)
    windows = windows_of(measured[0].time, starts, stops)
    columns = tuple(s.name for s in measured)
    which = "all measured channels" if len(columns) > 1 else columns[0]
    return [
        advice(
            "dropped",
            columns,
            f"{int(held.sum())} samples were lost and filled by repeating the last "
            f"sample in {which}, {share_words(float(held.mean()))}",
            "Check the logger's load and the bus; ingest the raw log without filling, or leave "
            "these stretches out.",
            {
                "samples": float(held.sum()),
                "share": float(held.mean()),
                "longest_samples": float((stops - starts).max()),
            },
            windows,
        )
    ]


# ---- pressures ---------------------------------------------------------------------------------


def _pressures(measured: Sequence[CheckedSignal]) -> list[QualityIssue]:
    """Impossible pressures: another unit, absolute instead of gauge, below vacuum."""
    issues = []
    for s in measured:
        symbol = split_column(s.name)[1]
        if quantity_of(symbol) != "pressure" or shows_only_noise(s):
            continue
        y = np.asarray(to_si(s.values, symbol))
        size = float(np.quantile(np.abs(y), 0.99))
        if float(np.quantile(y, 0.01)) < VACUUM_PA:
            issues.append(
                advice(
                    "pressure",
                    s.name,
                    f"{s.name} falls to {s.values.min():.5g}{s.unit}, below the vacuum",
                    "Is its sign or its unit wrong?",
                    {"low_pa": float(y.min())},
                )
            )
        elif not PRESSURES_PA[0] < size < PRESSURES_PA[1]:
            issues.append(
                advice(
                    "unit",
                    s.name,
                    f"{s.name} reaches {np.abs(s.values).max():.4g}{s.unit}, "
                    "unusual for a pressure that drives something",
                    "Are its values in another unit, such as bar or Pa?",
                    {"size_pa": size},
                )
            )
        else:
            issues += _atmospheric_floor(s, y)
    return issues


def _temperatures(signals: Sequence[CheckedSignal]) -> list[QualityIssue]:
    """Columns in kelvin beyond the temperature of any room or machine."""
    return [
        advice(
            "unit",
            s.name,
            f"{s.name} stays below {COLD_K:g} K, unusual for a machine in a room",
            "Are its values in degrees Celsius?",
            {"high_k": float(s.values.max())},
        )
        for s in signals
        if split_column(s.name)[1] == "K" and 0.0 < float(s.values.max()) < COLD_K
    ]


def _atmospheric_floor(s: CheckedSignal, y: FloatArray) -> list[QualityIssue]:
    """Floor at 1 atmosphere to which the pressure returns repeatedly."""
    floor = float(np.quantile(y, 0.002))
    near = max(2e3, 4.0 * float(size_to_si(s.noise, split_column(s.name)[1])))
    if not VENTED_PA[0] < floor < VENTED_PA[1]:
        return []
    starts, stops = runs_of(y < floor + near)
    long = (stops - starts) * float(np.diff(s.time).mean()) >= 0.2
    if not long.any():
        return []
    return [
        advice(
            "absolute-pressure",
            s.name,
            f"{s.name} rests at {floor / 1e3:.0f} kPa and never falls "
            "below: a vented volume on an absolute sensor",
            "Recordings hold gauge pressures: set pressure = "
            '"absolute" in the mapping of `pamid ingest`.',
            {"floor_kpa": floor / 1e3},
            windows_of(s.time, starts[long], stops[long]),
        )
    ]


# ---- what is sent ------------------------------------------------------------------------------


def _sent(recording: Recording, rig: Rig | None) -> list[QualityIssue]:
    """Findings on too little excitation, or on an excitation that is too short."""
    from pamid.simulation.data_split import shortfall_alone  # the engine is needed only here

    issues = []
    few = shortfall_alone(recording)
    if few:
        hint = "Record for longer, or give several such episodes together: they are pooled."
        figures = {"samples": float(len(recording))}
        issues.append(issue("short", (), "wrong", few, hint, figures))
    for name in _excited_columns(recording, rig):
        issues += _excitation(recording, name, _usual(rig, name))
    commands = [name for name in sent_columns(recording, rig) if name.startswith("command")]
    for name in commands:
        size = np.abs(recording.columns[name])
        at = size >= size.max()
        if np.unique(size).size > FEW_LEVELS and at.mean() > AT_LIMITS:
            issues.append(
                advice(
                    "at-limits",
                    name,
                    f"{name} stands at its limit of {size.max():g} for {at.mean():.0%} of the time",
                    "Lower the gains or ask for less: a command at its "
                    "limit has little information about the rig.",
                    {"share": float(at.mean())},
                    windows_of(recording.time, *runs_of(at)),
                )
            )
    return issues


def _excited_columns(recording: Recording, rig: Rig | None) -> list[str]:
    """Columns that excite the rig: references in a closed loop, commands otherwise."""
    if rig is None:
        references = [n for n in recording.columns if n.startswith("reference")]
        commands = [n for n in recording.columns if n.startswith("command")]
    else:
        references = [
            c
            for loop in rig.loops
            if (c := match_column(recording.columns, loop.reference)) is not None
        ]
        commands = [
            c
            for n in rig.inputs
            if n not in rig.optional and (c := match_column(recording.columns, n)) is not None
        ]
    return references if references and recording.loop != "open" else commands


def _usual(rig: Rig | None, column: str) -> float:
    """Usual amplitude of an excitation, SI; 0 if unknown."""
    if rig is None:
        return 0.0
    return max(
        (
            float(size_to_si(size, split_column(name)[1]))
            for name, size in rig.excited.items()
            if match_column([column], name) is not None
        ),
        default=0.0,
    )


def _excitation(recording: Recording, name: str, usual: float) -> list[QualityIssue]:
    values, period = recording.columns[name], recording.sampling_period_s
    try:
        seen = coverage(values, period)
    except DataError:
        return []  # constant: reported already
    amplitude = 0.5 * float(np.ptp(to_si(values, split_column(name)[1])))
    numbers = {"steps": float(seen.steps), "levels": float(seen.levels), "visited": seen.visited}
    messages = []
    if amplitude < TIMID * usual:
        messages.append(f"moves by only {amplitude / usual:.0%} of what is usual")
    if seen.steps < FEW_STEPS:
        messages.append(f"has only {seen.steps} {'step' if seen.steps == 1 else 'steps'}")
    elif seen.levels <= FEW_LEVELS:
        messages.append(f"has only {seen.levels} levels, which hide what is curved between them")
    starts, stops = runs_of(np.concatenate([[False], np.diff(values) == 0.0]))
    longest = int(np.argmax(stops - starts)) if starts.size else -1
    windows: tuple[tuple[float, float], ...] = ()
    if longest >= 0 and stops[longest] - starts[longest] > IDLE * values.size:
        windows = windows_of(
            recording.time, starts[longest : longest + 1], stops[longest : longest + 1]
        )
        messages.append("does not change for most of the time")
    if not messages:
        return []
    return [
        advice(
            "excitation",
            name,
            f"{name} {' and '.join(messages)}",
            "`pamid generate-aprbs` makes an excitation that covers range and frequencies.",
            numbers,
            windows,
        )
    ]


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
        share = float(out.mean())
        issues.append(
            advice(
                "beyond-range",
                column,
                f"{name} should be within {low:g} .. {high:g} by rig {rig.name!r}, but goes "
                f"from {values.min():.4g} to {values.max():.4g}, outside for {share:.0%} of the "
                "time",
                "Check its unit and its zero; if it really goes there, widen ranges in the rig "
                "file.",
                {"share": share, "low": float(values.min()), "high": float(values.max())},
                windows_of(recording.time, *runs_of(out)),
            )
        )
    return issues


def sent_columns(recording: Recording, rig: Rig | None) -> set[str]:
    """Commanded columns, which may stand still, jump, and sit at their limits.

    They are the inputs and references of the rig, and of other columns those with the name or the
    course of a command. A held signal changes by jumps with standstills between them, and by more
    than a converter's step. A frozen sensor moves from sample to sample in between.
    """
    columns = recording.columns
    if rig is None:
        return {name for name, values in columns.items() if _seems_sent(name, values)}
    sent = {
        match_column(columns, input_) for input_ in (*rig.inputs, *(k.reference for k in rig.loops))
    }
    known = sent | {match_column(columns, output) for output in rig.outputs}
    guessed = {n for n, values in columns.items() if n not in known and _seems_sent(n, values)}
    return guessed | {name for name in sent if name is not None}


def _seems_sent(name: str, values: NDArray[np.float64]) -> bool:
    called = name.startswith(SENT) or names_command(name)
    return called or stands(values) or held_by_jumps(values)
