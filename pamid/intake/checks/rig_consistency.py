"""Findings about a recording that need the model of its rig.

They are a clock that does not count seconds, exchanged columns, an opposite sign, another unit, and
channels that are dead, late, or not explained by the rig at all.

    finding              statistic and threshold
    clock                period beyond FAR_CLOCK of that of the rig
    unit, sign, exchanged, absolute-pressure, offset, gain, far-off, clock of a rig that states no
    period
                         the slip that explains the recording best: see `slips`
    delay                lag of the largest cross-correlation of the rates, at least LATE_SAMPLES
                         and LATE correlation times of the recording, that raises the correlation
                         by LAG_GAIN
    dead                 constant, where the model moves by LIVELY times the noise
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import join_words
from pamid.base.metrics import motion
from pamid.base.units import (
    duration_text,
    from_si,
    is_unit,
    quantity_of,
    split_column,
    unit,
    with_unit,
)
from pamid.intake.checks.channel_quality import PLUGGED
from pamid.intake.checks.findings import QualityIssue, issue, unit_after
from pamid.intake.checks.sheet_comparison import (
    SheetComparison,
    magnitude_sensor_signs,
    recorded_columns,
    shapes,
)
from pamid.intake.checks.short_fit import RUNAWAY, Judgement, fit_data_of
from pamid.intake.checks.slips import (
    CLOCKS,
    MOST_NAMED_SLIPS,
    UNEXPLAINED_MOTION,
    UNNAMED,
    Explanation,
    Slip,
    find_slips,
)
from pamid.model.rig import Rig
from pamid.model.sampling import stated_period
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.input_effects import IDLE_CURE, idle_text, input_effects
from pamid.simulation.tracks import stated_noise

FAR_CLOCK = 20.0  # ratio to the period of the rig from which the clock is wrong
# factor to which a clock is recognised by the period alone: prefixes, other units
NEAR_CLOCK = {True: 20.0, False: 3.0}
COMPARABLE_CORRELATION = 0.85  # correlation from which delays are compared
STIR = 2.0  # times its noise: a channel that moves less in the model, too, is at rest
LIVELY = 20.0  # times its noise and print: a model that moves this much is not at rest
LEAST_MOTION = 2.0  # times its noise: smallest visible motion
# samples: rates are compared, since they show more sharply when something happens
RATE_OVER = 8
LATE_SAMPLES = 3
# correlation times of the recording: what counts as late, and how far is looked
LATE, LONGEST_LAG = 0.008, 0.5
SHIFT_FITS = 0.9  # of the error of a short fit: a shift that leaves less is a clock offset
LAG_GAIN = 0.005  # smallest gain of correlation by a delay


def contradictions(
    recording: Recording, rig: Rig, evidence: SheetComparison, *, thorough: bool
) -> tuple[list[QualityIssue], dict[str, set[str]]]:
    """Issues in which the recording contradicts the rig.

    evidence: comparison with the data sheet's run.
    thorough: also try slips of the data sheet, and look for channels that the rig does not explain.
    Returns issues; and by kind of issue the columns that the rig has judged, which need no guess
    from their values alone.
    """
    slips, recording_, e, judgement = find_slips(recording, evidence, thorough=thorough)
    clocks = [explanation for explanation in slips if explanation.slip.kind == "clock"]
    if clocks:
        factor = clocks[0].slip.factor
        text = f"which does not match the dynamics of rig {rig.name!r}"
        return [_clock_issue(recording, text, CLOCKS[factor], 1.0 / factor)], {}
    named = [explanation for explanation in slips if explanation.slip.kind not in UNNAMED]
    issues = _slip_issues(named, evidence, rig)
    factors = [explanation for explanation in slips if explanation.slip.kind in UNNAMED]
    if thorough and not any(i.severity == "wrong" for i in issues):
        issues += _unexplained_channels(factors, judgement, recording_, e, rig)
    if not e.ran:
        return issues, {}
    noise = np.maximum(noise_level(e.y), stated_noise(rig, e.names))
    columns = np.array(recorded_columns(e.names, recording))
    suits = set(columns[e.agreement() > COMPARABLE_CORRELATION].tolist())
    rests = set(columns[e.model.std(axis=0) < STIR * noise].tolist())
    dead = dead_sensors(recording, rig, e)
    judged = dict.fromkeys(("unit", "pressure", "absolute-pressure"), suits)
    judged["dead"] = rests | {i.columns[0] for i in dead}
    return issues + _delays(e, recording, rig) + dead, judged


# ---- clock ---------------------------------------------------------------------------------------


def clock(recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Finding on stamps whose period is far from that of the rig."""
    period, usual = recording.sampling_period_s, stated_period(rig)
    if usual is None or 1.0 / FAR_CLOCK < period / usual < FAR_CLOCK:
        return []
    ratio = period / usual
    near = min(CLOCKS, key=lambda c: abs(np.log(ratio * c)))
    wide = NEAR_CLOCK[near < 1.0]
    looks = CLOCKS[near] if 1.0 / wide < ratio * near < wide else ""
    counted = period == 1.0 and bool(np.all(recording.time == np.round(recording.time)))
    if counted and not 0.5 < ratio * near < 2.0:
        looks = "a count of samples: multiply them by the period"
    text = f"where rig {rig.name!r} is sampled every {usual:g} s"
    return [_clock_issue(recording, text, looks, ratio)]


