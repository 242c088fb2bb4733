"""What a recording claims that its rig contradicts: columns exchanged, signs turned, units
mistaken, channels late.

The recording is compared with the data sheet's model, run on the recorded commands. That model is
off by a lot, but not in its signs: shapes are compared (correlation, block by block without level
and trend), never sizes, except for units, where a factor of 6 and more is needed. Two like channels
are distinguished by their difference, whose sign an exchange turns.

    finding            statistic and threshold
    sign, exchanged    a correlation below CONTRARY, and a change that raises the sum of all
                       correlations by CORRELATION_GAIN
    unit               least-squares gain sum(y m)/sum(m^2) of a channel beyond WRONG_UNIT and
                       within NEAR_UNIT of the ratio of two units, correlation above
                       COMPARABLE_CORRELATION
    absolute-pressure  median of y - m within ATMOSPHERE_RANGE_PA
    delay              lag of the largest cross-correlation of the rates, at least LATE_SAMPLES and
                       LATE correlation times of the recording, that raises the correlation by
                       LAG_GAIN
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.base.units import duration_text, quantity_of, split_column, suffixes_for, unit, with_unit
from pamid.checks.channel_quality import QualityIssue
from pamid.checks.likeness import blind_sides, correlation, shapes
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording, match_column
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.free_runs import (
    choose_stepping,
    free_run,
    input_table,
    known_values,
    measured_outputs,
    output_table,
)
from pamid.simulation.tracks import stated_noise

Array = NDArray[np.float64]

MOST_COMPARED_SAMPLES = 20000
CONTRARY = -0.5  # correlation below which a sign is looked at
CORRELATION_GAIN = 1.0  # by which the sum of all correlations must grow
COMPARABLE_CORRELATION = 0.85  # correlation from which sizes and delays are compared
WRONG_UNIT, NEAR_UNIT = 6.0, 1.7  # factors: surely another unit, and that unit
ATMOSPHERE_RANGE_PA = (80e3, 125e3)  # by which absolute pressures lie above gauge
STIR = 2.0  # times its noise: what stirs less in the model, too, is at rest
# samples: rates are compared, since they show more sharply when something happens
RATE_OVER = 8
LATE_SAMPLES = 3
# correlation times of the recording: what counts as late, and how far is looked
LATE, LONGEST_LAG = 0.008, 0.5
LAG_GAIN = 0.005  # by which a delay must raise the correlation


@dataclass(frozen=True, eq=False)
class SheetComparison:
    """A recording beside the data sheet's run on its commands; SI.

    names, inputs: the rig's outputs and inputs; y, u: as measured (samples x these); model: outputs
    of the run (NaN where it ran away); simulate: outputs at other inputs, other parameters
    (default: p) and a clock that runs so many times slower, None where they run away.
    """

    names: tuple[str, ...]
    inputs: tuple[str, ...]
    y: Array
    u: Array
    model: Array
    simulate: Callable[..., Array | None]
    assembly: Assembly
    p: Array

    @property
    def ran(self) -> bool:
        return bool(np.isfinite(self.model).all())

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Places of like outputs."""
        return _like(self.names)

    def agreement(self) -> tuple[Array, Array]:
        """Correlations of every output with the model, and of the differences of like outputs; of
        what a sensor shows that is blind to the sign, with the model's size."""
        way = blind_sides(self.y, self.model)
        shown = np.where(way == 0.0, self.model, way * np.abs(self.model))
        ours, theirs = shapes(self.y), shapes(shown)
        single = np.array([correlation(a, b) for a, b in zip(ours, theirs, strict=True)])
        double = np.array(
            [correlation(ours[i] - ours[j], theirs[i] - theirs[j]) for i, j in self.pairs]
        )
        return single, double

    @property
    def score(self) -> float:
        return float(sum(part.sum() for part in self.agreement()))


@dataclass(frozen=True, eq=False)
class Change:
    """Something to be set right: what, in which columns, and the evidence as it then is."""

    kind: str
    columns: tuple[str, ...]
    after: SheetComparison