def _clock_issue(recording: Recording, text: str, looks: str, ratio: float) -> QualityIssue:
    period = recording.sampling_period_s
    message = f"samples are {period:g} s apart, {text}"
    hint = f"The stamps look like {looks}." if looks else "Are the stamps seconds?"
    figures = {"period_s": period, "ratio": ratio}
    return issue("clock", "time_s", message, hint, figures, wrong=True)


# ---- slips ---------------------------------------------------------------------------------------


def _slip_issues(
    slips: Sequence[Explanation], before: SheetComparison, rig: Rig
) -> list[QualityIssue]:
    """A finding for each slip; columns in the same other unit share a finding."""
    groups: dict[tuple[str, ...], list[Explanation]] = {}
    for k, explanation in enumerate(slips):
        slip = explanation.slip
        same = (slip.kind, slip.meaning, *sorted({split_column(name)[1] for name in slip.names}))
        joined = slip.kind in ("unit", "absolute-pressure")
        groups.setdefault(same if joined else (str(k),), []).append(explanation)
    issues = []
    for group in groups.values():
        first = max(group, key=lambda member: member.gain)
        slip, names = first.slip, tuple(name for member in group for name in member.slip.names)
        message, hint = _slip_words(slip, names, before.names, rig)
        figures = first.figures
        rivals = [o for o in first.others if (o.kind, o.names) != ("scale", slip.names)]
        others = [other.words for other in rivals][:MOST_NAMED_SLIPS]
        if others and slip.kind in ("unit", "offset", "gain"):
            hint += f" Or {', or '.join(others)} explains it as well."
        evidence = f"after the correction rig {rig.name!r} fits the recording better"
        if first.wrong:
            evidence = (
                f"a fit of rig {rig.name!r} has an error of {figures['error_as_recorded']:.2g} "
                f"times the motion, {figures['error_mended']:.2g} times after the correction"
            )
        bend = figures["tolerances_as_recorded"]
        if bend > max(3.0, 2.0 * figures["tolerances_mended"]):
            evidence += (
                "; without the correction the parameters deviate from the data sheet by "
                f"{bend:.2g} tolerances"
            )
        text = f"{message}: {evidence}"
        issues.append(issue(slip.kind, names, text, hint, figures, wrong=first.wrong))
    return issues


def _slip_words(
    slip: Slip, names: tuple[str, ...], outputs: Sequence[str], rig: Rig
) -> tuple[str, str]:
    """Fault and remedy of a slip of these columns."""
    symbol, many = split_column(names[0])[1], join_words(names)
    shift = slip.offset / unit(symbol).factor
    shown = f"{-shift:.4g}{unit_after(names[0])}"
    mapping, exceptional = "the mapping of `pamid ingest`", f"; if rig {rig.name!r} really is"
    if slip.kind == "unit" and slip.geared:
        return (
            f"{many} {'seems' if len(names) == 1 else 'seem'} to be {slip.meaning}",
            f"Multiply by {slip.factor:g}, or let rig {rig.name!r} measure it there.",
        )
    if slip.kind == "unit":
        looks = f"the values of {many} look like {slip.meaning}, not {symbol}"
        if slip.meaning == "percent":
            return looks, f'Divide by 100: unit = "percent" in {mapping}.'
        named = [
            f"{n} to {with_unit(split_column(n)[0], slip.meaning)}"
            for n in names
            if is_unit(slip.meaning)
        ]
        rename = f"Rename {join_words(named)}, or set" if named else "Set"
        return looks, f'{rename} unit = "{slip.meaning}" in {mapping}.'
    if slip.kind == "sign":
        lone = len(outputs) == 1 and names[0] not in outputs
        other = f" (or that of {outputs[0]})" if lone else ""
        entry = f"sign = -1 and offset = {shift:.4g}" if slip.offset else "sign = -1"
        offset = f" and is then offset by {shown} against rig {rig.name!r}" if slip.offset else ""
        return (
            f"{names[0]} has the opposite sign{other}{offset}",
            f"Turn its sign, or set {entry} for it in {mapping}{exceptional} built so, change the "
            "rig file.",
        )
    if slip.kind == "exchanged":
        return (
            f"{names[0]} and {names[1]} are exchanged",
            f"Exchange the two columns in {mapping}{exceptional} plugged so, change the rig file.",
        )
    if slip.kind == "absolute-pressure":
        sheet = [p for p in rig.parameters if not p.fitted and quantity_of(p.unit) == "pressure"]
        stated = join_words(p.outside_name for p in sheet)
        gauge = f"; if they are gauge pressures, state {stated} under [known]" if sheet else ""
        return (
            f"{many} {'lies' if len(names) == 1 else 'lie'} about 1 atmosphere too high, as "
            "absolute pressures do",
            f'Set pressure = "absolute" in {mapping}{gauge}.',
        )
    if slip.kind == "offset":
        return (
            f"{names[0]} is offset by {shown} against rig {rig.name!r}",
            f"Zero it, or set offset = {shift:.4g} for it in {mapping}; else a constant is missing "
            f"from rig {rig.name!r}.",
        )
    others = join_words(c for c in outputs if c not in names)
    return (
        f"{names[0]} is {1.0 / slip.factor:.2g} times the value that rig {rig.name!r} predicts "
        f"from {others}",
        f"Multiply its scale in {mapping} by {slip.factor:.4g}, or correct the ratio in rig "
        f"{rig.name!r}.{slip.cause_words}",
    )