def contradictions(
    recording: Recording, rig: Rig, evidence: SheetComparison | None
) -> tuple[list[QualityIssue], dict[str, set[str]], SheetComparison | None]:
    """Everything in which the recording contradicts the rig; per kind of issue the columns in which
    the rig has judged, so that it need not be guessed from the values alone; and the evidence with
    all contradictions set right. Where the rig cannot be run on the recording, only what is in
    percent is found."""
    found = _percent(recording, rig)
    if evidence is None or not evidence.ran:
        return found, {}, None
    for _ in range(4):
        change = _best_change(evidence)
        if change is None:
            break
        found.append(_issue_of(change, evidence, recording, rig))
        evidence = change.after
    mended, units = _units(evidence, recording, rig)
    columns = recorded_as(mended.names, recording)
    judged = {
        c
        for c, alike in zip(columns, mended.agreement()[0], strict=True)
        if alike > COMPARABLE_CORRELATION
    }
    noise = np.maximum(noise_level(mended.y), stated_noise(rig, mended.names))
    resting = {
        c
        for c, still in zip(columns, mended.model.std(axis=0) < STIR * noise, strict=True)
        if still
    }
    judged_by_kind = {
        "unit": judged,
        "pressure": judged,
        "absolute-pressure": judged,
        "dead": resting,
    }
    return (
        found + units + _offsets(mended, recording, rig) + _delays(mended, recording, rig),
        judged_by_kind,
        mended,
    )


def compared_with_sheet(recording: Recording, rig: Rig) -> SheetComparison | None:
    """The recording beside the data sheet's run; None where the rig cannot be run on it, which is
    said elsewhere."""
    try:
        return _evidence(recording, rig)
    except PamidError:
        return None


def _evidence(recording: Recording, rig: Rig) -> SheetComparison | None:
    assembly = Assembly(rig)
    names = measured_outputs(assembly, recording)
    assembly = Assembly(rig, outputs=names)
    p, _ = known_values(
        assembly,
        {k: v for k, v in recording.known.items() if assembly.knows(k)},
    )
    u, y = (
        input_table(assembly, recording)[:MOST_COMPARED_SAMPLES],
        output_table(names, recording)[:MOST_COMPARED_SAMPLES],
    )
    order = [assembly.program.outputs.index(n) for n in names]
    period = recording.sampling_period_s

    # hundreds of runs may follow: of what steps by itself the exchanges are chosen once
    stepped = isinstance(rig, StepRig)
    steps = choose_stepping(assembly, u, p, period, assembly.start(p)) if stepped else None

    def simulate(inputs: Array, values: Array = p, clock: float = 1.0) -> Array | None:
        run = free_run(
            assembly,
            np.ascontiguousarray(inputs),
            values,
            clock * period,
            stepping=steps if clock == 1.0 else None,
        )
        return (
            None
            if run.blown_up >= 0 or not np.isfinite(run.outputs).all()
            else run.outputs[:, order]
        )

    found = simulate(u)
    model = np.full_like(y, np.nan) if found is None else found
    return SheetComparison(names, tuple(assembly.traced.inputs), y, u, model, simulate, assembly, p)


# ---- signs and exchanges -----------------------------------------------------------------------


def _best_change(evidence: SheetComparison) -> Change | None:
    """The one change that makes recording and model agree best, if something runs clearly against
    the model."""
    single, double = evidence.agreement()
    if min(single.min(), double.min(initial=1.0)) > CONTRARY:
        return None
    before = evidence.score
    scored = [
        (change.after.score - before, change) for change in _changes(evidence, single, double)
    ]
    gain, best = max(scored, key=lambda pair: pair[0], default=(0.0, None))
    return best if best is not None and gain > CORRELATION_GAIN else None


def _changes(e: SheetComparison, single: Array, double: Array) -> Iterator[Change]:
    """Every sign turned and every two like columns exchanged that could be the matter; inputs come
    first, since one of them explains what else would take several outputs."""
    for j, name in enumerate(e.inputs):
        if e.u[:, j].min() < 0.0 < e.u[:, j].max():
            turned = e.u.copy()
            turned[:, j] *= -1.0
            yield from _with_inputs(e, "sign", (name,), turned)
    for i, j in _like(e.inputs):
        swapped = e.u.copy()
        swapped[:, [i, j]] = e.u[:, [j, i]]
        yield from _with_inputs(e, "exchanged", (e.inputs[i], e.inputs[j]), swapped)
    for (i, j), against in zip(e.pairs, double, strict=True):
        if against < CONTRARY:
            swapped = e.y.copy()
            swapped[:, [i, j]] = e.y[:, [j, i]]
            yield Change("exchanged", (e.names[i], e.names[j]), replace(e, y=swapped))
    for k, name in enumerate(e.names):
        one_sided = min(e.y[:, k].min(), e.model[:, k].min()) >= -0.02 * np.ptp(e.model[:, k])
        if single[k] < CONTRARY and not one_sided:
            turned = e.y.copy()
            turned[:, k] *= -1.0
            yield Change("sign", (name,), replace(e, y=turned))