def _unexplained_channels(
    factors: Sequence[Explanation],
    judgement: Judgement,
    recording: Recording,
    e: SheetComparison,
    rig: Rig,
) -> list[QualityIssue]:
    """Factors that reconcile recording and rig, but are not another unit.

    Also channels that the data sheet misses by more than they move, and that a refit does not
    explain.
    """
    if not e.ran and not factors:
        return []
    moves = e.y.std(axis=0) > LEAST_MOTION * noise_level(e.y)
    missed = _relative_errors(e)
    left = np.array([judgement.errors.get(name, 0.0) for name in e.names])
    signs = magnitude_sensor_signs(e.y, e.model) if e.ran else np.zeros(len(e.names))
    unlike = (signs != 0.0) | (left > UNEXPLAINED_MOTION)
    lost = np.flatnonzero(moves & (missed > 1.0) & unlike).tolist()
    if not factors and not lost:
        return []
    columns = recorded_columns(e.names, recording)
    size = np.log(np.maximum(e.model.std(axis=0), 1e-300) / np.maximum(e.y.std(axis=0), 1e-300))
    shown = sorted(lost, key=lambda k: -missed[k]) or [int(np.argmax(np.abs(size)))]
    k = shown[0]
    miss = f"has an error of {missed[k]:.2g} times the motion"
    if missed[k] >= RUNAWAY:
        miss = "runs away"
    elif missed[k] <= 1.0:
        miss = f"predicts a motion {np.exp(size[k]):.2g} times as large"
    text = f"{columns[k]}: the data sheet of rig {rig.name!r} {miss}"
    if lost and left[k] > UNEXPLAINED_MOTION:
        text += f", and a refit has an error of {left[k]:.2g} times the motion"
    # corrections of the same column or parameter stand together
    slips = [slip for factor in factors for slip in (factor.slip, *factor.others)]
    order = [slip.names for slip in slips]
    parts = [
        " or ".join([first.words, *(slip.factor_words for slip in more)])
        for _, (first, *more) in groupby(
            sorted(slips, key=lambda slip: order.index(slip.names)),
            key=lambda slip: (slip.kind in UNNAMED, slip.names),
        )
    ][:MOST_NAMED_SLIPS]
    named = f": {', or '.join(parts)} would remove the difference" if parts else ""
    hint = f"Check units and signs{named}."
    if signs[k]:
        side = "below" if signs[k] > 0.0 else "above"
        hint += (
            f" {columns[k]} never goes {side} 0, but the model does: "
            "check whether its sensor measures only the magnitude."
        )
    names = tuple(columns[i] for i in shown)
    return [issue("far-off", names, text, hint, {"error": float(missed[k])})]


def _relative_errors(e: SheetComparison) -> Array:
    """Per output, error of the data sheet's run relative to the recorded motion.

    It is the smaller error of that of the shapes and that of the values.
    """
    if not e.ran:
        return np.full(len(e.names), RUNAWAY)
    ours, theirs = shapes(e.y), shapes(e.model)
    with np.errstate(over="ignore"):
        off = [np.sqrt(((ours - theirs) ** 2).mean(axis=(1, 2))), (e.y - e.model) ** 2]
        size = [np.sqrt((ours * ours).mean(axis=(1, 2))), e.y.std(axis=0)]
    off[1] = np.sqrt(off[1].mean(axis=0))
    shares = [
        o / np.maximum(np.maximum(s, o / RUNAWAY), 1e-300) for o, s in zip(off, size, strict=True)
    ]
    return np.minimum(np.minimum(*shares), RUNAWAY)


# ---- dead and late ------------------------------------------------------------------------------


def dead_sensors(recording: Recording, rig: Rig, e: SheetComparison) -> list[QualityIssue]:
    """Findings on sensors that read the same number throughout, although the machine moves them."""
    still = np.array([motion(y) == 0.0 for y in e.y.T])
    if not e.ran or still.all():
        return []
    issues = []
    for k, column in enumerate(recorded_columns(e.names, recording)):
        values, name = recording.columns[column], e.names[k]
        moves = float(np.ptp(from_si(e.model[:, k], split_column(name)[1])))
        if still[k] and motion(values) == 0.0 and moves > LIVELY * rig.noise.get(name, 0.0):
            value = float(values[0])
            message = (
                f"{column} is constant ({value:g}{unit_after(column)}) throughout, where the model "
                f"of rig {rig.name!r} moves"
            )
            hint = f"{PLUGGED} Leave the column out if it was not measured."
            issues.append(issue("dead", column, message, hint, {"value": value}, wrong=True))
    return issues


def _delays(e: SheetComparison, recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Findings on channels that respond earlier or later than the data sheet's model.

    There are none if no input moves. A released machine responds to nothing, and a wrong period
    looks like a delay.
    """
    if not np.ptp(e.u, axis=0).any():
        return []
    period = recording.sampling_period_s
    timescale_s = rig.timescale_s or timescale_of([(e.y, noise_level(e.y), period)])
    most = max(LATE_SAMPLES, round(LONGEST_LAG * timescale_s / period))
    late: dict[int, list[str]] = {}
    for name, ours, theirs in zip(e.names, e.y.T, e.model.T, strict=True):
        lag, at_once, shifted = _lag(ours, theirs, most)
        if (
            abs(lag) >= LATE_SAMPLES
            and abs(lag) * period >= LATE * timescale_s
            and shifted > COMPARABLE_CORRELATION
            and shifted - at_once > max(LAG_GAIN, 0.5 * (1.0 - shifted))
        ):
            late.setdefault(lag, []).append(name)
    issues = []
    for lag, names in sorted(late.items()):
        if lag < 0 and not _fits_better_later(recording, rig, names, -lag):
            continue
        columns, delay = recorded_columns(names, recording), lag * period
        many = "responds" if len(columns) == 1 else "respond"
        hint = (
            "Wrong data-sheet values also shift a response: state known values below [known]. "
            "`pamid diagnose` finds a dead time or a lag. If clocks differ, shift the channel in "
            "the raw log."
            if lag > 0
            else "No rig responds before its command: shift the channel, or the command, in the "
            "raw log."
        )
        message = (
            f"{join_words(columns)} {many} {duration_text(abs(delay))} "
            f"{'after' if lag > 0 else 'before'} the data sheet's model of rig {rig.name!r}"
        )
        issues.append(issue("delay", columns, message, hint, {"delay_s": delay}))
    return issues


def _fits_better_later(recording: Recording, rig: Rig, names: Sequence[str], samples: int) -> bool:
    """True if the rig fits these outputs better after a shift by some samples.

    Friction or damping that the data sheet lacks shifts its run, too. A fit of short windows with
    separate start states has no time to fall behind. With too few windows the result is True.
    """
    data = fit_data_of(recording, rig)
    if data is None:
        return True
    return data.shifted(names, samples).fitted(rig).error < SHIFT_FITS * data.fitted(rig).error


def _lag(ours: Array, theirs: Array, most: int) -> tuple[int, float, float]:
    """Delay in samples, with the correlation of the rates without and with this shift."""
    # sum_t a(t + lag) b(t) for all lags at once, by Fourier transforms padded by the longest lag;
    # each is divided by the energies in its overlap, so that a long lag is at no disadvantage
    a, b = ((rate := y[RATE_OVER:] - y[:-RATE_OVER]) - rate.mean() for y in (ours, theirs))
    most = min(most, a.size // 4)
    size = a.size + most
    product = np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b, size).conj(), size)
    lags = np.arange(-most, most + 1)
    to_a, to_b = (np.concatenate([[0.0], np.cumsum(z * z)]) for z in (a, b))
    first, last = np.maximum(lags, 0), a.size + np.minimum(lags, 0)
    overlap = (to_a[last] - to_a[first]) * (to_b[last - lags] - to_b[first - lags])
    likeness = product[lags] / np.sqrt(np.maximum(overlap, 1e-300))
    best = int(np.argmax(likeness))
    return int(lags[best]), float(likeness[most]), float(likeness[best])


def idle_input_issues(recording: Recording, rig: Rig, e: SheetComparison) -> list[QualityIssue]:
    """Findings on inputs that move in the recording, but whose term has no effect."""
    noise = np.maximum(noise_level(e.y), stated_noise(rig, e.names))
    issues = []
    for name, change in input_effects(
        e.simulate, e.u, e.inputs, e.model if e.ran else None
    ).items():
        values = e.u[:, e.inputs.index(name)]
        if text := idle_text(name, values, change, e.names, noise):
            symbol = split_column(name)[1]
            low, high = (float(from_si(x, symbol)) for x in (values.min(), values.max()))
            message = f"in the data sheet's model of rig {rig.name!r} {text}"
            figures = {"low": low, "high": high, "most_of_noise": float((change / noise).max())}
            columns = recorded_columns((name,), recording)
            issues.append(issue("idle-input", columns, message, IDLE_CURE, figures))
    return issues