def _with_inputs(
    e: SheetComparison, kind: str, columns: tuple[str, ...], u: Array
) -> Iterator[Change]:
    model = e.simulate(u)
    if model is not None:
        yield Change(kind, columns, replace(e, u=u, model=model))


def _issue_of(
    change: Change, before: SheetComparison, recording: Recording, rig: Rig
) -> QualityIssue:
    columns = recorded_as(change.columns, recording)
    numbers = {
        "agreement_as_recorded": before.score / _most(before),
        "agreement_mended": change.after.score / _most(before),
    }
    figures = (
        f"agreement with rig {rig.name!r} {numbers['agreement_as_recorded']:.2f} as recorded, "
        f"{numbers['agreement_mended']:.2f} the other way"
    )
    if change.kind == "exchanged":
        return QualityIssue(
            "exchanged",
            columns,
            "wrong",
            f"{columns[0]} and {columns[1]} are exchanged: {figures}",
            f"Exchange the two columns in the mapping of `pamid ingest`; if rig {rig.name!r} "
            "really is plugged so, change the rig file.",
            (),
            numbers,
        )
    other = ""
    if len(before.names) == 1 and change.columns[0] in before.inputs:
        other = f" (or that of {recorded_as(before.names, recording)[0]})"
    return QualityIssue(
        "sign",
        columns,
        "wrong",
        f"{columns[0]} has the opposite sign{other}: {figures}",
        "Turn its sign, or set sign = -1 for it in the mapping of `pamid ingest`; if rig "
        f"{rig.name!r} really is built so, change the rig file.",
        (),
        numbers,
    )


def _most(e: SheetComparison) -> int:
    return len(e.names) + len(e.pairs)


# ---- units, pressures, delays ------------------------------------------------------------------


def _units(
    e: SheetComparison, recording: Recording, rig: Rig
) -> tuple[SheetComparison, list[QualityIssue]]:
    """Outputs whose size fits another unit of the same quantity, and the evidence with these set
    right."""
    y = e.y.copy()
    mistaken: dict[tuple[str, str], dict[str, float]] = {}
    columns = recorded_as(e.names, recording)
    for k, (ours, theirs) in enumerate(zip(shapes(e.y), shapes(e.model), strict=True)):
        symbol = split_column(columns[k])[1]
        gain = float((ours * theirs).sum() / max(float((theirs * theirs).sum()), 1e-300))
        if correlation(ours, theirs) < COMPARABLE_CORRELATION or abs(
            math.log(max(gain, 1e-12))
        ) < math.log(WRONG_UNIT):
            continue
        for other in (split_column(f"signal_{suffix}")[1] for suffix in suffixes_for(symbol)):
            # values in the other unit look this much too large
            factor = unit(symbol).factor / unit(other).factor
            if abs(math.log(gain / factor)) < math.log(NEAR_UNIT):
                y[:, k] /= factor
                mistaken.setdefault((symbol, other), {})[columns[k]] = gain
                break
    found = [
        QualityIssue(
            "unit",
            tuple(gains),
            "wrong",
            f"{listed(list(gains))}: {np.mean(list(gains.values())):.3g} times what the data sheet "
            f"of rig {rig.name!r} leads to; the values look like {other}, not {symbol}",
            f'Rename {named}, or set unit = "{other}" in the mapping of `pamid ingest`.',
            (),
            {"gain": float(np.mean(list(gains.values())))},
        )
        for (symbol, other), gains in mistaken.items()
        for named in [listed([f"{n} to {with_unit(split_column(n)[0], other)}" for n in gains])]
    ]
    return replace(e, y=y), found


def _percent(recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Inputs without a unit that are a hundred times what is usual."""
    found = []
    for name, usual in rig.excited.items():
        column = match_column(recording.columns, name)
        if column is None or quantity_of(split_column(column)[1]) != "dimensionless":
            continue
        size = float(np.quantile(np.abs(recording.columns[column]), 0.95))
        if 20.0 * usual < size < 200.0 * usual:
            found.append(
                QualityIssue(
                    "unit",
                    (column,),
                    "wrong",
                    f"{column} reaches {size:.3g}, where {usual:g} is usual for "
                    f"rig {rig.name!r}: it looks like percent",
                    'Divide it by 100: unit = "percent" in the mapping of `pamid ingest`.',
                    (),
                    {"size": size, "usual": usual},
                )
            )
    return found


def _offsets(e: SheetComparison, recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Pressures that lie one atmosphere above the data sheet's."""
    lifted: dict[str, float] = {}
    for k, (ours, theirs) in enumerate(zip(shapes(e.y), shapes(e.model), strict=True)):
        above = float(np.median(e.y[:, k] - e.model[:, k]))
        if (
            rig.outputs[e.names[k]] == "Pa"
            and correlation(ours, theirs) > COMPARABLE_CORRELATION
            and ATMOSPHERE_RANGE_PA[0] < above < ATMOSPHERE_RANGE_PA[1]
        ):
            lifted[recorded_as((e.names[k],), recording)[0]] = above
    if not lifted:
        return []
    sheet = [p for p in rig.parameters if not p.fitted and quantity_of(p.unit) == "pressure"]
    stated = listed([p.outside_name for p in sheet]) if sheet else ""
    columns, above = tuple(lifted), float(np.mean(list(lifted.values())))
    many = "lies" if len(columns) == 1 else "lie"
    return [
        QualityIssue(
            "absolute-pressure",
            columns,
            "advice",
            f"{listed(columns)} {many} {above / 1e3:.0f} kPa above "
            f"what the data sheet of rig {rig.name!r} leads to, as absolute pressures do",
            'Set pressure = "absolute" in the mapping of `pamid ingest`'
            + (f"; if they are gauge pressures, state {stated} under [known]." if stated else "."),
            (),
            {"above_kpa": above / 1e3},
        )
    ]


def _delays(e: SheetComparison, recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Channels that answer earlier or later than the data sheet's model; none where no input moves:
    a machine that is let go answers to nothing, and a period that is off looks like a delay."""
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
    found = []
    for lag, names in sorted(late.items()):
        columns, delay = recorded_as(names, recording), lag * period
        many = "answers" if len(columns) == 1 else "answer"
        hint = (
            "A load heavier than the data sheet's answers late, too: state it below [known]. A "
            "dead time or a lag "
            "is for `pamid diagnose` to find; if clocks differ, shift the channel in the raw log."
            if lag > 0
            else "No rig answers before it is asked: shift the channel, or the command, in the "
            "raw log."
        )
        found.append(
            QualityIssue(
                "delay",
                columns,
                "advice",
                f"{listed(columns)} {many} {duration_text(abs(delay))} "
                f"{'after' if lag > 0 else 'before'} the data sheet's model of rig {rig.name!r}",
                hint,
                (),
                {"delay_s": delay},
            )
        )
    return found


# ---- shapes ------------------------------------------------------------------------------------


def _lag(ours: Array, theirs: Array, most: int) -> tuple[int, float, float]:
    """By how many samples ours comes later, and the correlations of the rates at once and so
    shifted."""
    # sum_t a(t + lag) b(t) for all lags at once, by Fourier transforms padded by the longest lag;
    # each is divided by the energies in its own overlap, so that a long lag is at no disadvantage
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


def _like(names: Sequence[str]) -> list[tuple[int, int]]:
    """Places of columns of one quantity."""
    kinds = [quantity_of(split_column(n)[1]) for n in names]
    return [(i, j) for i, j in itertools.combinations(range(len(names)), 2) if kinds[i] == kinds[j]]


def recorded_as(names: Sequence[str], recording: Recording) -> tuple[str, ...]:
    """The recording's own columns for the rig's."""
    return tuple(match_column(recording.columns, n) or n for n in names)


def listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
